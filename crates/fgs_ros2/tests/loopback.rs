//! A camera in another process is tracked, and what comes back is what the camera did.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::thread::sleep;
use std::time::{Duration, Instant};

use fgs_ros2::{Domain, Path, PointCloud2, PoseStamped, TfMessage, UInt8MultiArray, open};
use fgs_run::{Backend, Plan, RunOptions};
use fgs_synth::{FRAMES_PER_SECOND, SensorModel, Sequence, kinect_camera};
use ros2_client::qos::{Durability, History, QosProfile, WhenFull};
use ros2_client::{
    Context, ContextOptions, MessageTypeName, Name, Node, NodeName, NodeOptions, Subscription,
};
use serde::de::DeserializeOwned;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;
const RATE: usize = 10;
/// Frames that the camera sends.
const SENT: usize = 60;
/// Frames that the run takes: the camera does not wait for it.
const TAKEN: usize = 40;

/// What DDS needs for discovery is missing.
const SKIPPED: &str = "SKIPPED: participants of DDS do not find each other on this machine";

/// One that others do not use at the moment.
fn domain_number() -> u16 {
    20 + (std::process::id() % 60) as u16
}

/// Ended with the test.
struct Camera(Child);

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn node(domain: u16, name: &str) -> Node {
    let context = Context::with_options(ContextOptions::new().domain_id(domain)).unwrap();
    let name = NodeName::new("/", name).unwrap();
    context.new_node(name, NodeOptions::new()).unwrap()
}

fn qos(durability: Durability) -> QosProfile {
    QosProfile {
        durability,
        history: History::KeepLast { depth: 100 },
        ..QosProfile::default().reliability_reliable(WhenFull::DEFAULT)
    }
}

fn subscribe<M: DeserializeOwned + 'static>(
    node: &mut Node,
    topic: &str,
    (package, name): (&str, &str),
    durability: Durability,
) -> Subscription<M> {
    let qos = qos(durability);
    let name = MessageTypeName::new(package, name);
    let topic = node.create_topic(&Name::parse(topic).unwrap(), name, &qos);
    node.create_subscription(&topic.unwrap(), Some(qos))
        .unwrap()
}

fn taken<M: DeserializeOwned + 'static>(subscription: &Subscription<M>) -> Vec<M> {
    let messages = std::iter::from_fn(|| subscription.take().unwrap());
    messages.map(|(message, _)| message).collect()
}

/// Waits until something is there.
fn wait_for<T>(mut look: impl FnMut() -> Option<T>) -> Option<T> {
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(10) {
        if let Some(found) = look() {
            return Some(found);
        }
        sleep(Duration::from_millis(10));
    }
    None
}

/// Whether two participants, none of them ours, hear of each other.
fn discovery_works(domain: u16) -> bool {
    let string = || MessageTypeName::new("std_msgs", "String");
    let mut speaker = node(domain, "speaker");
    let mut listener = node(domain, "listener");
    let heard = subscribe::<String>(
        &mut listener,
        "/heard",
        ("std_msgs", "String"),
        Durability::Volatile,
    );
    let qos = qos(Durability::Volatile);
    let topic = speaker.create_topic(&Name::parse("/heard").unwrap(), string(), &qos);
    let publisher = speaker
        .create_publisher(&topic.unwrap(), Some(qos))
        .unwrap();
    wait_for(|| {
        let _ = publisher.publish("hello".to_owned());
        taken(&heard).pop()
    })
    .is_some()
}

