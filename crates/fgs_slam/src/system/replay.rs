//! Feeds a recording at its own pace, as a camera would have delivered it.
//!
//! A frame that finds the tracker busy waits. Only one that has waited too long is dropped, since
//! every frame left out makes the next motion larger and tracking less safe. What counts is time
//! spent waiting for the tracker: a source that is itself late, or a clock that runs slow, delays
//! the replay and drops nothing.

use std::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fgs_geom::RgbdFrame;

use super::drive::{push, until_stopped};
use crate::session::Slam;

/// How long a frame may wait for the tracker: three frames at 30 a second, enough to make up for a
/// moment's delay, and less than people notice as lag.
pub(super) const MAX_WAIT: Duration = Duration::from_millis(100);

/// A recording that pauses for longer goes on after so long.
const MAX_PAUSE: Duration = Duration::from_secs(1);

/// How often a wait looks at the stop flag.
pub(super) const GLANCE: Duration = Duration::from_millis(20);

/// Pushes each frame at its time until they end, `stop` is set or the mapper is gone. Frames that
/// waited longer than 100 ms for the tracker are recorded as dropped.
pub fn replay<E: Error>(
    slam: &mut Slam,
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    stop: &AtomicBool,
) {
    replay_with(slam, frames, stop, |_| {});
}

/// As [`replay`], and calls `after_frame` after each frame. The recording's clock stands still meanwhile.
pub fn replay_with<E: Error>(
    slam: &mut Slam,
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    stop: &AtomicBool,
    after_frame: impl FnMut(&mut Slam),
) {
    until_stopped(slam, stop, |slam| {
        replay_until(slam, frames, stop, after_frame);
    });
}

fn replay_until<E: Error>(
    slam: &mut Slam,
    mut frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    stop: &AtomicBool,
    mut after_frame: impl FnMut(&mut Slam),
) {
    let mut clock = Clock::default();
    while !stop.load(Ordering::Relaxed) {
        let asked = Instant::now();
        let Some(frame) = frames.next() else { return };
        let alive = match frame {
            Err(_) => push(slam, frame),
            Ok(frame) => {
                let due = clock.due(frame.timestamp_secs, asked, Instant::now());
                if !wait_until(slam, due, stop) {
                    return;
                }
                if Instant::now() > due + MAX_WAIT {
                    slam.skip_late(&frame);
                    true
                } else {
                    push(slam, Ok::<_, E>(frame))
                }
            }
        };
        let pause = Instant::now();
        after_frame(slam);
        clock.stand_still(pause.elapsed());
        if !alive {
            return;
        }
    }
}

/// `false` if the session has ended or was stopped meanwhile.
fn wait_until(slam: &Slam, due: Instant, stop: &AtomicBool) -> bool {
    loop {
        let glance = Instant::now() + GLANCE;
        if !slam.wait_until(due.min(glance)) || stop.load(Ordering::Relaxed) {
            return false;
        }
        if due <= glance {
            return true;
        }
    }
}

/// Lays the recording's clock over the wall clock.
#[derive(Default)]
struct Clock {
    last: Option<(f64, Instant)>,
}

impl Clock {
    /// When a frame is due that was asked for and came at these times.
    ///
    /// Where time stamps do not advance (constant, backward, no numbers), it is due as it comes.
    fn due(&mut self, timestamp_secs: f64, asked: Instant, came: Instant) -> Instant {
        let due = self
            .last
            .and_then(|(last_secs, last_due)| {
                let interval = Duration::try_from_secs_f64(timestamp_secs - last_secs).ok()?;
                if interval.is_zero() {
                    return None;
                }
                let due = last_due + interval.min(MAX_PAUSE);
                // What the source took beyond its own time is not the tracker's delay.
                let late = came.saturating_duration_since(due.max(asked));
                Some(due + late)
            })
            .unwrap_or(came);
        self.last = Some((timestamp_secs, due));
        due
    }

    /// Everything that follows is due so much later.
    fn stand_still(&mut self, duration: Duration) {
        if let Some((_, due)) = &mut self.last {
            *due += duration;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Duration = Duration::from_millis(33);

    /// How late each frame is found to be whose time stamp, and whose times asked for and delivered
    /// (milliseconds from the start), are given.
    fn lateness(frames: &[(f64, u64, u64)]) -> Vec<Duration> {
        let (mut clock, start) = (Clock::default(), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        frames
            .iter()
            .map(|&(secs, asked, came)| {
                let due = clock.due(secs, at(asked), at(came));
                at(came).saturating_duration_since(due)
            })
            .collect()
    }

    #[test]
    fn a_slow_tracker_makes_frames_late() {
        // Asked for a frame every 60 ms where one comes every 33.
        let frames: Vec<_> = (0..10)
            .map(|i| (0.033 * i as f64, 60 * i, 60 * i))
            .collect();
        let late = lateness(&frames);
        for (i, late) in late.iter().enumerate() {
            let expected = Duration::from_millis(27 * i as u64);
            assert!(
                late.abs_diff(expected) <= Duration::from_millis(1),
                "frame {i}"
            );
        }
    }

    #[test]
    fn a_slow_source_and_a_slow_clock_make_none_late() {
        // The source blocks until each frame comes, 40 ms apart by the wall; by its clock 30 ms.
        let frames: Vec<_> = (0..50)
            .map(|i| (0.030 * i as f64, 40 * i, 40 * (i + 1)))
            .collect();
        assert!(lateness(&frames).iter().all(Duration::is_zero));
    }

    #[test]
    fn what_is_done_between_frames_makes_none_late() {
        let (mut clock, start) = (Clock::default(), Instant::now());
        clock.due(0.0, start, start);
        clock.stand_still(20 * FRAME);
        let asked = start + 20 * FRAME;
        assert_eq!(clock.due(0.033, asked, asked), start + 21 * FRAME);
    }

    #[test]
    fn time_stamps_that_do_not_advance_make_none_late() {
        let stamps: [fn(u64) -> f64; 3] = [|_| 5.0, |_| f64::NAN, |i| -(i as f64)];
        for stamp in stamps {
            let frames: Vec<_> = (0..50).map(|i| (stamp(i), 60 * i, 60 * i)).collect();
            assert!(lateness(&frames).iter().all(Duration::is_zero));
        }
    }

    #[test]
    fn a_pause_is_cut_short_and_early_frames_wait() {
        let (mut clock, start) = (Clock::default(), Instant::now());
        clock.due(0.0, start, start);
        assert_eq!(clock.due(0.033, start, start), start + FRAME);
        assert_eq!(clock.due(500.0, start, start), start + FRAME + MAX_PAUSE);
    }
}
