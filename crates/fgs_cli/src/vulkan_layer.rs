//! Mesa's Vulkan layer that selects a device asks the desktop which one it displays on. Without a
//! desktop it complains on stderr as if something had failed, so it is then disabled.

/// Call it before any thread is started.
pub fn leave_out_without_desktop() {
    if cfg!(target_os = "linux") && std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: nothing else runs yet that could read the environment.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}