#[test]
fn a_camera_in_another_process_is_tracked_and_poses_come_back() {
    let number = domain_number();
    if !discovery_works(number) {
        eprintln!("{SKIPPED}");
        return;
    }
    let arguments = [WIDTH, HEIGHT, RATE, SENT].map(|number| number.to_string());
    let child = Command::new(env!("CARGO_BIN_EXE_synthetic_camera"))
        .args(arguments)
        .env("ROS_DOMAIN_ID", number.to_string())
        .stdout(Stdio::null())
        .spawn();
    let _camera = Camera(child.unwrap());
    let mut watcher = node(number, "watcher");
    let volatile = Durability::Volatile;
    let pose_type = ("geometry_msgs", "PoseStamped");
    let poses = subscribe::<PoseStamped>(&mut watcher, "/fgs_slam/pose", pose_type, volatile);
    let tf = subscribe::<TfMessage>(&mut watcher, "/tf", ("tf2_msgs", "TFMessage"), volatile);
    let path_type = ("nav_msgs", "Path");
    let paths = subscribe::<Path>(&mut watcher, "/fgs_slam/path", path_type, volatile);
    let cloud_type = ("sensor_msgs", "PointCloud2");
    let clouds = subscribe::<PointCloud2>(&mut watcher, "/fgs_slam/points", cloud_type, volatile);

    let topics = "/camera".parse().unwrap();
    let domain = Domain::new(number).unwrap();
    let (source, mut publisher) = open(domain.clone(), &topics).unwrap();
    let read = [
        "/fgs_slam/pose",
        "/fgs_slam/path",
        "/fgs_slam/points",
        "/tf",
    ];
    wait_for(|| read.iter().all(|topic| domain.is_read(topic)).then_some(())).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let options = RunOptions {
        backend: Some(Backend::Cpu),
        frames: Some(format!("..{TAKEN}").parse().unwrap()),
        out: Some(folder.path().join("out")),
        ..RunOptions::default()
    };
    let (plan, model) = Plan::resolve_live(&options, "ros2:/camera", Box::new(source)).unwrap();
    let result = plan
        .run(model, &mut publisher, &AtomicBool::new(false))
        .unwrap();

    // It is still published: RustDDS forgets what was not taken when its publisher ends.
    let poses = taken(&poses);
    assert!(poses.len() >= TAKEN / 2, "only {} poses came", poses.len());
    assert_eq!(poses.len(), result.trajectory.poses().len());
    let camera = kinect_camera(WIDTH, HEIGHT).unwrap();
    let truth = Sequence::new(1, SENT, camera, SensorModel::exact());
    // The camera's first frame was taken at a whole second, and one of its first thirty is tracked.
    let begin = poses[0].header.stamp.secs().floor();
    let index = |pose: &PoseStamped| {
        let secs = pose.header.stamp.secs() - begin;
        (FRAMES_PER_SECOND * secs).round() as usize
    };
    let first = truth.world_from_camera(index(&poses[0])).inverse();
    for pose in &poses {
        assert_eq!(pose.header.frame_id, "map");
        let expected = first * truth.world_from_camera(index(pose));
        let (p, q) = (pose.pose.position, pose.pose.orientation);
        let position = nalgebra::Vector3::new(p.x, p.y, p.z);
        let error_m = (position - expected.translation).norm();
        assert!(error_m < 0.02, "frame {} is {error_m} m off", index(pose));
        let rotation = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z);
        let rotation = nalgebra::UnitQuaternion::from_quaternion(rotation);
        let error_rad = rotation.angle_to(&expected.rotation);
        assert!(
            error_rad < 0.02,
            "frame {} is turned by {error_rad}",
            index(pose)
        );
    }
    let way = poses.last().unwrap().pose.position;
    assert!(
        way.x.hypot(way.y).hypot(way.z) > 0.1,
        "the camera hardly moved"
    );

    let transforms = taken(&tf);
    assert_eq!(transforms.len(), poses.len());
    let last = transforms.last().unwrap();
    assert_eq!(last.transforms[0].transform, poses.last().unwrap().pose);
    // Whether the last frame closes the run as a keyframe is not known while it goes on.
    let path = taken(&paths).pop().unwrap().poses;
    let keyframes = result.rows.iter().filter(|row| row.keyframe.is_some());
    assert!(path.len() + 1 >= keyframes.count() && path.len() > 1);
    let stamps = |poses: &[PoseStamped]| -> Vec<f64> {
        poses.iter().map(|pose| pose.header.stamp.secs()).collect()
    };
    let known = stamps(&poses);
    assert!(stamps(&path).iter().all(|secs| known.contains(secs)));
    let cloud = taken(&clouds).pop().unwrap();
    assert!(cloud.width > 1000, "{} points", cloud.width);
    assert_eq!(cloud.data.len(), 16 * cloud.width as usize);

    // The map is still there for who asks later.
    let map_type = ("std_msgs", "UInt8MultiArray");
    let latched = Durability::TransientLocal;
    let map = subscribe::<UInt8MultiArray>(&mut watcher, "/fgs_slam/map", map_type, latched);
    let mut expected = Vec::new();
    fgs_export::write_spz(&mut expected, &result.gaussians).unwrap();
    let map = wait_for(|| taken(&map).pop()).unwrap();
    assert_eq!(map.dim[0].label, "spz");
    assert!(
        map.data == expected,
        "{} and {} bytes",
        map.data.len(),
        expected.len()
    );
    drop(publisher);
}
