//! The stream: order, errors in the middle, early ends.

mod common;

use std::fs;
use std::sync::mpsc;
use std::time::Duration;

use common::*;
use fgs_data::{Dataset, OpenOptions};

#[test]
fn frames_come_in_order_and_again() {
    let folder = tum(30);
    let dataset = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
    // Two streams at once, one of a part.
    let all = dataset.frames(0..usize::MAX);
    let part = dataset.frames(7..20);
    assert_eq!((all.size_hint().0, part.size_hint().0), (30, 13));
    let indices: Vec<_> = part.map(|frame| frame.unwrap().index.0).collect();
    assert_eq!(indices, (7..20).collect::<Vec<_>>());
    for (i, frame) in all.enumerate() {
        let (streamed, single) = (frame.unwrap(), dataset.frame(i).unwrap());
        assert_eq!(streamed.color, single.color);
        assert_eq!(streamed.depth_m, single.depth_m);
        assert_eq!(streamed.timestamp_secs, single.timestamp_secs);
    }
    assert_eq!(dataset.frames(40..50).count(), 0);
    assert!(dataset.frame(30).is_err());
}

#[test]
fn a_damaged_frame_is_one_error_in_the_middle() {
    let folder = tum(30);
    for damaged in ["rgb/11.png", "depth/12.png"] {
        fs::write(folder.path().join(damaged), "no image").unwrap();
    }
    let dataset = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
    for (i, frame) in dataset.frames(0..30).enumerate() {
        match frame {
            Ok(frame) => assert_eq!(frame.index.0, i),
            Err(error) => assert!(error.to_string().contains(&format!("/{i}.png")), "{error}"),
        }
    }
    assert_eq!(dataset.frames(0..30).filter(Result::is_err).count(), 2);
}

/// A file removed after the first frame was taken is missed if it lies beyond the look-ahead.
#[test]
fn no_more_is_decoded_than_the_look_ahead() {
    let folder = tum(30);
    let dataset = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
    let mut stream = dataset.frames(0..30);
    assert!(stream.next().unwrap().is_ok());
    fs::remove_file(folder.path().join("rgb/20.png")).unwrap();
    let failed: Vec<_> = (1..30)
        .filter(|_| stream.next().unwrap().is_err())
        .collect();
    assert_eq!(failed, [20]);
    assert!(stream.next().is_none());
}

/// Dropping joins the threads, so coming back means that none is left behind.
#[test]
fn dropping_a_stream_early_ends_its_threads() {
    let (done, finished) = mpsc::channel();
    std::thread::spawn(move || {
        let folder = tum(30);
        let dataset = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
        for taken in 0..12 {
            let mut stream = dataset.frames(0..30);
            assert_eq!(stream.by_ref().take(taken).count(), taken);
        }
        done.send(()).unwrap();
    });
    finished.recv_timeout(Duration::from_secs(30)).unwrap();
}
