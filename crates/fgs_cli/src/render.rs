//! `fgs render`: pictures of a map, from the camera's poses or along a smooth path.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use anyhow::{Context, bail};
use clap::Args;
use fgs_data::Trajectory;
use fgs_geom::{Camera, CameraError, Intrinsics, Se3, View};
use fgs_run::{CONFIG, MAP, OutputFolder, RunError, Settings, TRAJECTORY, render_png};
use fgs_splat::Rasterizer;

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, UsageError};
use crate::fly_through::fly_through;
use crate::image_size::ImageSize;
use crate::interrupt;
use crate::threads::Threads;

/// Field of view for maps without a camera, degrees: about that of a depth sensor.
const DEFAULT_FOV_DEG: f64 = 60.0;
/// Image size for maps without a camera.
const DEFAULT_SIZE: ImageSize = ImageSize {
    width: 640,
    height: 480,
};

/// Render pictures of a map
///
/// Renders a map to PNG files, from poses of its trajectory or along a smooth path.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs render runs/desk                                       pictures in runs/desk/views
  fgs render runs/desk --fly-through --views 300 --size 1280x720 --fov 70
  fgs render runs/desk/refined.ply                           the map after --refine
  fgs render map.ply --trajectory poses.txt --out pictures

A film of it:  ffmpeg -framerate 30 -i runs/desk/fly-through/%06d.png film.mp4")]
pub struct RenderArgs {
    /// Folder of a run, or a PLY file with trajectory.txt beside it
    source: PathBuf,
    /// Folder for the pictures [default: views or fly-through, beside the map]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Follow the smoothed trajectory instead of showing some of its poses
    #[arg(long)]
    fly_through: bool,
    /// Number of pictures, evenly spread along the trajectory
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    views: u32,
    /// Size of the pictures [default: the camera's]
    #[arg(long, value_name = "WxH", value_parser = ImageSize::of_picture)]
    size: Option<ImageSize>,
    /// Horizontal field of view, degrees [default: the camera's]
    #[arg(long, value_name = "DEGREES")]
    fov: Option<f64>,
    /// Poses, in TUM's format [default: trajectory.txt beside the map]
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    #[command(flatten)]
    threads: Threads,
}

/// Executes `fgs render`.
///
/// # Errors
/// If map or trajectory cannot be read, or a picture cannot be written.
pub fn run(args: &RenderArgs) -> anyhow::Result<u8> {
    let is_run = args.source.is_dir();
    let map = if is_run {
        args.source.join(MAP)
    } else {
        args.source.clone()
    };
    let folder = map.parent().unwrap_or(Path::new("")).to_owned();
    let camera = camera(args, &folder)?;
    let trajectory = args
        .trajectory
        .clone()
        .unwrap_or_else(|| folder.join(TRAJECTORY));
    let trajectory = Trajectory::read(&trajectory)
        .context("no poses to render from (--trajectory FILE gives them)")?;
    if trajectory.poses().is_empty() {
        bail!("there are no poses to render from (--trajectory FILE gives others)");
    }
    let gaussians = fgs_splat::read_ply(&map)?;
    if gaussians.is_empty() {
        bail!("{} is empty: there is nothing to render", map.display());
    }
    let default_out = folder.join(if args.fly_through {
        "fly-through"
    } else {
        "views"
    });
    let out = OutputFolder::claim(args.out.as_ref().unwrap_or(&default_out));
    let out = out.map_err(RunError::from)?;
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;

    let poses: Vec<Se3> = trajectory
        .poses()
        .iter()
        .map(|pose| pose.world_from_camera)
        .collect();
    let views = args.views as usize;
    let path = if args.fly_through {
        fly_through(&poses, views)
    } else {
        spread(&poses, views)
    };
    let bar = Console::People.progress(path.len(), "views");
    let pictures = out
        .begin()
        .map_err(|error| cannot_write(out.path(), error))?;
    let mut rasterizer = Rasterizer::default();
    let mut count = 0;
    for (i, pose) in path.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let view = View {
            camera,
            world_from_camera: *pose,
        };
        let name = format!("{i:06}.png");
        let written = pictures.write(&name, |file| {
            render_png(&mut rasterizer, &gaussians, &view, file, &stop)
        });
        if written.is_err() && stop.load(Ordering::Relaxed) {
            break;
        }
        written.map_err(|error| cannot_write(&pictures.shown(&name), error))?;
        count += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    pictures.finish().map_err(RunError::from)?;
    Console::People.say(format!("{}: {count} pictures", out.path().display()));
    Ok(if count < path.len() {
        EXIT_INTERRUPTED
    } else {
        EXIT_DONE
    })
}

