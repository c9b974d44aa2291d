//! How the program's memory is allocated.

/// Gives each large array pages of its own, which are returned to the system when it grows or is
/// dropped.
///
/// The map's arrays grow with the map. By default glibc soon places arrays of up to 32 MB among
/// everything else, and the hole that an array leaves when it grows is fragmented between keyframes:
/// in a long run that wastes half as much again as is in use.
pub fn keep_large_arrays_apart() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// Larger than an image or a step's buffers per pixel, which come and go all the time.
        const LARGE_BYTES: libc::c_int = 8 << 20;
        /// How much freed memory is kept for the next step: getting a page from the system costs as
        /// much as filling it.
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
