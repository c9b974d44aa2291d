//! What a run gives to ROS: poses as they come, and now and then path, points and map.
//!
//! Axes are the run's, frame `map`: those of the camera at its first frame (x right, y down, z forward),
//! metres.

use std::collections::BTreeMap;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::RecvTimeoutError;
use fgs_export::write_spz;
use fgs_geom::Se3;
use fgs_run::{RunEvent, RunObserver};
use fgs_slam::{FrameResult, Slam, SlamEvent, Subscription};
use fgs_splat::Gaussians;
use ros2_client::Publisher;
use ros2_client::dds::rustdds::no_key::DataWriterCdr;

use crate::error::Ros2Error;
use crate::messages::{
    Header, MultiArrayDimension, Path, PointCloud2, Pose, PoseStamped, Stamp, TfMessage,
    TransformStamped, UInt8MultiArray,
};
use crate::node::{Domain, Ros2Node};
use crate::points::cloud;

const POSE: &str = "/fgs_slam/pose";
const PATH: &str = "/fgs_slam/path";
const POINTS: &str = "/fgs_slam/points";
const MAP: &str = "/fgs_slam/map";

/// The axes of everything.
const MAP_FRAME: &str = "map";
/// The camera's optical axes, under a name of its own: in those of its driver, the camera has a parent
/// already.
const CAMERA_FRAME: &str = "fgs_slam_camera";

/// Events that wait: a few seconds' worth.
const QUEUE: usize = 256;
/// Between two paths or clouds.
const SHORT: Duration = Duration::from_secs(1);
/// Between two maps: packing one takes a second.
const LONG: Duration = Duration::from_secs(10);
/// Keyframes on the path: the newest, 400 kB.
const MAX_PATH: usize = 5000;
/// How long those who read may take for the last map.
const FAREWELL: Duration = Duration::from_secs(5);

/// Publishes a run.
pub struct Ros2Publisher {
    /// Before the run and after it.
    outputs: Option<Outputs>,
    /// Has them meanwhile.
    thread: Option<JoinHandle<Outputs>>,
}

/// What is published now and then.
struct Due {
    every: Duration,
    next: Instant,
    /// Whether it has changed since.
    is_old: bool,
}

impl Due {
    fn new(every: Duration) -> Self {
        Self {
            every,
            next: Instant::now(),
            is_old: false,
        }
    }

    fn is_due(&self) -> bool {
        self.is_old && self.next <= Instant::now()
    }

    fn done(&mut self) {
        self.next = Instant::now() + self.every;
        self.is_old = false;
    }
}

/// The topics.
struct Outputs {
    domain: Domain,
    /// Publishers are in its name.
    _node: Ros2Node,
    pose: Publisher<PoseStamped>,
    tf: Publisher<TfMessage>,
    path: Publisher<Path>,
    points: Publisher<PointCloud2>,
    map: DataWriterCdr<UInt8MultiArray>,
    /// Poses and times of keyframes.
    keyframes: BTreeMap<u32, (f64, Se3)>,
    /// When the last frame was taken.
    last_secs: f64,
}

impl Ros2Publisher {
    /// # Errors
    /// If DDS refuses.
    pub(crate) fn new(domain: &Domain) -> Result<Self, Ros2Error> {
        let mut node = Ros2Node::new(domain, "fgs_slam")?;
        let outputs = Outputs {
            domain: domain.clone(),
            pose: node.publisher(POSE, ("geometry_msgs", "PoseStamped"))?,
            tf: node.publisher("/tf", ("tf2_msgs", "TFMessage"))?,
            path: node.publisher(PATH, ("nav_msgs", "Path"))?,
            points: node.publisher(POINTS, ("sensor_msgs", "PointCloud2"))?,
            map: domain.latched(MAP, ("std_msgs", "UInt8MultiArray"))?,
            _node: node,
            keyframes: BTreeMap::new(),
            last_secs: 0.0,
        };
        Ok(Self {
            outputs: Some(outputs),
            thread: None,
        })
    }
}

impl RunObserver for Ros2Publisher {
    fn begin(&mut self, session: &Slam) {
        if let Some(outputs) = self.outputs.take() {
            let events = session.subscribe(QUEUE);
            let thread = thread::Builder::new().name("ros2".into());
            // Without a thread nothing is published; the run is the same.
            self.thread = thread.spawn(move || outputs.look_on(&events)).ok();
        }
    }

    fn on(&mut self, event: &RunEvent<'_>) {
        if let RunEvent::Mapped { map } = event
            && let Some(thread) = self.thread.take()
            && let Ok(outputs) = thread.join()
        {
            outputs.end(map);
            // The map is there for those who come later, as long as this is.
            self.outputs = Some(outputs);
        }
    }
}

