//! Runs a kernel with the widest instructions that the machine has, chosen when the program runs.
//!
//! A kernel is plain code over arrays of lanes, compiled once for each instruction set. Its
//! multiply-adds are fused where the machine fuses them: elsewhere they would be library calls. So
//! bits may differ from one kind of machine to another, but not on one machine.

use pulp::{Arch, NullaryFnOnce};

use crate::Real;

/// Work that is compiled for each instruction set.
pub(crate) trait Kernel {
    type Output;

    /// Does the work. Everything it calls must be `#[inline(always)]`.
    fn run<const FUSED: bool>(self) -> Self::Output;
}

#[cfg(test)]
thread_local! {
    /// Lets a test's thread compute as a machine without wide registers does.
    pub(crate) static PLAIN: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Runs a kernel.
pub(crate) fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(test)]
    if PLAIN.get() {
        return kernel.run::<false>();
    }
    match Arch::new() {
        Arch::Scalar => kernel.run::<false>(),
        arch => arch.dispatch(Fused(kernel)),
    }
}

struct Fused<K>(K);

impl<K: Kernel> NullaryFnOnce for Fused<K> {
    type Output = K::Output;

    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.run::<true>()
    }
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
