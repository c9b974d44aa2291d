//! How much memory the machine has.

use std::sync::LazyLock;

use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Where the system does not say.
const ASSUMED_BYTES: u64 = 4 << 30;

/// Bytes that programs may have in use, of a container if it has a limit. Asked for once.
pub fn machine_memory() -> u64 {
    static BYTES: LazyLock<u64> = LazyLock::new(|| {
        let memory = MemoryRefreshKind::nothing().with_ram();
        let system = System::new_with_specifics(RefreshKind::nothing().with_memory(memory));
        let limits = system.cgroup_limits().map(|limits| limits.total_memory);
        let bytes = limits.unwrap_or(u64::MAX).min(system.total_memory());
        if bytes > 0 { bytes } else { ASSUMED_BYTES }
    });
    *BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_has_megabytes_to_terabytes() {
        assert!((64 << 20..64 << 40).contains(&machine_memory()));
    }
}
