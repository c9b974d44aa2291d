//! What the outside sees of a session while it runs: progress bars and viewers subscribe.
//!
//! Every subscriber has a bounded queue of its own. A full queue misses events and counts them, so
//! that nobody who looks on can hold up the tracker or the mapper. What is costly to make or to keep
//! (the map, images, masks) is made only when somebody asks for it, and lies only in the queue of who did.

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
    /// The map as it was a moment ago; comes to who asked for it.
    Snapshot(Arc<Gaussians>),
    /// The images of the frame that was tracked last; comes to who asked for it.
    Images(Arc<RgbdFrame>),
    /// What a keyframe gives to the map; comes to who asked for it.
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

/// What a subscriber has asked for and not yet been given.
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

    /// Asks for one [`SlamEvent::Snapshot`], which follows as soon as the mapper comes to it.
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

/// Hands events to subscribers. Clones share the subscribers.
#[derive(Clone, Default)]
pub(crate) struct EventHub {
    subscribers: Arc<Mutex<Vec<Subscriber>>>,
}

#[derive(Clone)]
struct Subscriber {
    events: Sender<SlamEvent>,
    missed: Arc<AtomicUsize>,
    wanted: Arc<Wanted>,
}

impl Subscriber {
    /// Hands an event over if the queue has room; false if nobody will ever take it.
    fn send(&self, event: SlamEvent) -> bool {
        match self.events.try_send(event) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.missed.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(TrySendError::Disconnected(_)) => false,
        }
    }
}

impl EventHub {
    /// A new subscriber whose queue holds `capacity` events.
    pub fn subscribe(&self, capacity: usize) -> Subscription {
        let (sender, events) = bounded(capacity);
        let (missed, wanted) = (Arc::default(), Arc::default());
        self.lock().push(Subscriber {
            events: sender,
            missed: Arc::clone(&missed),
            wanted: Arc::clone(&wanted),
        });
        Subscription {
            events,
            missed,
            wanted,
        }
    }

    /// Hands a map to who has asked for one, if anybody has.
    pub fn publish_snapshot<E>(
        &self,
        snapshot: impl FnOnce() -> Result<Gaussians, E>,
    ) -> Result<(), E> {
        let asking = self.take_requests(|wanted| &wanted.snapshot);
        if !asking.is_empty() {
            send_to(&asking, &SlamEvent::Snapshot(Arc::new(snapshot()?)));
        }
        Ok(())
    }

    /// Hands a frame's images to who has asked for some.
    pub fn publish_images(&self, frame: &Arc<RgbdFrame>) {
        let asking = self.take_requests(|wanted| &wanted.images);
        send_to(&asking, &SlamEvent::Images(Arc::clone(frame)));
    }

    /// Hands what a keyframe gives to the map to who has asked for it, if anybody has.
    pub fn publish_addition(&self, addition: impl FnOnce() -> Addition) {
        let asking = self.take_requests(|wanted| &wanted.addition);
        if !asking.is_empty() {
            send_to(&asking, &SlamEvent::Addition(Arc::new(addition())));
        }
    }

    /// Who has asked for something since the last call. The list is not locked while it is made: others
    /// have events to publish meanwhile.
    fn take_requests(&self, request: impl Fn(&Wanted) -> &AtomicBool) -> Vec<Subscriber> {
        let subscribers = self.lock();
        let asking = subscribers
            .iter()
            .filter(|subscriber| request(&subscriber.wanted).swap(false, Ordering::Relaxed));
        asking.cloned().collect()
    }

    /// Hands an event to everyone whose queue has room. Makes none where nobody looks on.
    pub fn publish(&self, event: impl FnOnce() -> SlamEvent) {
        let mut subscribers = self.lock();
        if subscribers.is_empty() {
            return;
        }
        let event = event();
        subscribers.retain(|subscriber| subscriber.send(event.clone()));
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

/// Whoever has gone away is forgotten with the next event for all.
fn send_to(asking: &[Subscriber], event: &SlamEvent) {
    for subscriber in asking {
        subscriber.send(event.clone());
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

    fn frame() -> Arc<RgbdFrame> {
        let intrinsics = Intrinsics {
            fx: 2.0,
            fy: 2.0,
            cx: 0.5,
            cy: 0.0,
        };
        let camera = Camera::new(2, 1, intrinsics).unwrap();
        let (color, depth_m) = (Image::filled(2, 1, [0; 3]), Image::filled(2, 1, 1.0));
        RgbdFrame::new(FrameIndex(7), 0.0, color, depth_m, camera)
            .unwrap()
            .into()
    }

    fn publish_all(hub: &EventHub) {
        hub.publish_images(&frame());
        hub.publish_addition(|| Addition {
            frame: frame(),
            detail: Image::filled(2, 1, true),
            missing: Image::filled(2, 1, false),
            seeds: 3,
        });
        let snapshot = || Ok::<_, ()>(Gaussians::default());
        hub.publish_snapshot(snapshot).unwrap();
    }

    #[test]
    fn what_is_costly_comes_once_for_each_time_it_is_asked_for() {
        let hub = EventHub::default();
        let subscription = hub.subscribe(9);
        subscription.request_images();
        subscription.request_addition();
        subscription.request_snapshot();
        publish_all(&hub);
        publish_all(&hub);
        let events: Vec<SlamEvent> = subscription.events().try_iter().collect();
        assert!(
            matches!(
                &events[..],
                [SlamEvent::Images(frame), SlamEvent::Addition(addition), SlamEvent::Snapshot(_)]
                    if frame.index.0 == 7 && addition.seeds == 3
            ),
            "{events:?}"
        );
    }

    #[test]
    fn what_is_costly_comes_only_to_who_asks_for_it() {
        let hub = EventHub::default();
        let (log, pictures, map) = (hub.subscribe(9), hub.subscribe(9), hub.subscribe(9));
        pictures.request_images();
        map.request_snapshot();
        publish_all(&hub);
        assert!(log.events().is_empty());
        let events = |subscription: &Subscription| -> Vec<SlamEvent> {
            subscription.events().try_iter().collect()
        };
        assert!(matches!(events(&pictures)[..], [SlamEvent::Images(_)]));
        assert!(matches!(events(&map)[..], [SlamEvent::Snapshot(_)]));
        assert_eq!(log.missed() + pictures.missed() + map.missed(), 0);
    }

    #[test]
    fn what_nobody_asks_for_is_not_made() {
        let hub = EventHub::default();
        let looker_on = hub.subscribe(1);
        hub.publish_addition(|| unreachable!("nobody has asked"));
        let snapshot = || -> Result<Gaussians, ()> { unreachable!("nobody has asked") };
        hub.publish_snapshot(snapshot).unwrap();
        looker_on.request_snapshot();
        assert_eq!(hub.publish_snapshot(|| Err("no device")), Err("no device"));
    }
}
