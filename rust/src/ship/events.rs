//! The path of ships that sample, limit or twist.

use crate::error::{Error, Result};
use crate::stop::Stop;

use super::march::{Consume, Task};
use super::run::Run;

/// Simulate, and give every block of samples to `consume`.
///
/// # Errors
/// [`Error::Invalid`]: not yet.
pub fn march(_task: &Task<'_>, _run: &Run<'_>, _stop: &Stop, _consume: &mut Consume<'_>) -> Result<()> {
    Err(Error::Invalid(
        "parameters ask for sampling, limits or a flexible shaft, which are not there yet".to_owned(),
    ))
}
