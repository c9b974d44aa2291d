//! Frames in order, decoded ahead on threads of their own.
//!
//! Each frame asked for is a job with a channel of its own for the answer; the stream keeps the
//! receiving ends in order. So order does not depend on which thread is faster, memory is bounded
//! by the look-ahead, and every wait ends when the other side is gone: a dropped stream closes the
//! job channel, a thread that dies closes its answer's.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

use crossbeam_channel::{Receiver, Sender, bounded, unbounded};
use fgs_geom::RgbdFrame;

use crate::DataError;
use crate::frame_loader::FrameLoader;

/// Decoding takes a few milliseconds a frame: two threads stay ahead of any tracker.
const THREADS: usize = 2;

/// Evens out frames that take longer; 17 MB at 640x480.
const LOOK_AHEAD: usize = 8;

type Answer = Result<RgbdFrame, DataError>;

struct Job {
    index: usize,
    answer: Sender<Answer>,
}

/// The frames of a range of a recording, in order; see [`Dataset::frames`](crate::Dataset::frames).
///
/// A frame that cannot be read is an `Err` item, and the stream goes on behind it.
pub struct FrameStream {
    /// `None` once the stream is being dropped.
    jobs: Option<Sender<Job>>,
    threads: Vec<JoinHandle<()>>,
    /// The frames under way, in order.
    answers: VecDeque<(usize, Receiver<Answer>)>,
    /// The frames not yet under way.
    rest: Range<usize>,
}

impl FrameStream {
    pub(crate) fn new(loader: &Arc<FrameLoader>, range: Range<usize>) -> Self {
        let (jobs, queue) = unbounded::<Job>();
        let decode = |loader: Arc<FrameLoader>, queue: Receiver<Job>| {
            move || {
                for job in queue {
                    // The stream may have been dropped meanwhile.
                    let _ = job.answer.send(loader.load(job.index));
                }
            }
        };
        // Without any thread, all jobs are dropped with the queue and each frame is an `Err`.
        let threads = (0..THREADS)
            .filter_map(|_| {
                let thread = Builder::new().name("decoder".into());
                thread.spawn(decode(loader.clone(), queue.clone())).ok()
            })
            .collect();
        let mut stream = Self {
            jobs: Some(jobs),
            threads,
            answers: VecDeque::with_capacity(LOOK_AHEAD),
            rest: range,
        };
        stream.decode_ahead();
        stream
    }

    fn decode_ahead(&mut self) {
        while self.answers.len() < LOOK_AHEAD {
            let Some(index) = self.rest.next() else { break };
            let (answer, receiver) = bounded(1);
            if let Some(jobs) = &self.jobs {
                // Fails without threads; then the answer's channel is closed.
                let _ = jobs.send(Job { index, answer });
            }
            self.answers.push_back((index, receiver));
        }
    }
}

impl Iterator for FrameStream {
    type Item = Answer;

    fn next(&mut self) -> Option<Answer> {
        let (index, answer) = self.answers.pop_front()?;
        let frame = answer.recv().unwrap_or(Err(DataError::DecoderGone(index)));
        self.decode_ahead();
        Some(frame)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let len = self.answers.len() + self.rest.len();
        (len, Some(len))
    }
}

impl Drop for FrameStream {
    fn drop(&mut self) {
        self.jobs = None;
        self.answers.clear();
        for thread in self.threads.drain(..) {
            // A thread that panicked has reported that itself.
            let _ = thread.join();
        }
    }
}
