//! The linear structure: a governed engine and a propeller around an operating point (eq. 3.14-3.54), with dead times.
//!
//! All signals are deviations divided by the operating point. With the set point `r`, `u(t) = r(t - T_set)`:
//!
//! ```text
//! X = K_p (u - n) + K_i E              E' = u - n
//! w(t) = v X(t - T_d)            tau_n n' = -(p - g) n + w
//! ```
//!
//! Outputs: `dn = n`, `dE = E`, `dM_b = g n + w = p n + tau_n n'` (engine), `dM_g = p n + tau_prop n'` (strain gauge between
//! the inertias), `dX = X` (rack position as commanded, before the dead time).

pub(crate) mod basis;
mod discrete;
mod number;
mod parameters;
mod response;
pub(crate) mod segmented_pass;
mod simulate;
mod step_kernel;

pub use parameters::{By, OUTPUTS, Output, PARAMETERS, Parameters};
pub use response::{Response, response};
pub use segmented_pass::Drive;
pub use simulate::simulate;
