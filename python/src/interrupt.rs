//! Long work on a thread of its own, while Python's signals are looked after and progress is told.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;

use crate::errors::RunFailure;

/// How soon Ctrl-C is noticed.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Progress that may wait for Python.
const QUEUE: usize = 1000;

/// How far something is: what is done, how much of it and how much there is.
pub type Progress = (&'static str, usize, usize);

/// What the work hears and tells.
pub struct Desk<'a> {
    /// Set when the work is to end early.
    pub stop: &'a AtomicBool,
    progress: Option<SyncSender<Progress>>,
}

impl Desk<'_> {
    /// Tells how far it is.
    pub fn report(&self, progress: Progress) {
        if let Some(sender) = &self.progress {
            // Nobody listens any more once the callback has failed.
            let _ = sender.send(progress);
        }
    }

    /// Whether to go on.
    pub fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }

    /// The same for loops.
    pub fn flow(&self) -> ControlFlow<()> {
        if self.goes_on() {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    }
}

/// Does the work with Python released. Its progress goes to `callback(what, done, total)`, on the thread that
/// called. When a signal's handler or the callback raises, the work is asked to stop.
///
/// # Errors
/// What was raised, when the work has stopped, with what the work says of it as its cause; else the work's own
/// error, also if it panics, which would be a bug.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Desk<'_>) -> PyResult<T> + Send,
) -> PyResult<T> {
    let stop = &AtomicBool::new(false);
    let (ended, has_ended) = sync_channel::<()>(0);
    let (progress, told) = sync_channel(QUEUE);
    let desk = Desk {
        stop,
        progress: callback.map(|_| progress),
    };
    let callback = callback.map(|callback| callback.clone().unbind());
    let (done, raised) = py.detach(move || {
        thread::scope(|scope| {
            let working = scope.spawn(move || {
                // Dropped however the work ends.
                let _ended = ended;
                work(&desk)
            });
            let raised = attend(stop, has_ended, told, callback.as_ref());
            let panicked = |_| Err(RunFailure::new_err("stopped on an internal error"));
            (working.join().unwrap_or_else(panicked), raised)
        })
    });
    match raised {
        None => done,
        Some(raised) => {
            raised.set_cause(py, done.err());
            Err(raised)
        }
    }
}

/// Looks after signals and progress until the work has ended.
fn attend(
    stop: &AtomicBool,
    has_ended: Receiver<()>,
    told: Receiver<Progress>,
    callback: Option<&Py<PyAny>>,
) -> Option<PyErr> {
    let mut told = callback.map(|callback| (callback, told));
    let mut raised = None;
    loop {
        let last = has_ended.recv_timeout(SIGNAL_INTERVAL) == Err(RecvTimeoutError::Disconnected);
        let heard = Python::attach(|py| {
            py.check_signals()?;
            if let Some((callback, told)) = &told {
                for progress in told.try_iter() {
                    callback.call1(py, progress)?;
                }
            }
            Ok(())
        });
        if let Err(error) = heard {
            stop.store(true, Ordering::Relaxed);
            raised.get_or_insert(error);
            told = None;
        }
        if last {
            return raised;
        }
    }
}
