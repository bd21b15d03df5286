//! One ship at a fixed fine step: the model of every simulation.
//!
//! Speeds, torques and the set point `u` are divided by the operating point's. With `N` the speed, `e` its error, `I` the
//! governor's sum, `X` its command, `A` the rack and `w` the deviation of a measured load:
//!
//! ```text
//! e(t) = s_u u(t - T_set) + u_0 - N    dI/dt = e          X = K_p e + K_i I - K_d dN/dt
//! tau_act dA/dt = X(t - T_d) - A, |dA/dt| <= rate          M_b = 1 + g (N - 1) + v A, M_min <= M_b <= M_max or envelope(N)
//! L = N^p + curvature (N - 1)^2 + damping (N - 1) + load_gain w        tau_n dN/dt = M_b - L
//! ```
//!
//! `hold` makes a share of `T_d` a hold, as of a governor that samples every `2 hold T_d`, to
//! its mean: sum and ripple are those of one that does not sample. Beside `T_s` it does nothing.
//!
//! Before the record the set point stands at its first sample, the rack at `initial_F / v`, the speed at `initial_N`; the sum
//! starts `initial_E` above where the command is the rack. Outputs: `dn = N - 1`, `dM_b = s_M M_b - 1`,
//! `dM_g = s_M (L + tau_prop dN/dt) - 1`, `dX = A`, `dE = I`, `dn_prop`; a channel's delay makes speeds late by `T_n`, torques by
//! `T_M`.
//!
//! The step is an Adams predictor and corrector of third order for the speed; lag and rate of the rack are
//! exact for commands that run straight over a step; dead times read between the steps; other limits are clamps; a twisting
//! shaft is the exponential of its own linear equations. Every element goes to "off" continuously.

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

pub use detail::{DETAIL, Detail};
pub use envelope::Envelope;
pub use explicit::{Method, simulate_explicitly};
pub use output::{OUTPUTS, Output};
pub use parameters::{OFF, PARAMETERS, Parameters};
pub(crate) use rack::{Pace, paced};
pub use run::{Run, simulate};
pub(crate) use torque::softly_within;
