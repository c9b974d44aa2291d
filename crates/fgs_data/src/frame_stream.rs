//! Frames in order, decoded ahead on threads of their own.
//!
//! Each frame asked for is a job with a channel of its own for the answer; the stream keeps the
//! receiving ends in order, so the order does not depend on which thread is faster. There are as
//! many threads as the reader needs: two at first, and one more each time the reader had to wait.
//! The look-ahead grows with them and is bounded in frames and in bytes.

use std::collections::VecDeque;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::{Builder, JoinHandle, available_parallelism};

use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded, unbounded};
use fgs_geom::{Camera, RgbdFrame};

use crate::DataError;
use crate::frame_loader::FrameLoader;

/// Threads at first: decoding takes a few milliseconds a frame, so that two stay ahead of most
/// readers and leave the other cores alone.
const INITIAL_THREADS: usize = 2;

/// Frames ahead for each thread: evens out those that take longer.
const LOOK_AHEAD_PER_THREAD: usize = 4;

/// The most memory that frames decoded ahead may take: at 640x480 it is never reached, and two
/// frames of 12 megapixels fit.
const MAX_LOOK_AHEAD_BYTES: usize = 192 * 1024 * 1024;

/// Bytes of a pixel: colour and depth.
const BYTES_PER_PIXEL: usize = 3 + 4;

type Answer = Result<RgbdFrame, DataError>;
type Decode = dyn Fn(usize) -> Answer + Send + Sync;

struct Job {
    index: usize,
    answer: Sender<Answer>,
}

/// The frames of a range of a recording, in order; see [`Dataset::frames`](crate::Dataset::frames).
///
/// A frame that cannot be read is an `Err` item, and the stream continues with the next frame.
pub struct FrameStream {
    decode: Arc<Decode>,
    /// `None` once the stream is being dropped.
    jobs: Option<Sender<Job>>,
    queue: Receiver<Job>,
    threads: Vec<JoinHandle<()>>,
    limits: Limits,
    /// The frames under way, in order.
    answers: VecDeque<(usize, Receiver<Answer>)>,
    /// The frames not yet under way.
    rest: Range<usize>,
    /// Whether the first frame was taken. Everyone waits for that one.
    is_started: bool,
}

/// How far a stream may grow.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Limits {
    threads: usize,
    look_ahead: usize,
}

impl Limits {
    /// The limits for a camera's frames on a machine with that many cores. A frame counts against
    /// the memory as soon as a thread starts on it, so more threads than frames ahead would idle.
    fn new(camera: &Camera, cores: usize) -> Self {
        let pixels = camera.width.saturating_mul(camera.height).max(1);
        let affordable = MAX_LOOK_AHEAD_BYTES / pixels.saturating_mul(BYTES_PER_PIXEL);
        let look_ahead = affordable.clamp(1, LOOK_AHEAD_PER_THREAD * cores.max(INITIAL_THREADS));
        Self {
            threads: cores.clamp(INITIAL_THREADS, INITIAL_THREADS.max(look_ahead)),
            look_ahead,
        }
    }
}

impl FrameStream {
    pub(crate) fn new(loader: &Arc<FrameLoader>, range: Range<usize>) -> Self {
        let cores = available_parallelism().map_or(INITIAL_THREADS, |cores| cores.get());
        let limits = Limits::new(loader.camera(), cores);
        let loader = loader.clone();
        Self::with(Arc::new(move |index| loader.load(index)), range, limits)
    }

    fn with(decode: Arc<Decode>, range: Range<usize>, limits: Limits) -> Self {
        let (jobs, queue) = unbounded();
        let mut stream = Self {
            decode,
            jobs: Some(jobs),
            queue,
            threads: Vec::new(),
            limits,
            answers: VecDeque::new(),
            rest: range,
            is_started: false,
        };
        for _ in 0..INITIAL_THREADS {
            stream.add_thread();
        }
        stream.decode_ahead();
        stream
    }

    /// Starts another thread. Where the system has none left, those there are go on.
    fn add_thread(&mut self) {
        let (decode, queue) = (self.decode.clone(), self.queue.clone());
        let work = move || {
            for Job { index, answer } in queue {
                // A panic must not take the thread along: others would wait for its frames.
                let frame = catch_unwind(AssertUnwindSafe(|| decode(index)))
                    .unwrap_or(Err(DataError::DecoderPanicked(index)));
                // The stream may have been dropped meanwhile.
                let _ = answer.send(frame);
            }
        };
        if let Ok(thread) = Builder::new().name("decoder".into()).spawn(work) {
            self.threads.push(thread);
        }
    }

    fn decode_ahead(&mut self) {
        let look_ahead = LOOK_AHEAD_PER_THREAD * self.threads.len().max(1);
        while self.answers.len() < look_ahead.min(self.limits.look_ahead) {
            let Some(index) = self.rest.next() else { break };
            let (answer, receiver) = bounded(1);
            if let Some(jobs) = &self.jobs {
                // Cannot fail: the stream holds a receiver.
                let _ = jobs.send(Job { index, answer });
            }
            self.answers.push_back((index, receiver));
        }
    }

    fn wait_for(&mut self, index: usize, answer: &Receiver<Answer>) -> Answer {
        if self.threads.is_empty() {
            return (self.decode)(index);
        }
        match answer.try_recv() {
            Ok(frame) => return frame,
            Err(TryRecvError::Empty) => {
                if self.is_started && self.threads.len() < self.limits.threads {
                    self.add_thread();
                    self.decode_ahead();
                }
            }
            Err(TryRecvError::Disconnected) => {}
        }
        answer
            .recv()
            .unwrap_or(Err(DataError::DecoderPanicked(index)))
    }
}

