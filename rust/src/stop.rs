//! A flag through which a caller stops a running kernel.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};

/// Kernels look at the flag at least once in this many samples (well under a second of work each).
pub const CHECK_EVERY: usize = 1 << 14;

/// Shared by the caller, who may raise it, and the kernels, who look at it every [`CHECK_EVERY`] samples.
#[derive(Debug, Default)]
pub struct Stop(AtomicBool);

impl Stop {
    /// A flag that is not raised.
    #[must_use]
    pub const fn new() -> Self {
        Self(AtomicBool::new(false))
    }

    /// Ask the kernels to return [`Error::Stopped`] soon.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Return [`Error::Stopped`] once a stop was requested.
    ///
    /// # Errors
    /// [`Error::Stopped`] after [`Stop::request`].
    pub fn check(&self) -> Result<()> {
        if self.0.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
    }
}
