//! `up.txt`: which way is up. It is found once, when a map is done, so that whatever is made of the map later
//! is level alike; maps without the file are looked at anew.

use std::io::Write;
use std::path::Path;

use fgs_export::up_direction;
use fgs_files::{StagedFolder, read_text};
use fgs_geom::Se3;
use fgs_splat::Gaussians;
use nalgebra::Vector3;

use crate::error::RunError;
use crate::run_folder::{UP, write};

/// Three numbers.
const MAX_BYTES: u64 = 1 << 10;

/// The upward direction, of length 1, of a map, in its coordinates: the one that was saved in its folder, or
/// else one by the map and the poses `world_from_camera` of its cameras.
pub fn up_of(folder: Option<&Path>, map: &Gaussians, poses: &[Se3]) -> Vector3<f64> {
    folder.and_then(read).unwrap_or_else(|| find(map, poses))
}

/// The upward direction by a map and the poses of its cameras.
pub(crate) fn find(map: &Gaussians, poses: &[Se3]) -> Vector3<f64> {
    let ups = poses.iter().map(|pose| -(pose.rotation * Vector3::y()));
    up_direction(map, ups.sum())
}

/// Saves it among results.
pub(crate) fn save(up: &Vector3<f64>, results: &StagedFolder<'_>) -> Result<(), RunError> {
    let [x, y, z]: [f64; 3] = (*up).into();
    write(results, UP, |file| writeln!(file, "{x:?} {y:?} {z:?}")).map(drop)
}

/// The saved one, if there is one that makes sense.
fn read(folder: &Path) -> Option<Vector3<f64>> {
    let text = read_text(&folder.join(UP), MAX_BYTES).ok()?;
    let numbers = text.split_whitespace().map(|word| word.parse().ok());
    let numbers: [f64; 3] = numbers.collect::<Option<Vec<_>>>()?.try_into().ok()?;
    let up = Vector3::from(numbers);
    // What it was saved with.
    ((up.norm() - 1.0).abs() < 1e-6).then_some(up)
}

#[cfg(test)]
mod tests {
    use fgs_files::OutputFolder;

    use super::*;

    #[test]
    fn what_was_saved_is_believed_and_nonsense_is_not() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("run");
        let up = Vector3::new(0.1, -0.9, 0.3).normalize();
        let claimed = OutputFolder::claim(&folder).unwrap();
        let results = claimed.begin().unwrap();
        save(&up, &results).unwrap();
        results.finish().unwrap();
        let map = Gaussians::default();
        let found = || up_of(Some(&folder), &map, &[Se3::identity()]);
        assert!((found() - up).norm() < 1e-15);
        for nonsense in ["", "0 0 0", "0 -1", "0 -1 0 0", "nan 1 0", "0 -2 0", "up"] {
            std::fs::write(folder.join(UP), nonsense).unwrap();
            assert_eq!(found(), -Vector3::y(), "{nonsense}");
        }
    }
}
