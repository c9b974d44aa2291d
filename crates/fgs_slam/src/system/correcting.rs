//! Where the graph is optimised when a loop closes: at once, or on a thread of its own, so that the camera is
//! followed meanwhile. Loops are rare, so the thread lives as long as the work.

use std::io;
use std::mem;
use std::panic::resume_unwind;
use std::thread::{Builder, JoinHandle};

use super::Execution;
use crate::loops::Correction;

/// Works out one correction at a time.
pub struct Correcting {
    execution: Execution,
    work: Work,
}

enum Work {
    None,
    Done(Option<Correction>),
    OnThread(JoinHandle<Option<Correction>>),
}

impl Correcting {
    pub fn new(execution: Execution) -> Self {
        Self {
            execution,
            work: Work::None,
        }
    }

    /// Starts on a correction. The one before it must have been taken.
    ///
    /// # Errors
    /// If a thread does not start.
    pub fn begin(
        &mut self,
        work: impl FnOnce() -> Option<Correction> + Send + 'static,
    ) -> io::Result<()> {
        self.work = match self.execution {
            Execution::Lockstep => Work::Done(work()),
            Execution::Parallel | Execution::Realtime => {
                Work::OnThread(Builder::new().name("loop".into()).spawn(work)?)
            }
        };
        Ok(())
    }

    /// Whether a correction is under way or waits to be taken.
    pub fn is_busy(&self) -> bool {
        !matches!(self.work, Work::None)
    }

    /// The correction that is ready, if any.
    pub fn poll(&mut self) -> Option<Correction> {
        match &self.work {
            Work::OnThread(thread) if !thread.is_finished() => None,
            _ => self.wait(),
        }
    }

    /// The correction under way, once it is ready; `None` if there is none.
    pub fn wait(&mut self) -> Option<Correction> {
        match mem::replace(&mut self.work, Work::None) {
            Work::None => None,
            Work::Done(correction) => correction,
            Work::OnThread(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
        }
    }
}
