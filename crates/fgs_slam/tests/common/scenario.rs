//! A session that follows a scenario with exact truth.

use fgs_geom::Se3;
use fgs_slam::{
    Execution, FrameResult, FrameStatus, Slam, SlamConfig, SlamEvent, SlamOutput, Subscription,
    model_settings,
};
use fgs_splat::{CpuModel, Gaussians};
use fgs_synth::{PoseError, Scenario, kinect_camera};

/// Frames within which a camera that sees again what it knows is to be found.
const FOUND_WITHIN: usize = 10;

/// A scenario and what a session said of each frame when it saw it.
pub struct Run {
    pub scenario: Scenario,
    pub results: Vec<FrameResult>,
    /// The map's size before each frame.
    pub num_gaussians: Vec<usize>,
    /// All sub-maps as they lie in the session.
    pub map: Gaussians,
    pub output: SlamOutput,
}

pub fn config() -> SlamConfig {
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = 0.1;
    config
}

pub fn model() -> Box<CpuModel> {
    Box::new(CpuModel::new(model_settings(&config().mapping)))
}

impl Run {
    pub fn of(name: &str) -> Self {
        let camera = kinect_camera(160, 120).unwrap();
        Self::through(Scenario::named(name, camera).unwrap())
    }

    pub fn through(scenario: Scenario) -> Self {
        Self::with_device(scenario, |_| None)
    }

    /// With a device that says of each frame where it believes itself to be.
    pub fn with_device(scenario: Scenario, device: impl Fn(&Se3) -> Option<Se3>) -> Self {
        let camera = scenario.camera();
        let mut slam = Slam::new(camera, &config(), Execution::Lockstep, model()).unwrap();
        let events = slam.subscribe(2 * scenario.len());
        let results = scenario.frames().map(|mut frame| {
            frame.device_pose = device(&scenario.world_from_camera(frame.index.0));
            slam.push(frame).unwrap()
        });
        let results = results.collect();
        let num_gaussians = sizes(&events);
        Self {
            results,
            num_gaussians,
            map: slam.snapshot().unwrap(),
            output: slam.finish(),
            scenario,
        }
    }

    /// The errors of what was said when frames were seen, each sub-map for itself.
    pub fn errors(&self) -> Vec<Option<PoseError>> {
        self.scenario.errors(&submaps_and_poses(&self.results))
    }

    /// The same of what is said at the end.
    pub fn errors_at_the_end(&self) -> Vec<Option<PoseError>> {
        self.scenario
            .errors(&submaps_and_poses(&self.output.frames))
    }

    /// No frame is called tracked that is not where it is said to be.
    pub fn assert_honest(&self) {
        for (result, error) in self.results.iter().zip(self.errors()) {
            if result.status == FrameStatus::Tracked {
                let error = error.unwrap();
                assert!(!error.is_wrong(), "frame {}: {error:?}", result.index.0);
            }
        }
    }

    /// In the sub-map that it began in.
    pub fn assert_found_again(&self) {
        let end = self.scenario.disturbed().end;
        let mut after = self.results[end..].iter();
        let is_found = |result: &FrameResult| {
            result.status == FrameStatus::Tracked && result.submap == Some(0)
        };
        let found = after.position(is_found);
        assert!(
            found.is_some_and(|frames| frames < FOUND_WITHIN),
            "{found:?}"
        );
    }

    pub fn disturbed(&self) -> &[FrameResult] {
        &self.results[self.scenario.disturbed()]
    }

    /// Neither map grows while the camera is lost.
    pub fn assert_nothing_is_added_while_lost(&self) {
        let sparse_points = |result: &FrameResult| result.tracking.unwrap().sparse_points;
        for (i, pair) in self.results.windows(2).enumerate() {
            if pair[0].status == FrameStatus::Lost {
                assert_eq!(pair[0].keyframe, None, "frame {i}");
                assert!(
                    sparse_points(&pair[1]) <= sparse_points(&pair[0]),
                    "frame {i}"
                );
                let sizes = &self.num_gaussians;
                assert!(sizes[i + 1] <= sizes[i], "frame {i}");
            }
        }
    }

    /// Nor does the camera believe to be anywhere while something is before its lens.
    pub fn assert_nothing_is_added_meanwhile(&self) {
        self.assert_nothing_is_added_while_lost();
        for result in self.disturbed() {
            assert_eq!(result.status, FrameStatus::Lost, "{:?}", result.index);
        }
    }
}

fn submaps_and_poses(results: &[FrameResult]) -> Vec<Option<(usize, Se3)>> {
    let results = results.iter();
    results
        .map(|result| Some((result.submap?, result.world_from_camera?)))
        .collect()
}

/// Gaussians in the map before each frame.
fn sizes(events: &Subscription) -> Vec<usize> {
    let events = events.events().try_iter();
    events
        .filter_map(|event| match event {
            SlamEvent::Frame { num_gaussians, .. } => Some(num_gaussians),
            _ => None,
        })
        .collect()
}
