//! Outputs of a simulation.

use crate::error::{Error, Result, require};

/// Names of the outputs, in the order of their indices.
pub const OUTPUTS: [&str; 6] = ["dn", "dM_b", "dM_g", "dX", "dE", "dn_prop"];

/// One of [`OUTPUTS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Speed of the engine.
    Speed,
    /// Torque of the engine.
    EngineTorque,
    /// Torque of a strain gauge between the engine's and the propeller's inertia.
    GaugeTorque,
    /// Rack position behind dead time, lag and limits.
    Rack,
    /// The governor's integral of the speed error.
    Sum,
    /// Speed of the propeller.
    PropellerSpeed,
}

impl Output {
    const ALL: [Self; OUTPUTS.len()] =
        [Self::Speed, Self::EngineTorque, Self::GaugeTorque, Self::Rack, Self::Sum, Self::PropellerSpeed];

    /// Outputs by indices of [`OUTPUTS`].
    ///
    /// # Errors
    /// [`Error::Invalid`] for an empty list or an index out of range.
    pub fn from_indices(indices: &[usize]) -> Result<Vec<Self>> {
        require(!indices.is_empty(), || {
            format!("outputs is empty, expected at least one of {OUTPUTS:?} by index")
        })?;
        let find = |&index: &usize| {
            Self::ALL.get(index).copied().ok_or_else(|| {
                Error::Invalid(format!("outputs: found {index}, expected 0 to 5, one of {OUTPUTS:?}"))
            })
        };
        indices.iter().map(find).collect()
    }
}