impl Iterator for FrameStream {
    type Item = Answer;

    fn next(&mut self) -> Option<Answer> {
        let (index, answer) = self.answers.pop_front()?;
        let frame = self.wait_for(index, &answer);
        self.is_started = true;
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
        // Nobody waits for what no thread has begun with.
        while self.queue.try_recv().is_ok() {}
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::mpsc;
    use std::sync::{Condvar, Mutex};
    use std::thread::{self, ThreadId};
    use std::time::Duration;

    use fgs_geom::{FrameIndex, Image, Intrinsics};

    use super::*;

    fn camera(width: usize, height: usize) -> Camera {
        let intrinsics = Intrinsics {
            fx: width as f64,
            fy: width as f64,
            cx: 0.0,
            cy: 0.0,
        };
        Camera::new(width, height, intrinsics).unwrap()
    }

    fn frame(index: usize) -> Answer {
        let (color, depth_m) = (Image::filled(1, 1, [0; 3]), Image::filled(1, 1, 1.0));
        let frame = RgbdFrame::new(FrameIndex(index), 0.0, color, depth_m, camera(1, 1));
        frame.map_err(|source| DataError::Frame { index, source })
    }

    /// Ends the test if it hangs.
    fn in_time(test: impl FnOnce() + Send + 'static) {
        let (done, finished) = mpsc::channel();
        thread::spawn(move || {
            test();
            done.send(()).unwrap();
        });
        finished.recv_timeout(Duration::from_secs(60)).unwrap();
    }

    /// All frames but the first wait until so many threads decode at once.
    fn decode_together(threads: usize) -> Arc<Decode> {
        let (seen, all) = (Mutex::new(HashSet::<ThreadId>::new()), Condvar::new());
        Arc::new(move |index| {
            if index > 0 {
                let mut seen = seen.lock().unwrap();
                seen.insert(thread::current().id());
                all.notify_all();
                drop(all.wait_while(seen, |seen| seen.len() < threads).unwrap());
            }
            frame(index)
        })
    }

    const FOUR: Limits = Limits {
        threads: 4,
        look_ahead: 16,
    };

    #[test]
    fn a_reader_that_waits_gets_another_thread() {
        in_time(|| {
            // Frame 1 cannot come before a third thread has begun.
            let mut stream = FrameStream::with(decode_together(3), 0..40, FOUR);
            assert_eq!((stream.threads.len(), stream.answers.len()), (2, 8));
            stream.next().unwrap().unwrap();
            assert_eq!(stream.threads.len(), 2);
            stream.next().unwrap().unwrap();
            assert_eq!((stream.threads.len(), stream.answers.len()), (3, 12));
            for (expected, frame) in (2..40).zip(&mut stream) {
                assert_eq!(frame.unwrap().index.0, expected);
            }
            assert!(stream.threads.len() <= 4);
            assert!(stream.next().is_none());
        });
    }

    #[test]
    fn a_reader_that_never_waits_gets_none() {
        in_time(|| {
            let mut stream = FrameStream::with(Arc::new(frame), 0..40, FOUR);
            for expected in 0..40 {
                while stream.answers[0].1.is_empty() {
                    thread::yield_now();
                }
                let frame = stream.next().unwrap().unwrap();
                assert_eq!((frame.index.0, stream.threads.len()), (expected, 2));
            }
        });
    }

    #[test]
    fn threads_stop_at_the_limit() {
        in_time(|| {
            let gate = Arc::new((Mutex::new(0), Condvar::new()));
            let closed = gate.clone();
            let decode = move |index| {
                let open = closed.0.lock().unwrap();
                drop(closed.1.wait_while(open, |open| *open <= index).unwrap());
                frame(index)
            };
            let mut stream = FrameStream::with(Arc::new(decode), 0..40, FOUR);
            for next in 1..=40 {
                // The reader is most often there first, and waits.
                let gate = gate.clone();
                let opening = thread::spawn(move || {
                    *gate.0.lock().unwrap() = next;
                    gate.1.notify_all();
                });
                stream.next().unwrap().unwrap();
                opening.join().unwrap();
                assert!(stream.threads.len() <= 4 && stream.answers.len() <= 16);
            }
            assert!(stream.next().is_none());
        });
    }

    #[test]
    fn a_panic_is_one_frames_error() {
        in_time(|| {
            let decode = |index| match index {
                5 => panic!("on purpose"),
                _ => frame(index),
            };
            let stream = FrameStream::with(Arc::new(decode), 0..30, FOUR);
            let failed: Vec<bool> = stream.map(|frame| frame.is_err()).collect();
            assert_eq!(failed.iter().filter(|failed| **failed).count(), 1);
            assert!(failed[5]);
        });
    }

    #[test]
    fn memory_bounds_the_look_ahead() {
        let limits = |width, height, cores| {
            let Limits {
                threads,
                look_ahead,
            } = Limits::new(&camera(width, height), cores);
            (threads, look_ahead)
        };
        assert_eq!(limits(640, 480, 1), (2, 8));
        assert_eq!(limits(640, 480, 8), (8, 32));
        // 84 MB each.
        assert_eq!(limits(4000, 3000, 16), (2, 2));
        assert_eq!(limits(10_000, 10_000, 16), (2, 1));
        assert_eq!(limits(65_536, 65_536, 16), (2, 1));
    }
}
