//! The program's own memory.

/// Gives each large array pages of its own, which go back to the system when it grows or goes.
///
/// The map's arrays grow with the map. Left to itself, glibc soon puts arrays of up to 32 MB side by
/// side with everything else, and what an array leaves when it grows is lost between keyframes: in
/// a long run that is half as much again as what is in use.
pub fn keep_large_arrays_apart() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// Larger than an image or what a step needs per pixel, which come and go all the time.
        const LARGE_BYTES: libc::c_int = 8 << 20;
        /// What is kept of freed memory, so that the next step finds it ready: asking the system for
        /// a page costs as much as filling it.
        const KEPT_BYTES: libc::c_int = 64 << 20;
        // SAFETY: it sets numbers in the allocator, under the allocator's lock. That it may refuse
        // does no harm.
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BYTES);
            libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT_BYTES);
            // Each thread's arena would keep as much. Threads allocate too seldom to wait for one.
            libc::mallopt(libc::M_ARENA_MAX, 1);
        }
    }
}

/// The most physical memory this process has used so far, bytes; `None` where the operating
/// system does not say so in `/proc/self/status`.
pub fn peak_rss_bytes() -> Option<u64> {
    parse_peak(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// Finds the line `VmHWM:  123456 kB`.
fn parse_peak(status: &str) -> Option<u64> {
    let value = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = value.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_high_water_mark() {
        let status = "Name:\tfgs\nVmPeak:\t 9000 kB\nVmHWM:\t  1234 kB\nVmRSS:\t 1000 kB\n";
        assert_eq!(parse_peak(status), Some(1234 * 1024));
        assert_eq!(parse_peak("VmHWM:\t many kB\n"), None);
        assert_eq!(parse_peak("VmHWM:\t 99999999999999999999 kB\n"), None);
        assert_eq!(parse_peak(""), None);
    }
}
