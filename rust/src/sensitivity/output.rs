//! What can be asked of a run with derivatives, and what takes it block by block.

use crate::error::{Error, Result, require};
use crate::scalar::Tangent;

/// Names of what can be asked for: `n_e`, `n_s` [rev/s], `M_b`, `M_g` [Nm], `X_f` [mm], `E_n` [rev].
pub const OUTPUTS: [&str; 6] = ["n_e", "n_s", "M_b", "M_g", "X_f", "E_n"];

/// Entries of a list of outputs.
const MOST: usize = 64;

/// One of [`OUTPUTS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Output {
    EngineSpeed,
    ShaftSpeed,
    BrakeTorque,
    GaugeTorque,
    Rack,
    Error,
}

impl Output {
    const ALL: [Self; OUTPUTS.len()] =
        [Self::EngineSpeed, Self::ShaftSpeed, Self::BrakeTorque, Self::GaugeTorque, Self::Rack, Self::Error];

    /// Its place among the rows of the whole drive train.
    #[must_use]
    pub fn row(self) -> usize {
        match self {
            Self::EngineSpeed => 0,
            Self::ShaftSpeed => 1,
            Self::BrakeTorque => 2,
            Self::GaugeTorque => 3,
            Self::Rack => 5,
            Self::Error => 6,
        }
    }

    /// By their places in [`OUTPUTS`].
    ///
    /// # Errors
    /// Where there are none, or one is out of range.
    pub fn from_indices(indices: &[usize]) -> Result<Vec<Self>> {
        if let Some(bad) = indices.iter().find(|&&index| index >= OUTPUTS.len()) {
            return Err(Error::Invalid(format!(
                "outputs holds {bad}, expected 0 to {}: {}",
                OUTPUTS.len() - 1,
                OUTPUTS.join(", ")
            )));
        }
        require(indices.len() <= MOST, || {
            format!("outputs: found {} indices, expected up to {MOST}", indices.len())
        })?;
        if indices.is_empty() {
            return Err(Error::Invalid("outputs is empty, expected at least one".to_owned()));
        }
        Ok(indices.iter().map(|&index| Self::ALL[index]).collect())
    }
}

/// A function that takes a block of outputs: the index of its first sample, then for each sample one number per output.
pub type Consume<'a, const N: usize> = dyn FnMut(usize, &[Tangent<N>]) -> Result<()> + 'a;

/// Refuse a block from a sample on that holds what is not finite.
pub fn require_finite<const N: usize>(
    from: usize,
    rows: &[Tangent<N>],
    outputs: &[Output],
    dt: f64,
) -> Result<()> {
    let Some(bad) = rows.iter().position(|number| !is_finite(number)) else { return Ok(()) };
    let (sample, output) = (from + bad / outputs.len(), outputs[bad % outputs.len()]);
    let what = if rows[bad].value.is_finite() { "a sensitivity" } else { OUTPUTS[output as usize] };
    Err(Error::Diverged { sample, time: sample as f64 * dt, what })
}

fn is_finite<const N: usize>(number: &Tangent<N>) -> bool {
    number.slopes.iter().fold(number.value, |sum, slope| sum + 0.0 * slope).is_finite()
}
