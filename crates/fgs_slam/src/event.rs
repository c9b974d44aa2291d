//! What the outside sees of a session while it runs: progress bars and viewers subscribe.
//!
//! Every subscriber has a bounded queue of its own. A full queue misses events and counts them, so
//! that nobody who looks on can hold up the tracker or the mapper.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use fgs_geom::{Image, KeyframeId, RgbdFrame, Se3};
use fgs_splat::Gaussians;

use crate::frame_result::FrameResult;

/// Something that happened.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum SlamEvent {
    /// A frame was tracked, weak, lost, dropped or found damaged.
    Frame {
        /// What became of it.
        result: Box<FrameResult>,
        /// Why it is damaged, if it is.
        error: Option<String>,
        /// Gaussians in the map, as far as known.
        num_gaussians: usize,
        /// Optimisation steps so far, as far as known.
        steps: usize,
    },
    /// Keyframes have new poses `world_from_camera`; the map has moved with them.
    Correction(Arc<[(KeyframeId, Se3)]>),
    /// The camera is back where it was: keyframe `to` shows what the older `from` shows. What drifted
    /// between them is taken out; a [`Correction`](Self::Correction) follows.
    Loop {
        /// The older keyframe.
        from: KeyframeId,
        /// The newer one.
        to: KeyframeId,
    },
    /// The map was refined by one more step, after the last frame.
    Refined {
        /// Steps taken so far.
        done: usize,
        /// Steps asked for.
        steps: usize,
    },
    /// The map as it was a moment ago; comes when a subscriber asked for it.
    Snapshot(Arc<Gaussians>),
    /// The images of the frame that was tracked last; comes when a subscriber asked for it.
    Images(Arc<RgbdFrame>),
    /// What a keyframe gives to the map; comes when a subscriber asked for it.
    Addition(Arc<Addition>),
}

/// What a keyframe gives to the map.
#[derive(Clone, Debug)]
pub struct Addition {
    /// The keyframe's images.
    pub frame: Arc<RgbdFrame>,
    /// Where the image has detail, by its frequencies: seeds stand close there. Of the image's size.
    pub detail: Image<bool>,
    /// Where the map lacked gaussians. Of the image's size.
    pub missing: Image<bool>,
    /// How many gaussians are added.
    pub seeds: usize,
}

/// One who looks on. Dropping it ends the subscription.
#[derive(Debug)]
pub struct Subscription {
    events: Receiver<SlamEvent>,
    missed: Arc<AtomicUsize>,
    wanted: Arc<Wanted>,
}

/// What is costly to hand out and is made only if somebody has asked for it since it was made last.
#[derive(Debug, Default)]
struct Wanted {
    snapshot: AtomicBool,
    images: AtomicBool,
    addition: AtomicBool,
}

impl Subscription {
    /// The queue; it is disconnected when the session has ended.
    pub fn events(&self) -> &Receiver<SlamEvent> {
        &self.events
    }

    /// How many events were missed because the queue was full.
    pub fn missed(&self) -> usize {
        self.missed.load(Ordering::Relaxed)
    }

    /// Asks for a [`SlamEvent::Snapshot`], which follows as soon as the mapper comes to it.
    pub fn request_snapshot(&self) {
        self.wanted.snapshot.store(true, Ordering::Relaxed);
    }

    /// Asks for [`SlamEvent::Images`] of the next frame that is tracked.
    pub fn request_images(&self) {
        self.wanted.images.store(true, Ordering::Relaxed);
    }

    /// Asks for [`SlamEvent::Addition`] of the next keyframe that joins the map.
    pub fn request_addition(&self) {
        self.wanted.addition.store(true, Ordering::Relaxed);
    }
}

/// Hands events to every subscriber. Clones share the subscribers.
#[derive(Clone, Default)]
pub(crate) struct EventHub {
    subscribers: Arc<Mutex<Vec<Subscriber>>>,
    wanted: Arc<Wanted>,
}

struct Subscriber {
    events: Sender<SlamEvent>,
    missed: Arc<AtomicUsize>,
}

impl EventHub {
    /// A new subscriber whose queue holds `capacity` events.
    pub fn subscribe(&self, capacity: usize) -> Subscription {
        let (sender, events) = bounded(capacity);
        let missed = Arc::new(AtomicUsize::new(0));
        self.lock().push(Subscriber {
            events: sender,
            missed: Arc::clone(&missed),
        });
        Subscription {
            events,
            missed,
            wanted: Arc::clone(&self.wanted),
        }
    }

