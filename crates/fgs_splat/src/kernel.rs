//! Runs a kernel with the instruction set that this process uses; see [`fgs_geom::Instructions`].
//!
//! Multiply-adds are fused only where the processor can: elsewhere they would be library calls.

pub(crate) use fgs_geom::Kernel;

use crate::Real;

#[cfg(test)]
thread_local! {
    /// Overrides the instruction set for kernels on a test's thread.
    pub(crate) static ONLY: std::cell::Cell<Option<fgs_geom::Instructions>> =
        const { std::cell::Cell::new(None) };
}

/// Runs a kernel.
pub(crate) fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(test)]
    #[allow(clippy::unwrap_used, reason = "a test chooses what there is")]
    if let Some(set) = ONLY.get() {
        return set.run(kernel).unwrap();
    }
    fgs_geom::dispatch(kernel)
}

/// a b + c.
#[inline(always)]
pub(crate) fn mul_add<const FUSED: bool, T: Real>(a: T, b: T, c: T) -> T {
    if FUSED {
        a.fused_mul_add(b, c)
    } else {
        a * b + c
    }
}
