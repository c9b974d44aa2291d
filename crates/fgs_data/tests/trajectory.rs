//! Trajectory files.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;

use common::*;
use fgs_data::{DataError, LineFault, Trajectory};
use fgs_geom::Se3;
use nalgebra::{Vector3, Vector6};

fn made() -> Trajectory {
    let times = (0..20).map(|i| 1_300_000_000.123456 + f64::from(i) / 30.0);
    Trajectory::new(times.map(|secs| (secs, pose_at(secs % 10.0)))).unwrap()
}

#[test]
fn what_is_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectory.txt");
    fs::write(&path, "an older file").unwrap();
    made().write(&path).unwrap();
    let read = Trajectory::read(&path).unwrap();
    assert_eq!(read.poses().len(), 20);
    for (read, made) in read.poses().iter().zip(made().poses()) {
        assert_eq!(read.timestamp_secs, made.timestamp_secs);
        assert_eq!(
            read.world_from_camera.translation,
            made.world_from_camera.translation
        );
        let error = read.world_from_camera.inverse() * made.world_from_camera;
        assert!(error.log().amax() <= 1e-14);
    }
    // Nothing but the file itself is left.
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn columns_are_position_then_xyzw() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectory.txt");
    // A quarter turn about z takes x to y.
    fs::write(&path, "5.5 1 2 3 0 0 0.70710678 0.70710678\n").unwrap();
    let read = Trajectory::read(&path).unwrap();
    let moved = read.at(5.5).unwrap().transform(&Vector3::x());
    assert!((moved - Vector3::new(1.0, 3.0, 3.0)).amax() <= 1e-12);
    read.write(&path).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    let line = text.lines().nth(1).unwrap();
    assert!(line.starts_with("5.5 1 2 3 0 0 0.707106781"), "{line}");
}

#[test]
fn a_file_that_cannot_be_written_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let occupied = folder.path().join("occupied");
    fs::create_dir_all(occupied.join("by a folder")).unwrap();
    let error = made().write(&occupied).unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with(&occupied.display().to_string())
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    assert!(made().write(&folder.path().join("absent/file")).is_err());
}

#[test]
fn faults_name_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectory.txt");
    let fault = |second: &str| {
        fs::write(&path, format!("# head\n1 0 0 0 0 0 0 1\n{second}\n")).unwrap();
        match Trajectory::read(&path).unwrap_err() {
            DataError::Line { line: 3, fault, .. } => fault,
            other => panic!("{other}"),
        }
    };
    let nan = LineFault::NotANumber("nan".into());
    assert_eq!(fault("2 0 nan 0 0 0 0 1"), nan);
    assert_eq!(fault("2 0 0 0 0 0 0 0"), LineFault::Quaternion(0.0));
    assert_eq!(fault("2 0 0 0 1 1 1 1"), LineFault::Quaternion(2.0));
    assert_eq!(fault("2 0 0 2e6 0 0 0 1"), LineFault::OutOfRange(2e6));
    let (expected, found) = (8, 7);
    assert_eq!(
        fault("2 0 0 0 0 0 1"),
        LineFault::Columns { expected, found }
    );
    let (previous, current) = (1.0, 1.0);
    assert_eq!(
        fault("1 0 0 0 0 0 0 1"),
        LineFault::NotIncreasing { previous, current }
    );
}

#[test]
fn poses_that_are_no_trajectory() {
    let pose = Se3::identity();
    let fault = |poses: [(f64, Se3); 2]| match Trajectory::new(poses).unwrap_err() {
        DataError::Pose { index, fault } => (index, fault),
        other => panic!("{other}"),
    };
    let (previous, current) = (2.0, 1.0);
    assert_eq!(
        fault([(2.0, pose), (1.0, pose)]),
        (1, LineFault::NotIncreasing { previous, current })
    );
    let mut lost = pose;
    lost.translation.y = f64::NAN;
    assert!(matches!(
        fault([(0.0, lost), (1.0, pose)]),
        (0, LineFault::OutOfRange(_))
    ));
    assert!(matches!(
        fault([(f64::NAN, pose), (1.0, pose)]),
        (0, LineFault::OutOfRange(_))
    ));
}

#[test]
fn interpolation_stays_between_neighbours() {
    let at = |secs: f64| (secs, pose_at(secs));
    let trajectory = Trajectory::new([at(0.0), at(0.1), at(0.5)]).unwrap();
    let error = |secs: f64, max_gap_secs: f64| {
        let pose = trajectory.interpolate(secs, max_gap_secs)?;
        Some((pose.inverse() * pose_at(secs)).log().amax())
    };
    assert!(error(0.03, 0.11).unwrap() <= 1e-12);
    assert!(error(0.4, 0.41).unwrap() <= 1e-12);
    assert_eq!(error(0.4, 0.39), None);
    assert_eq!(error(-0.01, 1.0), None);
    assert_eq!(error(0.51, 1.0), None);
    assert_eq!(error(f64::NAN, 1.0), None);
    assert_eq!(trajectory.at(0.5), Some(pose_at(0.5)));
    assert_eq!(trajectory.at(0.05), None);
    assert_eq!(Trajectory::default().interpolate(0.0, 1.0), None);
}

#[test]
fn velocity_is_that_of_the_neighbours_where_they_are_near() {
    let twist = Vector6::new(0.3, -0.5, 0.2, 0.1, 0.4, -0.2);
    let start = pose_at(3.0);
    let steady = |secs: f64| (secs, start * Se3::exp(&(secs * twist)));
    // Uneven steps, and a gap of a second.
    let trajectory = Trajectory::new([0.0, 0.1, 0.15, 1.15, 1.25].map(steady)).unwrap();
    for secs in [0.0, 0.1, 0.15, 1.15, 1.25] {
        let error = trajectory.velocity(secs, 0.2) - twist;
        assert!(error.amax() <= 1e-9, "{secs}: {error}");
    }
    // Not a pose's time; no neighbour near enough.
    for (secs, max_gap_secs) in [
        (0.12, 0.2),
        (-1.0, 9.0),
        (9.0, 9.0),
        (1.15, 0.05),
        (f64::NAN, 9.0),
    ] {
        assert_eq!(trajectory.velocity(secs, max_gap_secs), Vector6::zeros());
    }
}
