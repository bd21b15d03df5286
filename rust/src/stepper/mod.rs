//! The ship model with a fixed small step, used by every simulation.
//!
//! Speeds, torques and the set point `u` are relative to the operating point. With `N` the speed, `e` its error, `I` the
//! governor's integral, `X` its command, `A` the rack and `w` the deviation of a measured load:
//!
//! ```text
//! e(t) = s_u u(t - T_set) + u_0 - N    dI/dt = e          X = K_p e + K_i I - K_d dN/dt
//! T_f dF/dt = N - F: with a filter the governor sees F, e = s_u u(t - T_set) + u_0 - F, K_d dF/dt
//! tau_act dA/dt = X(t - T_d) - A, |dA/dt| <= rate          M_b = 1 + B, M_min <= M_b <= M_max or envelope(N)
//! tau_eng dB/dt = g (N - 1) + v A - B: the engine's lag; without it B = g (N - 1) + v A
//! L = N^p + curvature (N - 1)^2 + damping (N - 1) + load_gain w        tau_n dN/dt = M_b - L
//! ```
//!
//! `hold` attributes a share of `T_d` to the hold of a governor that samples every `2 hold T_d`. Only the hold's mean
//! effect is simulated: integral and ripple are those of a continuous governor. With `T_s`, `hold` has no effect.
//!
//! Before the record the set point equals its first sample, the rack `initial_F / v`, the speed `initial_N`; the integral is
//! `initial_E` above the value at which the command equals the rack. Outputs: `dn = N - 1`, `dM_b = s_M M_b - 1`,
//! `dM_g = s_M (L + tau_prop dN/dt) - 1`, `dX = A`, `dE = I`, `dn_prop`; sensors delay speeds by `T_n`, torques by `T_M`.
//!
//! The speed is integrated by a third-order Adams predictor and corrector. Lag and rate of the rack are exact for commands
//! that are linear over a step; dead times are interpolated between steps; other limits are clamps; a flexible shaft is
//! the matrix exponential of its linear equations. As a parameter tends to its value without effect, the outputs tend
//! continuously to those without the element.

#![allow(clippy::float_cmp)] // An element that is off is off exactly.

mod command;
mod constants;
mod detail;
mod detailed;
mod envelope;
mod explicit;
mod firing;
mod inputs;
mod late;
mod law;
pub mod output;
pub mod parameters;
mod propeller;
mod rack;
mod run;
mod shaft;
mod step;
mod torque;

pub(crate) use constants::Lag;
pub use detail::{DETAIL, Detail};
pub use envelope::Envelope;
pub use explicit::{Method, simulate_explicitly};
pub use output::{OUTPUTS, Output};
pub use parameters::{OFF, PARAMETERS, Parameters};
pub(crate) use rack::{Pace, paced};
pub use run::{Run, simulate};
pub(crate) use torque::softly_within;
