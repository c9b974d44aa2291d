//! How well places are recognised on recordings with known poses.
//!
//! `cargo run --release -p fgs_place --example recall -- DIR...`, where each DIR is a recording of
//! another room. Every tenth frame of all recordings is a keyframe of one index, in which the other
//! frames look for their place. Keyframes within 30 frames of the one that looks do not count, as
//! if the camera came back later.
//!
//! For each recording and change of the images: the share of frames that find a keyframe with a
//! similar pose (within 0.3 m and 25 degrees), and one that shows at least half of the same
//! surfaces, as the most similar and among the five most similar, where there is one; the share of
//! frames whose best such keyframe is more similar than every keyframe is to all but 1 % of the
//! frames that show less than a tenth of it; and how far the most similar keyframe with enough
//! overlap is turned, before and after the shift is taken into account.

#![allow(clippy::print_stdout, reason = "an example prints")]

mod change;
mod recording;

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use anyhow::{Result, ensure};
use fgs_data::{Dataset, OpenOptions};
use fgs_geom::KeyframeId;
use fgs_place::{PlaceDescriptor, PlaceIndex, Similar};

use change::Change;
use recording::{Recording, Shot};

const KEYFRAME_EVERY: usize = 10;
const FRAMES_APART: usize = 30;

/// How a keyframe is related to the frame that looks for its place.
struct Relation {
    similar: Similar,
    /// Far enough in time to be an answer.
    counts: bool,
    has_near_pose: bool,
    /// Share of the surfaces of one that the other shows too; the smaller of the two.
    overlap: f64,
    degrees: f64,
    degrees_after_shift: f64,
}

fn main() -> Result<()> {
    let dirs: Vec<String> = std::env::args().skip(1).collect();
    ensure!(!dirs.is_empty(), "usage: recall DIR...");
    measure_time(Path::new(&dirs[0]))?;
    let mut recordings = Vec::new();
    for dir in &dirs {
        recordings.push(Recording::read(Path::new(dir))?);
    }
    let mut index = PlaceIndex::default();
    let mut keyframes = Vec::new();
    for (room, recording) in recordings.iter().enumerate() {
        for (frame, shot) in recording.shots.iter().enumerate().step_by(KEYFRAME_EVERY) {
            index.add(KeyframeId(keyframes.len() as u32), &shot.descriptors[0]);
            keyframes.push((room, frame));
        }
    }
    println!("{} keyframes", keyframes.len());
    for (change, kind) in Change::ALL.iter().enumerate() {
        let relations: Vec<Vec<Vec<Relation>>> = (recordings.iter().enumerate())
            .map(|(room, recording)| {
                let looking = (0..recording.shots.len()).filter(|i| i % KEYFRAME_EVERY != 0);
                looking
                    .map(|frame| {
                        let found = index
                            .most_similar(&recording.shots[frame].descriptors[change], usize::MAX);
                        let relate = |similar: Similar| {
                            let (of_room, of_frame) = keyframes[similar.id.0 as usize];
                            relation(
                                similar,
                                recording,
                                frame,
                                (of_room == room).then_some(of_frame),
                            )
                        };
                        found.into_iter().map(relate).collect()
                    })
                    .collect()
            })
            .collect();
        report(&dirs, *kind, &relations);
    }
    Ok(())
}

/// Of a frame to frame `keyframe` of the same recording, or to a keyframe of another room.
fn relation(
    similar: Similar,
    recording: &Recording,
    frame: usize,
    keyframe: Option<usize>,
) -> Relation {
    let Some(keyframe) = keyframe else {
        return Relation {
            similar,
            counts: true,
            has_near_pose: false,
            overlap: 0.0,
            degrees: f64::NAN,
            degrees_after_shift: f64::NAN,
        };
    };
    let (a, b): (&Shot, &Shot) = (&recording.shots[frame], &recording.shots[keyframe]);
    let keyframe_from_frame = b.world_from_camera.inverse() * a.world_from_camera;
    let guess = similar.keyframe_from_frame(&recording.camera);
    let degrees = keyframe_from_frame.rotation.angle().to_degrees();
    Relation {
        similar,
        counts: frame.abs_diff(keyframe) >= FRAMES_APART,
        has_near_pose: keyframe_from_frame.translation.norm() <= 0.3 && degrees <= 25.0,
        overlap: recording.overlap(a, b).min(recording.overlap(b, a)),
        degrees,
        degrees_after_shift: (guess.inverse() * keyframe_from_frame)
            .rotation
            .angle()
            .to_degrees(),
    }
}