fn cannot_write(path: &Path, source: io::Error) -> RunError {
    RunError::Write {
        path: path.into(),
        source,
    }
}

/// At most `count` of the poses, evenly spread, including the first and the last.
fn spread(poses: &[Se3], count: usize) -> Vec<Se3> {
    let count = count.min(poses.len());
    let last = poses.len().saturating_sub(1);
    (0..count)
        .map(|i| poses[i * last / (count - 1).max(1)])
        .collect()
}

/// The run's camera, where the options do not override it.
fn camera(args: &RenderArgs, folder: &Path) -> anyhow::Result<Camera> {
    let config = folder.join(CONFIG);
    let recorded = if config.is_file() {
        Settings::read(&config)?.camera
    } else {
        None
    };
    let recorded = recorded.map(|file| *file.camera());
    let usage = |error: CameraError| UsageError(format!("--size or --fov: {error}"));
    let of_recorded = recorded.map(|camera| ImageSize {
        width: camera.width,
        height: camera.height,
    });
    let size = args.size.or(of_recorded).unwrap_or(DEFAULT_SIZE);
    match (recorded, args.fov) {
        (Some(camera), None) => Ok(camera.resized(size.width, size.height).map_err(usage)?),
        (_, fov) => {
            let fov_deg = fov.unwrap_or(DEFAULT_FOV_DEG);
            let refusal = |_| {
                let [least, most] = possible_fovs_deg(size);
                let ImageSize { width, height } = size;
                UsageError(format!(
                    "--fov {fov_deg}: pictures of {width}x{height} can show {least:.1} to {most:.1} degrees"
                ))
            };
            Ok(with_fov(size, fov_deg).map_err(refusal)?)
        }
    }
}

/// The narrowest and the widest field of view that [`Camera::new`] accepts, inward to a tenth of a
/// degree.
fn possible_fovs_deg(size: ImageSize) -> [f64; 2] {
    let tenths = |tan: f64| 20.0 * tan.atan().to_degrees();
    let half_width = 0.5 * size.width as f64 / size.width.max(size.height) as f64;
    [
        0.1 * tenths(half_width / 100.0).ceil(),
        0.1 * tenths(half_width / 0.1).floor(),
    ]
}

fn with_fov(size: ImageSize, fov_deg: f64) -> Result<Camera, CameraError> {
    let focal = 0.5 * size.width as f64 / (0.5 * fov_deg).to_radians().tan();
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal,
        cx: 0.5 * (size.width as f64 - 1.0),
        cy: 0.5 * (size.height as f64 - 1.0),
    };
    Camera::new(size.width, size.height, intrinsics)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize {
        width: 200,
        height: 100,
    };

    #[test]
    fn the_field_of_view_is_from_edge_to_edge() {
        let camera = with_fov(SIZE, 90.0).unwrap();
        assert!((camera.ray(-0.5, 0.0).x + 1.0).abs() <= 1e-12);
        assert!((camera.ray(199.5, 0.0).x - 1.0).abs() <= 1e-12);
        for fov in [0.0, 180.0, -60.0, f64::NAN] {
            assert!(with_fov(SIZE, fov).is_err(), "{fov}");
        }
        for fov in possible_fovs_deg(SIZE) {
            with_fov(SIZE, fov).unwrap();
        }
        let [least, most] = possible_fovs_deg(SIZE);
        assert!(with_fov(SIZE, least - 0.1).is_err() && with_fov(SIZE, most + 0.1).is_err());
    }

    #[test]
    fn views_are_spread_from_first_to_last() {
        let poses: Vec<Se3> = (0..10)
            .map(|i| {
                Se3::new(
                    Default::default(),
                    nalgebra::Vector3::new(f64::from(i), 0.0, 0.0),
                )
            })
            .collect();
        let xs = |count| -> Vec<f64> {
            spread(&poses, count)
                .iter()
                .map(|pose| pose.translation.x)
                .collect()
        };
        assert_eq!(xs(4), [0.0, 3.0, 6.0, 9.0]);
        assert_eq!(xs(1), [0.0]);
        assert_eq!(xs(99).len(), 10);
        assert!(spread(&[], 3).is_empty());
    }
}
