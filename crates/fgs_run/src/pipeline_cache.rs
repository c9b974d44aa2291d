//! Where compiled shaders are kept from one run to the next.

use std::path::PathBuf;

use etcetera::BaseStrategy;

/// A folder of ours in the user's cache folder; `None` where the user has none.
pub fn pipeline_cache_folder() -> Option<PathBuf> {
    let base = etcetera::choose_base_strategy().ok()?;
    Some(base.cache_dir().join("fgs-slam"))
}