fn report(dirs: &[String], change: Change, relations: &[Vec<Vec<Relation>>]) {
    let best_of = |found: &[Relation], is: &dyn Fn(&Relation) -> bool| {
        found.iter().find(|r| is(r)).map(|r| r.similar.similarity)
    };
    let mut false_ones: Vec<f64> = (relations.iter().flatten())
        .filter_map(|found| best_of(found, &|r| r.overlap < 0.1))
        .collect();
    false_ones.sort_by(f64::total_cmp);
    let strangers = relations
        .iter()
        .flatten()
        .flatten()
        .filter(|r| r.degrees.is_nan());
    let strangers: Vec<f64> = strangers.map(|r| r.similar.similarity).collect();
    let threshold = quantile(&false_ones, 0.99);
    println!(
        "{change:?}: unrelated images {:.3} in the mean; best wrong keyframe {:.2} (median), \
         {threshold:.2} (99 %), {:.2} (largest)",
        strangers.iter().sum::<f64>() / strangers.len() as f64,
        quantile(&false_ones, 0.5),
        quantile(&false_ones, 1.0),
    );
    for (dir, found) in dirs.iter().zip(relations) {
        let recall = |is: &dyn Fn(&Relation) -> bool| {
            let (mut can, mut first, mut in_five, mut sure) = (0.0, 0.0, 0.0, 0.0);
            for found in found {
                let counted: Vec<&Relation> = found.iter().filter(|r| r.counts).collect();
                let Some(rank) = counted.iter().position(|r| is(r)) else {
                    continue;
                };
                can += 1.0;
                first += f64::from(rank == 0);
                in_five += f64::from(rank < 5);
                sure += f64::from(counted[rank].similar.similarity > threshold);
            }
            if can == 0.0 {
                return "none".into();
            }
            format!(
                "{:.2} {:.2}, sure {:.2} (of {can})",
                first / can,
                in_five / can,
                sure / can
            )
        };
        let first = |value: &dyn Fn(&Relation) -> f64| {
            let firsts = found
                .iter()
                .filter_map(|found| found.iter().find(|r| r.counts && r.overlap >= 0.5));
            let mut values: Vec<f64> = firsts.map(value).collect();
            values.sort_by(f64::total_cmp);
            quantile(&values, 0.5)
        };
        let name = Path::new(dir)
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        println!(
            "  {name:14} near pose {}; overlap {}; turned {:.1} -> {:.1} degrees",
            recall(&|r| r.has_near_pose),
            recall(&|r| r.overlap >= 0.5),
            first(&|r| r.degrees),
            first(&|r| r.degrees_after_shift),
        );
    }
}

fn measure_time(dir: &Path) -> Result<()> {
    const TIMES: u32 = 100;
    const KEYFRAMES: u32 = 1000;
    let frame = Dataset::open(dir, &OpenOptions::default())?.frame(0)?;
    // The fastest of many: other programs may be running.
    let ms_each = |what: &dyn Fn()| {
        let times = (0..TIMES).map(|_| {
            let start = Instant::now();
            what();
            1e3 * start.elapsed().as_secs_f64()
        });
        times.fold(f64::INFINITY, f64::min)
    };
    let descriptor = PlaceDescriptor::new(&frame);
    let mut index = PlaceIndex::default();
    for id in 0..KEYFRAMES {
        index.add(KeyframeId(id), &descriptor);
    }
    println!(
        "{:.2} ms a descriptor, {:.2} ms a query of {KEYFRAMES} keyframes",
        ms_each(&|| _ = black_box(PlaceDescriptor::new(&frame))),
        ms_each(&|| _ = black_box(index.most_similar(&descriptor, 5))),
    );
    Ok(())
}

fn quantile(sorted: &[f64], q: f64) -> f64 {
    let at = (q * (sorted.len().max(1) - 1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}
