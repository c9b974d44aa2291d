//! A run's numbers with what they mean: the scores as [`SCORES`](crate::SCORES) declares them, and counts and costs.

use super::run_data::RunData;

/// A number of a run.
pub struct Number {
    /// Its key in `metrics.json`.
    pub name: &'static str,
    pub meaning: &'static str,
    pub value: Option<f64>,
    /// The same of the refined map.
    pub refined: Option<f64>,
}

/// Every number of a run, in the same order for every run.
pub fn numbers(run: &RunData) -> Vec<Number> {
    let refined = run.metrics.refined.as_ref();
    let scores = run.metrics.scores.iter().map(|(score, value)| Number {
        name: score.name,
        meaning: score.meaning,
        value,
        refined: refined.and_then(|refined| refined.scores.get(score.name)),
    });
    scores.chain(counts(run)).collect()
}

fn counts(run: &RunData) -> Vec<Number> {
    let metrics = &run.metrics;
    let refined = metrics.refined.as_ref();
    let number = |name, meaning, value| Number {
        name,
        meaning,
        value,
        refined: None,
    };
    let count = |name, meaning, value: usize| number(name, meaning, Some(value as f64));
    vec![
        count(
            "frames",
            "frames that arrived, whatever became of them",
            metrics.frames,
        ),
        count(
            "frames_weak",
            "of those: a pose that is probably right, on which nothing was built",
            metrics.frames_weak,
        ),
        count(
            "frames_lost",
            "of those: no pose that can be trusted",
            metrics.frames_lost,
        ),
        count(
            "frames_damaged",
            "of those: could not be read",
            metrics.frames_damaged,
        ),
        count(
            "frames_dropped",
            "of those: arrived too late in real time",
            metrics.frames_dropped,
        ),
        count("keyframes", "keyframes of both kinds", metrics.keyframes),
        count(
            "loops",
            "times that the camera was found to be back at a place and drift was taken out",
            metrics.loops,
        ),
        count("iterations", "optimisation steps", metrics.iterations),
        number(
            "iterations_per_frame",
            "optimisation steps per frame tracked or lost",
            metrics.iterations_per_frame,
        ),
        number(
            "fps",
            "frames per second of wall-clock time, decoding included",
            metrics.fps,
        ),
        Number {
            refined: refined.map(|refined| refined.num_gaussians as f64),
            ..count(
                "num_gaussians",
                "gaussians in the map",
                metrics.num_gaussians,
            )
        },
        Number {
            refined: refined.map(|refined| refined.map_bytes as f64),
            ..number(
                "map_bytes",
                "size of the map's file",
                Some(metrics.map_bytes as f64),
            )
        },
        number(
            "peak_rss_bytes",
            "peak resident memory of the process",
            metrics.peak_rss_bytes.map(|bytes| bytes as f64),
        ),
        number(
            "device_bytes",
            "memory that the map takes on the graphics device",
            Some(metrics.device_bytes as f64),
        ),
    ]
}
