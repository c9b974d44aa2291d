//! The scores of a run, each declared once: its name in `metrics.json` (and, if frames have it, in
//! `frames.csv`), what it means, where it comes from, how it is averaged and how it is shown.
//!
//! To add one, add it to [`SCORES`]. Names and order are part of the files' format.

use fgs_eval::{Ate, DepthError, ImageQuality, Rpe};

/// A number that says how good a run is.
#[derive(Debug)]
pub struct Score {
    /// Its key in `metrics.json`, and its column in `frames.csv` if it is one of each frame.
    pub name: &'static str,
    /// One line for people.
    pub meaning: &'static str,
    /// Where it comes from.
    pub source: Source,
    /// How it stands in [`Metrics::table`](crate::Metrics::table), if it does.
    pub shown: Option<Shown>,
}

/// Where a score comes from. A score that is not defined is `None`.
#[derive(Debug)]
pub enum Source {
    /// The trajectory, compared with the ground truth.
    Trajectory(fn(&TrajectoryErrors) -> Option<f64>),
    /// Each frame, compared with the map rendered at its estimated pose. A run's score is the mean
    /// over the frames that have one.
    Frame(fn(&FrameErrors) -> Option<f64>),
    /// The mean of another, per-frame score over those frames that did not become keyframes, for whatever
    /// reason.
    HeldOut(&'static str),
    /// The mean of another, per-frame score over the test views: the frames that were kept out of the
    /// map on purpose ([`RunOptions::eval_holdout`](crate::RunOptions::eval_holdout)). Left out of
    /// `metrics.json` where it is not known.
    TestViews(&'static str),
}

/// How a score is printed: `scale * value` with so many decimals, then the unit.
#[derive(Debug)]
pub struct Shown {
    /// The line of the table that it is part of.
    pub line: &'static str,
    /// To the unit shown.
    pub scale: f64,
    /// Digits after the point.
    pub decimals: usize,
    /// The unit, and what tells it apart from its neighbours on the line.
    pub unit: &'static str,
}

/// A trajectory's errors, each `None` where there are too few poses.
#[derive(Debug)]
pub struct TrajectoryErrors {
    /// Absolute trajectory error after rigid alignment without scale.
    pub ate: Option<Ate>,
    /// Relative pose error between successive tracked frames.
    pub rpe: Option<Rpe>,
}

/// How the map, rendered at a frame's pose, differs from the frame.
#[derive(Debug)]
pub struct FrameErrors {
    /// Of colour.
    pub image: ImageQuality,
    /// Of depth; `None` if no pixel can be compared.
    pub depth: Option<DepthError>,
}

/// Every score, in the order of the files.
pub const SCORES: &[Score] = &[
    Score {
        name: "ate_rmse_m",
        meaning: "absolute trajectory error after rigid alignment without scale, root mean square",
        source: Source::Trajectory(|errors| Some(errors.ate.as_ref()?.translation_m.rmse)),
        shown: shown("ATE", 100.0, 3, " cm rmse"),
    },
    Score {
        name: "ate_mean_m",
        meaning: "the same, mean (what the paper calls RMSE)",
        source: Source::Trajectory(|errors| Some(errors.ate.as_ref()?.translation_m.mean)),
        shown: shown("ATE", 100.0, 3, " cm mean"),
    },
    Score {
        name: "rpe_mean_m",
        meaning: "relative pose error between successive tracked frames, mean translation",
        source: Source::Trajectory(|errors| Some(errors.rpe.as_ref()?.translation_m.mean)),
        shown: None,
    },
    Score {
        name: "psnr_valid_depth_db",
        meaning: "PSNR over the pixels with measured depth",
        source: Source::Frame(|errors| errors.image.psnr_valid_depth_db),
        shown: shown("PSNR", 1.0, 2, " dB where depth is measured"),
    },
    Score {
        name: "psnr_db",
        meaning: "PSNR over all pixels that the camera saw",
        source: Source::Frame(|errors| Some(errors.image.psnr_db)),
        shown: shown("PSNR", 1.0, 2, " dB everywhere"),
    },
    Score {
        name: "psnr_paper_db",
        meaning: "PSNR as the paper's code computes it: pixels without depth count as correct",
        source: Source::Frame(|errors| Some(errors.image.psnr_paper_db)),
        shown: None,
    },
    Score {
        name: "psnr_exposure_valid_depth_db",
        meaning: "psnr_valid_depth_db after each frame's gain and offset of each colour channel",
        source: Source::Frame(|errors| errors.image.psnr_exposure_valid_depth_db),
        shown: shown("PSNR", 1.0, 2, " dB with exposure"),
    },
    Score {
        name: "psnr_exposure_db",
        meaning: "psnr_db after each frame's gain and offset of each colour channel",
        source: Source::Frame(|errors| Some(errors.image.psnr_exposure_db)),
        shown: None,
    },
    Score {
        name: "psnr_heldout_db",
        meaning: "psnr_valid_depth_db over the frames that did not become keyframes, test views or not",
        source: Source::HeldOut("psnr_valid_depth_db"),
        shown: shown("PSNR", 1.0, 2, " dB held out"),
    },
    Score {
        name: "ssim",
        meaning: "structural similarity",
        source: Source::Frame(|errors| Some(errors.image.ssim)),
        shown: shown("SSIM", 1.0, 4, ""),
    },
    Score {
        name: "depth_l1_m",
        meaning: "mean absolute error of rendered depth",
        source: Source::Frame(|errors| Some(errors.depth?.l1_m)),
        shown: shown("depth L1", 100.0, 2, " cm"),
    },
    Score {
        name: "test_psnr_valid_depth_db",
        meaning: "psnr_valid_depth_db over the test views, which --eval-holdout kept out of the map",
        source: Source::TestViews("psnr_valid_depth_db"),
        shown: shown("test views", 1.0, 2, " dB where depth is measured"),
    },
    Score {
        name: "test_psnr_db",
        meaning: "psnr_db over the test views",
        source: Source::TestViews("psnr_db"),
        shown: shown("test views", 1.0, 2, " dB everywhere"),
    },
    Score {
        name: "test_psnr_exposure_valid_depth_db",
        meaning: "psnr_exposure_valid_depth_db over the test views",
        source: Source::TestViews("psnr_exposure_valid_depth_db"),
        shown: shown("test views", 1.0, 2, " dB with exposure"),
    },
    Score {
        name: "test_psnr_exposure_db",
        meaning: "psnr_exposure_db over the test views",
        source: Source::TestViews("psnr_exposure_db"),
        shown: None,
    },
    Score {
        name: "test_ssim",
        meaning: "ssim over the test views",
        source: Source::TestViews("ssim"),
        shown: shown("test views", 1.0, 4, " SSIM"),
    },
    Score {
        name: "test_depth_l1_m",
        meaning: "depth_l1_m over the test views",
        source: Source::TestViews("depth_l1_m"),
        shown: shown("test views", 100.0, 2, " cm depth L1"),
    },
];

const fn shown(
    line: &'static str,
    scale: f64,
    decimals: usize,
    unit: &'static str,
) -> Option<Shown> {
    Some(Shown {
        line,
        scale,
        decimals,
        unit,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_there_once_and_held_out_scores_exist() {
        for (place, score) in SCORES.iter().enumerate() {
            let first = SCORES.iter().position(|other| other.name == score.name);
            assert_eq!(first, Some(place), "{}", score.name);
            if let Source::HeldOut(of) | Source::TestViews(of) = score.source {
                let of = SCORES.iter().find(|other| other.name == of).unwrap();
                assert!(matches!(of.source, Source::Frame(_)), "{}", of.name);
            }
        }
    }
}
