//! Ways to run a session: how the mapper gets its turns (lockstep, parallel, realtime), and who
//! delivers the frames (as fast as they are taken, at their own times, or a live camera). The only
//! folder with threads.

mod budget;
mod correcting;
mod drive;
mod live;
mod lockstep;
mod mapping;
mod mapping_thread;
mod parallel;
mod preparation;
mod realtime;
mod replay;
mod worker;

use std::fmt;
use std::io;
use std::str::FromStr;
use std::sync::Arc;

use fgs_geom::Camera;
use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

use crate::config::SlamConfig;
use crate::event::EventHub;
use crate::prepare::KeyframePreparer;
use preparation::Preparation;
use worker::{MapperWorker, Ready};

pub(crate) use correcting::Correcting;
pub use drive::{drive, drive_with};
pub use live::{live, live_with};
pub(crate) use mapping::{MapperGone, Mapping, Moves};
pub use replay::{replay, replay_with};
pub(crate) use worker::{MapReport, MapStatus, SavedMapping};

/// How tracker and mapper take turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Execution {
    /// In strict turns on one thread: the same result, bit for bit, every time.
    Lockstep,
    /// On two threads; the tracker waits when the mapper falls behind, so that the map's quality
    /// does not depend on the machine.
    Parallel,
    /// On two threads; the mapper optimises all the while and the tracker never waits for it, as
    /// beside a live camera.
    Realtime,
}

impl Execution {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Lockstep, Self::Parallel, Self::Realtime];
}

impl fmt::Display for Execution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lockstep => "lockstep",
            Self::Parallel => "parallel",
            Self::Realtime => "realtime",
        })
    }
}

impl FromStr for Execution {
    type Err = UnknownExecution;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let mut all = Self::ALL.into_iter();
        all.find(|execution| execution.to_string() == name)
            .ok_or_else(|| UnknownExecution(name.into()))
    }
}

/// No [`Execution`] has this name.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("'{0}' is none of lockstep, parallel, realtime")]
pub struct UnknownExecution(String);

/// Starts the mapping side of a session with what it knows, and the tracker's own threads if it has any.
pub(crate) fn start(
    camera: &Camera,
    config: &SlamConfig,
    execution: Execution,
    ready: Ready,
    status: &Arc<MapStatus>,
    events: &EventHub,
) -> io::Result<(Box<dyn Mapping>, Option<ThreadPool>)> {
    let preparer = KeyframePreparer::new(camera, config);
    let preparation = match execution {
        Execution::Lockstep => Preparation::in_turn(preparer),
        Execution::Parallel | Execution::Realtime => Preparation::on_thread(preparer)?,
    };
    let worker = MapperWorker::new(
        config,
        ready,
        preparation,
        Arc::clone(status),
        events.clone(),
    );
    Ok(match execution {
        Execution::Lockstep => (Box::new(lockstep::Lockstep::new(worker)), None),
        Execution::Parallel => (Box::new(parallel::start(worker, camera)?), None),
        Execution::Realtime => (
            Box::new(realtime::start(worker, camera)?),
            Some(realtime::tracker_pool()?),
        ),
    })
}
