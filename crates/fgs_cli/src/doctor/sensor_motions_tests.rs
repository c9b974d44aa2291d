//! [`SensorWatch`] in the doctor's room.

use fgs_direct::{color_readout, depth_delay, depth_readout};
use fgs_geom::{DepthSensor, Se3, row_delay_secs};
use fgs_sensors::{SensorWatch, median};
use nalgebra::Vector6;

use super::test_room;

const FRAMES: usize = 60;

/// A recording of the room with the colour camera on a path, and the depth sensor beside it.
fn watch(path: impl Fn(f64) -> Se3, sensor: &DepthSensor) -> SensorWatch {
    let mut watch = SensorWatch::new(test_room::camera(), FRAMES);
    for i in 0..FRAMES {
        let t = i as f64 / 30.0;
        let world_from_depth = path(t + sensor.delay_secs) * sensor.color_from_depth;
        let mut frame = test_room::frame_of_sensors(i, &path(t), &world_from_depth);
        frame.depth_sensor.color_from_depth = sensor.color_from_depth;
        watch.add(&frame);
    }
    watch
}

#[test]
fn the_delay_of_a_depth_sensor_is_measured() {
    let beside = Se3::exp(&Vector6::new(0.04, -0.08, 0.03, 0.1, 0.0, 0.0));
    for (delay_secs, color_from_depth) in [
        (-0.012, Se3::identity()),
        (0.0, Se3::identity()),
        (0.02, beside),
    ] {
        let truth = DepthSensor {
            delay_secs,
            color_from_depth,
            ..DepthSensor::default()
        };
        let watch = watch(test_room::world_from_camera_at, &truth);
        let given = DepthSensor {
            delay_secs: 0.0,
            ..truth
        };
        let found = depth_delay(&watch.motions(), &given).unwrap();
        assert!((found.secs - delay_secs).abs() <= 5e-4, "{found:?}");
    }
}

#[test]
fn the_readouts_of_both_sensors_and_the_delay_between_them_are_measured() {
    let [color_secs, depth_secs, delay_secs] = [0.025, 0.032, -0.01];
    let height = test_room::camera().height;
    let mut watch = SensorWatch::new(test_room::camera(), FRAMES);
    for i in 0..FRAMES {
        // Twice as fast as the walk.
        let pose = |readout_secs: f64, delay_secs: f64| {
            let start = i as f64 / 30.0 + delay_secs;
            move |v| {
                let t = start + row_delay_secs(v, height, readout_secs);
                test_room::world_from_camera_at(2.0 * t)
            }
        };
        watch.add(&test_room::frame_of_rows(
            i,
            pose(color_secs, 0.0),
            pose(depth_secs, delay_secs),
        ));
    }
    let color = color_readout(&mut watch.color_pairs, 0.0).unwrap();
    let depth = depth_readout(&mut watch.depth_pairs, 0.0).unwrap();
    let delay = depth_delay(&watch.motions(), &DepthSensor::default()).unwrap();
    // Some per cent: the velocities are those of distorted images.
    assert!((color.secs - color_secs).abs() <= 1.5e-3, "{color:?}");
    assert!((depth.secs - depth_secs).abs() <= 1.5e-3, "{depth:?}");
    assert!((delay.secs - delay_secs).abs() <= 5e-4, "{delay:?}");
}

#[test]
fn a_camera_at_rest_and_one_that_does_not_turn() {
    let late = DepthSensor {
        delay_secs: -0.012,
        ..DepthSensor::default()
    };
    let rest = watch(|_| Se3::identity(), &late);
    assert!(depth_delay(&rest.motions(), &DepthSensor::default()).is_none());
    assert!(rest.speeds_px.iter().all(|speed| *speed <= 0.1));
    let shake = |t: f64| {
        let (x, y) = (0.1 * (5.0 * t).sin(), 0.08 * (4.0 * t).cos());
        Se3::exp(&Vector6::new(0.0, 0.0, 0.0, x, y, 0.0))
    };
    let shaken = watch(shake, &late);
    let found = depth_delay(&shaken.motions(), &DepthSensor::default()).unwrap();
    assert!((found.secs + 0.012).abs() <= 1e-3, "{found:?}");
    // 180 px * 0.4 m/s / 2 m.
    let speed = median(shaken.speeds_px).unwrap();
    assert!((20.0..50.0).contains(&speed), "{speed}");
}

#[test]
fn no_motion_is_measured_across_an_interruption() {
    let mut watch = SensorWatch::new(test_room::camera(), FRAMES);
    for i in 0..40 {
        if i == 20 {
            watch.interrupt();
        }
        watch.add(&test_room::frame(i));
    }
    // Twice, those that end at the frames 8 to 17 of 20.
    assert_eq!(watch.motions().len(), 20);
}
