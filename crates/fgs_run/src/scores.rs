//! The scores of a run, each declared once: its name in `metrics.json` (and, if frames have it, in
//! `frames.csv`), what it means, where it comes from, how it is averaged and how it is shown.
//!
//! To add one, add it to [`SCORES`]. Names and order are part of the files' format.

use std::fmt;

use fgs_eval::{Ate, DepthError, ImageQuality, Rpe};
use fgs_slam::Holdout;
use serde::de::{IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::frame_log::FrameRow;

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
    /// The mean of another, per-frame score over those frames that happened not to become keyframes.
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
        meaning: "psnr_valid_depth_db over the frames that happened not to become keyframes",
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

/// A value for each of [`SCORES`], of a run or of a frame; `None` where it is not computed or not
/// defined. Serialised as a map from name to value.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scores([Option<f64>; SCORES.len()]);

impl Scores {
    /// One frame's scores.
    pub fn of_frame(errors: &FrameErrors) -> Self {
        let mut scores = Self::default();
        scores.update(|score| match score.source {
            Source::Frame(value) => Some(value(errors)),
            _ => None,
        });
        scores
    }

    /// The score of this name; `None` also if there is no such score.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0[SCORES.iter().position(|score| score.name == name)?]
    }

    /// Every score with its value, in order.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Score, Option<f64>)> {
        SCORES.iter().zip(self.0)
    }

    /// Takes over the scores of a trajectory.
    pub fn set_trajectory(&mut self, errors: &TrajectoryErrors) {
        self.update(|score| match score.source {
            Source::Trajectory(value) => Some(value(errors)),
            _ => None,
        });
    }

    /// Takes over the means of the frames' scores. `rows` are of a run's successive frames, from its
    /// first.
    pub fn set_means(&mut self, rows: &[FrameRow], holdout: Option<Holdout>) {
        let of = |name, counts: &dyn Fn(usize, &FrameRow) -> bool| {
            let counted = rows.iter().enumerate();
            let counted = counted.filter(|(place, row)| counts(*place, row));
            mean(counted.filter_map(|(_, row)| row.scores.get(name)))
        };
        let is_test_view = |place| holdout.is_some_and(|holdout| holdout.contains(place));
        self.update(|score| match score.source {
            Source::Trajectory(_) => None,
            Source::Frame(_) => Some(of(score.name, &|_, _| true)),
            Source::HeldOut(name) => Some(of(name, &|_, row| row.keyframe.is_none())),
            Source::TestViews(name) => Some(of(name, &|place, _| is_test_view(place))),
        });
    }

    /// The scores that are shown and known: the name of each line of the table, and its text.
    pub(crate) fn shown(&self) -> Vec<(&'static str, String)> {
        let mut lines: Vec<(&str, String)> = Vec::new();
        for (score, value) in self.iter() {
            let (Some(shown), Some(value)) = (&score.shown, value) else {
                continue;
            };
            let text = format!("{:.*}{}", shown.decimals, shown.scale * value, shown.unit);
            match lines.last_mut() {
                Some((line, texts)) if *line == shown.line => *texts += &format!(", {text}"),
                _ => lines.push((shown.line, text)),
            }
        }
        lines
    }

    /// Serialises the scores that are known.
    pub(crate) fn serialize_known<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let known = self.iter().filter(|(_, value)| value.is_some());
        serializer.collect_map(known.map(|(score, value)| (score.name, value)))
    }

    fn update(&mut self, value: impl Fn(&Score) -> Option<Option<f64>>) {
        for (old, score) in self.0.iter_mut().zip(SCORES) {
            *old = value(score).unwrap_or(*old);
        }
    }
}

/// `None` of nothing.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), x| (sum + x, count + 1));
    (count > 0).then(|| sum / count as f64)
}

impl Serialize for Scores {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let written = self.iter().filter(|(score, value)| {
            value.is_some() || !matches!(score.source, Source::TestViews(_))
        });
        serializer.collect_map(written.map(|(score, value)| (score.name, value)))
    }
}

/// Keys that are no scores are skipped, and scores without a key are `None`.
impl<'de> Deserialize<'de> for Scores {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ByName;
        impl<'de> Visitor<'de> for ByName {
            type Value = Scores;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("scores by name")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Scores, A::Error> {
                let mut scores = Scores::default();
                while let Some(name) = map.next_key::<String>()? {
                    match SCORES.iter().position(|score| score.name == name) {
                        Some(place) => scores.0[place] = map.next_value()?,
                        None => {
                            map.next_value::<IgnoredAny>()?;
                        }
                    }
                }
                Ok(scores)
            }
        }
        deserializer.deserialize_map(ByName)
    }
}

#[cfg(test)]
mod tests {
    use fgs_slam::{FrameStatus, KeyframeKind};

    use super::*;

    fn row(psnr_db: Option<f64>, keyframe: Option<KeyframeKind>) -> FrameRow {
        let mut row = FrameRow::new(0, FrameStatus::Tracked);
        row.keyframe = keyframe;
        row.scores = psnr_db.map_or_else(Scores::default, |db| {
            Scores::of_frame(&FrameErrors {
                image: ImageQuality {
                    psnr_valid_depth_db: Some(db),
                    psnr_db: db + 1.0,
                    psnr_paper_db: db + 2.0,
                    psnr_exposure_valid_depth_db: None,
                    psnr_exposure_db: 21.0,
                    ssim: 0.5,
                },
                depth: None,
            })
        });
        row
    }

    #[test]
    fn means_are_over_the_frames_that_have_a_score() {
        let rows = [
            row(Some(20.0), None),
            row(None, None),
            row(Some(30.0), Some(KeyframeKind::Mapping)),
        ];
        let mut scores = Scores::default();
        scores.set_means(&rows, Some(Holdout::every(3).unwrap()));
        assert_eq!(scores.get("test_psnr_db"), Some(31.0));
        assert_eq!(scores.get("psnr_valid_depth_db"), Some(25.0));
        assert_eq!(scores.get("psnr_db"), Some(26.0));
        assert_eq!(scores.get("psnr_heldout_db"), Some(20.0));
        assert_eq!(scores.get("depth_l1_m"), None);
        assert_eq!(scores.get("ate_rmse_m"), None);
        assert_eq!(scores.get("beauty"), None);
    }

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
