//! Settings of loop closure.

use serde::{Deserialize, Serialize};

/// What happens when the camera comes back to a place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LoopConfig {
    /// Whether drift is taken out when a place is seen again. Needs `tracking.color`.
    pub enabled: bool,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self { enabled: true }
    }
}
