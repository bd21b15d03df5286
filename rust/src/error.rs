//! Error type of all kernels; only `python/errors.rs` maps it to exceptions.

/// Errors of a kernel.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// An argument has the wrong shape, length or value; the message gives its name, the value found and the value
    /// expected.
    #[error("{0}")]
    Invalid(String),
    /// A simulation left the range of finite numbers.
    #[error(
        "simulation diverged at sample {sample} (t = {time:.6} s): {what} is not finite; use a smaller step or check the parameters"
    )]
    Diverged {
        /// First sample that is not finite.
        sample: usize,
        /// Its time in seconds.
        time: f64,
        /// The signal that left the range.
        what: &'static str,
    },
    /// The loop about the operating point is unstable.
    #[error("the loop is unstable at these parameters")]
    Unstable,
    /// The system has not enough memory.
    #[error("no memory for {bytes} bytes; use fewer samples, outputs or directions")]
    Memory {
        /// Requested size.
        bytes: usize,
    },
    /// The caller asked to stop.
    #[error("stopped on request")]
    Stopped,
    /// A defect of this library, caught before it ends the process.
    #[error("internal error: {0}; please report it")]
    Internal(String),
}

/// Result of a kernel.
pub type Result<T> = std::result::Result<T, Error>;

/// Refuse an argument with a message that is only built when needed.
pub(crate) fn require(ok: bool, message: impl FnOnce() -> String) -> Result<()> {
    if ok { Ok(()) } else { Err(Error::Invalid(message())) }
}