    /// Whether a snapshot was asked for since the last call.
    pub fn take_snapshot_request(&self) -> bool {
        self.wanted.snapshot.swap(false, Ordering::Relaxed)
    }

    /// Hands out a frame's images if somebody has asked for them.
    pub fn publish_images(&self, frame: &Arc<RgbdFrame>) {
        if self.wanted.images.swap(false, Ordering::Relaxed) {
            self.publish(|| SlamEvent::Images(Arc::clone(frame)));
        }
    }

    /// Hands out what a keyframe gives to the map if somebody has asked for it.
    pub fn publish_addition(&self, addition: impl FnOnce() -> Addition) {
        if self.wanted.addition.swap(false, Ordering::Relaxed) {
            self.publish(|| SlamEvent::Addition(Arc::new(addition())));
        }
    }

    /// Hands an event to everyone whose queue has room. Makes none where nobody looks on.
    pub fn publish(&self, event: impl FnOnce() -> SlamEvent) {
        let mut subscribers = self.lock();
        if subscribers.is_empty() {
            return;
        }
        let event = event();
        subscribers.retain(
            |subscriber| match subscriber.events.try_send(event.clone()) {
                Ok(()) => true,
                Err(TrySendError::Full(_)) => {
                    subscriber.missed.fetch_add(1, Ordering::Relaxed);
                    true
                }
                Err(TrySendError::Disconnected(_)) => false,
            },
        );
    }

    /// Ends all subscriptions: their queues are disconnected once emptied.
    pub fn close(&self) {
        self.lock().clear();
    }

    /// A subscriber list is whole at every moment, also if a thread died holding the lock.
    fn lock(&self) -> MutexGuard<'_, Vec<Subscriber>> {
        self.subscribers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, FrameIndex, Intrinsics};

    use super::*;

    fn snapshot() -> SlamEvent {
        SlamEvent::Snapshot(Arc::default())
    }

    #[test]
    fn a_full_queue_misses_and_counts_and_the_others_do_not() {
        let hub = EventHub::default();
        let (slow, fast) = (hub.subscribe(2), hub.subscribe(5));
        for _ in 0..5 {
            hub.publish(snapshot);
        }
        assert_eq!((slow.missed(), slow.events().len()), (3, 2));
        assert_eq!((fast.missed(), fast.events().len()), (0, 5));
        slow.events().try_iter().for_each(drop);
        hub.publish(snapshot);
        assert_eq!((slow.missed(), slow.events().len()), (3, 1));
    }

    #[test]
    fn a_dropped_subscription_is_forgotten_and_a_closed_hub_disconnects() {
        let hub = EventHub::default();
        drop(hub.subscribe(1));
        let kept = hub.subscribe(1);
        hub.publish(snapshot);
        assert_eq!(hub.lock().len(), 1);
        hub.close();
        assert!(kept.events().recv().is_ok());
        assert!(kept.events().recv().is_err());
        hub.publish(|| unreachable!("nobody looks on"));
    }

    #[test]
    fn an_addition_is_handed_out_once_for_each_time_it_is_asked_for() {
        let hub = EventHub::default();
        let subscription = hub.subscribe(5);
        let intrinsics = Intrinsics {
            fx: 2.0,
            fy: 2.0,
            cx: 0.5,
            cy: 0.0,
        };
        let camera = Camera::new(2, 1, intrinsics).unwrap();
        let (color, depth_m) = (Image::filled(2, 1, [0; 3]), Image::filled(2, 1, 1.0));
        let frame = RgbdFrame::new(FrameIndex(7), 0.0, color, depth_m, camera);
        let frame = Arc::new(frame.unwrap());
        let addition = || Addition {
            frame: Arc::clone(&frame),
            detail: Image::filled(2, 1, true),
            missing: Image::filled(2, 1, false),
            seeds: 3,
        };
        hub.publish_addition(|| unreachable!("nobody has asked"));
        subscription.request_addition();
        hub.publish_addition(addition);
        hub.publish_addition(addition);
        let events: Vec<SlamEvent> = subscription.events().try_iter().collect();
        assert!(
            matches!(&events[..], [SlamEvent::Addition(a)] if a.frame.index.0 == 7 && a.seeds == 3)
        );
    }

    #[test]
    fn a_snapshot_is_asked_for_once() {
        let hub = EventHub::default();
        let subscription = hub.subscribe(1);
        assert!(!hub.take_snapshot_request());
        subscription.request_snapshot();
        assert!(hub.take_snapshot_request() && !hub.take_snapshot_request());
    }
}
