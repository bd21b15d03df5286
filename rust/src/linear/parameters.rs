//! Parameters and outputs of the linear structure, by name and by index, and the checks on them.

use crate::error::{Error, Result, require};

/// Names of the parameters, in the order of every parameter vector.
pub const PARAMETERS: [&str; 9] = ["tau_n", "g", "v", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set"];
/// Names of the outputs, in the order of their indices.
pub const OUTPUTS: [&str; 5] = ["dn", "dE", "dM_b", "dM_g", "dX"];

/// Entries of a list of indices: what is asked for more than once costs memory each time.
const MOST: usize = 64;

fn require_short(name: &str, indices: &[usize]) -> Result<()> {
    require(indices.len() <= MOST, || {
        format!("{name}: found {} indices, expected up to {MOST}", indices.len())
    })
}

/// What a simulation or a frequency response can give.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Speed.
    Speed,
    /// Integrated speed error.
    IntegratedError,
    /// Engine torque.
    EngineTorque,
    /// Torque of a strain gauge between the engine's and the propeller's inertia.
    GaugeTorque,
    /// Rack position that the governor commands, before the dead time.
    Rack,
}

impl Output {
    const ALL: [Self; 5] =
        [Self::Speed, Self::IntegratedError, Self::EngineTorque, Self::GaugeTorque, Self::Rack];

    /// Look up a list of outputs by index into [`OUTPUTS`].
    ///
    /// # Errors
    /// [`Error::Invalid`] for an empty list or an index out of range.
    pub fn from_indices(indices: &[usize]) -> Result<Vec<Self>> {
        require(!indices.is_empty(), || {
            format!("outputs is empty; name at least one of {OUTPUTS:?} by index")
        })?;
        require_short("outputs", indices)?;
        indices
            .iter()
            .map(|&index| {
                Self::ALL.get(index).copied().ok_or_else(|| {
                    Error::Invalid(format!(
                        "outputs: found index {index}, expected 0 to 4, one of {OUTPUTS:?}"
                    ))
                })
            })
            .collect()
    }
}

/// What a simulation can be differentiated by: a parameter or an initial value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the parameters' own names, see `Parameters`
pub enum By {
    TauN,
    G,
    V,
    KP,
    KI,
    P,
    TauProp,
    TD,
    TSet,
    InitialN,
    InitialE,
}

impl By {
    const ALL: [Self; 11] = [
        Self::TauN,
        Self::G,
        Self::V,
        Self::KP,
        Self::KI,
        Self::P,
        Self::TauProp,
        Self::TD,
        Self::TSet,
        Self::InitialN,
        Self::InitialE,
    ];

    /// Look up a list by index: into [`PARAMETERS`], then 9 and 10 for the initial dn and dE.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an index out of range.
    pub fn from_indices(indices: &[usize]) -> Result<Vec<Self>> {
        Self::look_up(indices, &Self::ALL, ", or 9 and 10 for the initial dn and dE")
    }

    /// The same without the initial values, which a frequency response doesn't have.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an index out of range.
    pub fn parameters_from_indices(indices: &[usize]) -> Result<Vec<Self>> {
        Self::look_up(indices, &Self::ALL[..PARAMETERS.len()], "")
    }

    fn look_up(indices: &[usize], all: &[Self], also: &str) -> Result<Vec<Self>> {
        require_short("wrt", indices)?;
        let known = |&index: &usize| {
            all.get(index).copied().ok_or_else(|| {
                Error::Invalid(format!(
                    "wrt: found index {index}, expected 0 to 8, one of {PARAMETERS:?}{also}"
                ))
            })
        };
        indices.iter().map(known).collect()
    }
}

/// A checked parameter vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Time constant of the shaft, 2 pi `I_p` `n_s0` / `M_s0`, s.
    pub tau_n: f64,
    /// Slope of the engine torque with speed.
    pub g: f64,
    /// Slope of the engine torque with rack position.
    pub v: f64,
    /// Proportional gain.
    pub k_p: f64,
    /// Integral gain, 1/s.
    pub k_i: f64,
    /// Exponent of the propeller torque.
    pub p: f64,
    /// The part of `tau_n` on the propeller's side of the strain gauge, s.
    pub tau_prop: f64,
    /// Dead time between governor and torque, inside the loop, s.
    pub t_d: f64,
    /// Dead time of the set point, before the governor, s.
    pub t_set: f64,
}

impl Parameters {
    /// Check a vector in the order of [`PARAMETERS`]; `what` is its name in a message.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a wrong length, a value that is not finite, `tau_n` not above 0 or a negative dead time.
    pub fn new(vector: &[f64], what: &str) -> Result<Self> {
        let &[tau_n, g, v, k_p, k_i, p, tau_prop, t_d, t_set] = vector else {
            return Err(Error::Invalid(format!(
                "{what}: found {} values, expected {} in the order {PARAMETERS:?}",
                vector.len(),
                PARAMETERS.len()
            )));
        };
        for (name, value) in PARAMETERS.iter().zip(vector) {
            require(value.is_finite(), || {
                format!("{what}: found {name} = {value}, expected a finite number")
            })?;
        }
        require(tau_n > 0.0, || {
            format!("{what}: found tau_n = {tau_n} s, expected a time constant above 0")
        })?;
        for (name, value) in [("T_d", t_d), ("T_set", t_set)] {
            require(value >= 0.0, || {
                format!("{what}: found {name} = {value} s, expected a dead time of 0 or more")
            })?;
        }
        Ok(Self { tau_n, g, v, k_p, k_i, p, tau_prop, t_d, t_set })
    }
}
