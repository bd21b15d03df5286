//! A flag by which a caller stops a running kernel.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};

/// Most samples between two checks of the flag (well under a second of work).
pub const CHECK_EVERY: usize = 1 << 14;

/// Flag shared by the caller, who may raise it, and the kernels, which check it every [`CHECK_EVERY`] samples.
#[derive(Debug, Default)]
pub struct Stop(AtomicBool);

impl Stop {
    /// A flag that is not raised.
    #[must_use]
    pub const fn new() -> Self {
        Self(AtomicBool::new(false))
    }

    /// Request that the kernels return [`Error::Stopped`] soon.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Return [`Error::Stopped`] after a request.
    ///
    /// # Errors
    /// [`Error::Stopped`] after [`Stop::request`].
    pub fn check(&self) -> Result<()> {
        if self.0.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
    }
}
