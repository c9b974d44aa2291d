//! The values of the scores that [`SCORES`] declares, of a run or of a frame: how they are averaged, and
//! how they stand in `metrics.json` and its table.

use std::fmt;

use fgs_slam::Holdout;
use serde::de::{IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::frame_log::FrameRow;
use crate::scores::{FrameErrors, SCORES, Score, Source, TrajectoryErrors};

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
    /// first; `holdout` says which of them are test views.
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
    use fgs_eval::ImageQuality;
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
}