impl Outputs {
    /// Publishes until the session ends.
    fn look_on(mut self, events: &Subscription) -> Self {
        let [mut path, mut points, mut map, mut glance] = [SHORT, SHORT, LONG, SHORT].map(Due::new);
        loop {
            let has_changed = match events.events().recv_timeout(SHORT) {
                Ok(SlamEvent::Frame { result, .. }) => self.frame(&result),
                Ok(SlamEvent::Correction(poses)) => {
                    for (id, pose) in poses.iter() {
                        if let Some(keyframe) = self.keyframes.get_mut(&id.0) {
                            keyframe.1 = *pose;
                        }
                    }
                    true
                }
                // The first keyframe's gaussians take a moment.
                Ok(SlamEvent::Snapshot(gaussians)) if gaussians.is_empty() => false,
                Ok(SlamEvent::Snapshot(gaussians)) => {
                    if self.wants(&points, POINTS) {
                        self.publish_points(&gaussians);
                        points.done();
                    }
                    if self.wants(&map, MAP) {
                        self.publish_map(&gaussians);
                        map.done();
                    }
                    false
                }
                Ok(_) | Err(RecvTimeoutError::Timeout) => false,
                Err(RecvTimeoutError::Disconnected) => return self,
            };
            if has_changed {
                for due in [&mut path, &mut points, &mut map] {
                    due.is_old = true;
                }
            }
            glance.is_old = true;
            if glance.is_due() {
                glance.done();
                if path.is_due() {
                    self.publish_path();
                    path.done();
                }
                if self.wants(&points, POINTS) || self.wants(&map, MAP) {
                    events.request_snapshot();
                }
            }
        }
    }

    /// A map is copied only for who reads it.
    fn wants(&self, due: &Due, topic: &str) -> bool {
        due.is_due() && self.domain.is_read(topic)
    }

    /// Publishes a frame's pose, if it has one; true if it has become a keyframe.
    fn frame(&mut self, result: &FrameResult) -> bool {
        let (Some(secs), Some(pose)) = (result.timestamp_secs, result.world_from_camera) else {
            return false;
        };
        self.last_secs = secs;
        // Sub-maps that nothing connects to the first lie anywhere.
        if result.submap != Some(0) {
            return false;
        }
        let header = self.header(secs);
        send(&self.pose, stamped(secs, &pose));
        send(
            &self.tf,
            TfMessage {
                transforms: vec![TransformStamped {
                    header,
                    child_frame_id: CAMERA_FRAME.into(),
                    transform: Pose::from(&pose),
                }],
            },
        );
        let Some((id, _)) = result.keyframe else {
            return false;
        };
        self.keyframes.insert(id.0, (secs, pose));
        if self.keyframes.len() > MAX_PATH {
            self.keyframes.pop_first();
        }
        true
    }

    fn publish_path(&self) {
        let poses = self.keyframes.values();
        let poses = poses.map(|(secs, pose)| stamped(*secs, pose)).collect();
        let header = self.header(self.last_secs);
        send(&self.path, Path { header, poses });
    }

    fn publish_points(&self, map: &Gaussians) {
        send(&self.points, cloud(map, self.header(self.last_secs)));
    }

    fn publish_map(&self, map: &Gaussians) {
        let mut data = Vec::new();
        // Writing to memory fails only for maps that are larger than any.
        if write_spz(&mut data, map).is_err() {
            return;
        }
        let size = data.len() as u32;
        let dim = vec![MultiArrayDimension {
            label: "spz".into(),
            size,
            stride: size,
        }];
        let message = UInt8MultiArray {
            dim,
            data_offset: 0,
            data,
        };
        // As with [`send`].
        let _ = self.map.write(message, None);
    }

    /// Publishes what there is at the end, and waits for those who read it.
    fn end(&self, map: &Gaussians) {
        self.publish_path();
        self.publish_points(map);
        self.publish_map(map);
        // If it has not come by then, nobody takes it.
        let _ = self.map.wait_for_acknowledgments(FAREWELL);
    }

    fn header(&self, secs: f64) -> Header {
        Header {
            stamp: Stamp::of(secs),
            frame_id: MAP_FRAME.into(),
        }
    }
}

fn stamped(secs: f64, pose: &Se3) -> PoseStamped {
    PoseStamped {
        header: Header {
            stamp: Stamp::of(secs),
            frame_id: MAP_FRAME.into(),
        },
        pose: Pose::from(pose),
    }
}

/// What cannot be sent now is not worth sending later.
fn send<M: serde::Serialize>(publisher: &Publisher<M>, message: M) {
    let _ = publisher.publish(message);
}
