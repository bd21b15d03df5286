//! Choice of the instruction set: the widest one of the machine, unless another is requested.
//!
//! Tests request each in turn. Kernels round identically with all sets that fuse multiply-adds (AVX2, AVX-512, NEON).
//! With all other sets they round as on a machine without vectors.

use std::sync::atomic::{AtomicUsize, Ordering};

use pulp::Arch;

use crate::error::{Error, Result};

/// Names of the instruction sets of this processor family, narrowest first.
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
pub const NAMES: [&str; 3] = ["scalar", "avx2", "avx512"];
/// Names of the instruction sets of this processor family, narrowest first.
#[cfg(target_arch = "aarch64")]
pub const NAMES: [&str; 2] = ["scalar", "neon"];
/// Names of the instruction sets of this processor family, narrowest first.
#[cfg(not(any(target_arch = "x86", target_arch = "x86_64", target_arch = "aarch64")))]
pub const NAMES: [&str; 1] = ["scalar"];

/// Index of the requested set in [`NAMES`]; an index past the last if no set is requested.
static ASKED_FOR: AtomicUsize = AtomicUsize::new(usize::MAX);

/// Instruction set to which kernels are dispatched.
#[inline]
#[must_use]
pub fn arch() -> Arch {
    at(ASKED_FOR.load(Ordering::Relaxed)).unwrap_or_default()
}

/// Names of the sets that this machine supports.
#[must_use]
pub fn available() -> Vec<&'static str> {
    NAMES.iter().enumerate().filter(|(place, _)| at(*place).is_some()).map(|(_, name)| *name).collect()
}

/// Dispatch to this set in all threads from now on; None: the widest again.
///
/// # Errors
/// [`Error::Invalid`] for a set that this machine does not support.
pub fn choose(name: Option<&str>) -> Result<()> {
    let place = match name {
        None => usize::MAX,
        Some(name) => {
            NAMES.iter().position(|known| *known == name).filter(|place| at(*place).is_some()).ok_or_else(
                || Error::Invalid(format!("instruction set is '{name}', expected one of {:?}", available())),
            )?
        }
    };
    ASKED_FOR.store(place, Ordering::Relaxed);
    Ok(())
}

/// The set at an index of [`NAMES`], if the machine supports it.
#[inline]
fn at(place: usize) -> Option<Arch> {
    match place {
        0 => Some(Arch::Scalar),
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        1 => pulp::x86::V3::try_new().map(Arch::V3),
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        2 => pulp::x86::V4::try_new().map(Arch::V4),
        #[cfg(target_arch = "aarch64")]
        1 => pulp::aarch64::Neon::try_new().map(Arch::Neon),
        _ => None,
    }
}
