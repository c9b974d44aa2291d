//! How much memory the process has needed.

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
