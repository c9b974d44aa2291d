//! Which vector instructions the kernels of every crate use.
//!
//! A kernel is plain code over arrays of lanes, compiled once for each instruction set: the widest
//! set that the processor has runs, unless a narrower one was chosen for the whole process, to
//! measure or to test it. It lives here because rasteriser, registration and segmentation must
//! choose alike, and this crate is all that they share.
//!
//! Results are bit-identical from run to run and for any number of threads on one instruction set.
//! Between sets they may differ by rounding: multiply-adds are fused only where the processor fuses
//! them, and sums over lanes follow the number of lanes.

use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

use pulp::{Arch, NullaryFnOnce};

/// An instruction set that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instructions {
    /// x86-64 with AVX-512 (level v4): 32 registers of 16 `f32`.
    Avx512,
    /// x86-64 with AVX2 and FMA (level v3): 16 registers of 8 `f32`.
    Avx2,
    /// 64-bit ARM: 32 registers of 4 `f32`.
    Neon,
    /// What every processor of the target has; multiply-adds are not fused.
    Plain,
}

/// Why an instruction set cannot be chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InstructionsError {
    /// The processor lacks it.
    #[error("this processor does not have {0}")]
    Unavailable(Instructions),
    /// Kernels have run, or another set was chosen before.
    #[error("cannot choose {wanted}: kernels already use {used}")]
    InUse {
        /// What was to be chosen.
        wanted: Instructions,
        /// What is in use.
        used: Instructions,
    },
}

/// A kernel: work that is compiled for each instruction set.
pub trait Kernel {
    /// What the work returns.
    type Output;

    /// Does the work. Everything it calls must be `#[inline(always)]`.
    ///
    /// `FUSED` tells whether the processor has fused multiply-adds, `WIDTH` how many `f32` are
    /// best worked on together: 16 or 8.
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> Self::Output;
}

static CHOSEN: OnceLock<Arch> = OnceLock::new();

impl Instructions {
    /// All of them, widest first.
    pub const ALL: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Neon, Self::Plain];

    /// What kernels use in this process.
    pub fn in_use() -> Self {
        Self::of(*CHOSEN.get_or_init(Arch::new))
    }

    /// Whether the processor has it.
    pub fn is_available(self) -> bool {
        self.arch().is_some()
    }

    /// Makes all kernels of this process use this set. Call it before the first kernel runs.
    ///
    /// # Errors
    /// If the processor lacks the set, or kernels already use another one.
    pub fn choose(self) -> Result<(), InstructionsError> {
        let arch = self.arch().ok_or(InstructionsError::Unavailable(self))?;
        let used = Self::of(*CHOSEN.get_or_init(|| arch));
        if used == self {
            Ok(())
        } else {
            Err(InstructionsError::InUse { wanted: self, used })
        }
    }

    /// Runs one kernel on this set, whatever the process uses; `None` if the processor lacks it.
    pub fn run<K: Kernel>(self, kernel: K) -> Option<K::Output> {
        self.arch().map(|arch| dispatch_on(arch, kernel))
    }

    #[cfg(target_arch = "x86_64")]
    fn of(arch: Arch) -> Self {
        match arch {
            Arch::V4(_) => Self::Avx512,
            Arch::V3(_) => Self::Avx2,
            _ => Self::Plain,
        }
    }

    #[cfg(target_arch = "aarch64")]
    fn of(arch: Arch) -> Self {
        match arch {
            Arch::Neon(_) => Self::Neon,
            _ => Self::Plain,
        }
    }

    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    fn of(_: Arch) -> Self {
        Self::Plain
    }

    fn arch(self) -> Option<Arch> {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().map(Arch::V4),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().map(Arch::V3),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => pulp::aarch64::Neon::try_new().map(Arch::Neon),
            Self::Plain => Some(Arch::Scalar),
            #[allow(unreachable_patterns, reason = "which are left depends on the target")]
            _ => None,
        }
    }
}

/// Runs a kernel with the instructions [in use](Instructions::in_use).
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    dispatch_on(*CHOSEN.get_or_init(Arch::new), kernel)
}

#[inline(always)]
fn dispatch_on<K: Kernel>(arch: Arch, kernel: K) -> K::Output {
    match arch {
        Arch::Scalar => kernel.run::<false, 8>(),
        #[cfg(target_arch = "x86_64")]
        Arch::V4(_) => arch.dispatch(Fused::<K, 16>(kernel)),
        _ => arch.dispatch(Fused::<K, 8>(kernel)),
    }
}

struct Fused<K, const WIDTH: usize>(K);

impl<K: Kernel, const WIDTH: usize> NullaryFnOnce for Fused<K, WIDTH> {
    type Output = K::Output;

    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.run::<true, WIDTH>()
    }
}

impl Instructions {
    /// As written in arguments and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Neon => "neon",
            Self::Plain => "plain",
        }
    }
}

impl fmt::Display for Instructions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Instructions {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|set| set.name() == text);
        found.ok_or_else(|| "expected avx512, avx2, neon or plain".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Shape;

    impl Kernel for Shape {
        type Output = (bool, usize);

        #[inline(always)]
        fn run<const FUSED: bool, const WIDTH: usize>(self) -> (bool, usize) {
            (FUSED, WIDTH)
        }
    }

    #[test]
    fn each_set_has_its_shape() {
        assert_eq!(Instructions::Plain.run(Shape), Some((false, 8)));
        for (set, shape) in [
            (Instructions::Avx512, (true, 16)),
            (Instructions::Avx2, (true, 8)),
            (Instructions::Neon, (true, 8)),
        ] {
            assert!(set.run(Shape).is_none_or(|found| found == shape));
        }
        assert_eq!(Instructions::in_use().run(Shape), Some(dispatch(Shape)));
    }

    #[test]
    fn names_are_read_back() {
        for set in Instructions::ALL {
            assert_eq!(set.name().parse(), Ok(set));
        }
        assert!("avx".parse::<Instructions>().is_err());
    }

    /// The only test of this process that may choose: it chooses what is in use anyway.
    #[test]
    fn what_is_in_use_cannot_be_changed() {
        let used = Instructions::in_use();
        assert_eq!(used.choose(), Ok(()));
        let others = Instructions::ALL.into_iter().filter(|set| *set != used);
        for wanted in others {
            let expected = match wanted.run(Shape) {
                Some(_) => InstructionsError::InUse { wanted, used },
                None => InstructionsError::Unavailable(wanted),
            };
            assert_eq!(wanted.choose(), Err(expected));
        }
    }
}
