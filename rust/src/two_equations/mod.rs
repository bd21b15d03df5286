//! A ship's two equations in measured signals: residuals in closed form at every frequency, and their normal equations.
//!
//! Load: `M = N^p + c_2 (N - 1)^2 + tau_prop dN/dt`. Engine: `M_b = 1 + g (N - 1) + A [K_p e + K_i int e]`, `e = U - N`.
//! Speed, torque and set point are measured, so both equations leave residuals that need no simulation (Zellner and Theil
//! 1962, doi:10.2307/1911287, on simultaneous equations). The inverse of the loop's matrix about N = 1 turns these residuals
//! into those of the measured signals.

// Plain loops over vectors: closures of iterators would be compiled separately, without vector instructions.
#![allow(clippy::needless_range_loop)]

mod clock;
mod complex;
mod dual;
mod equations;
mod plan;
mod products;
mod residual;
mod signals;
mod stability;

pub use equations::{Equations, ORDERS, OUTPUTS, Output, PARAMETERS, SIGNALS, Setup};
pub use plan::{BLOCK, Late, Spectra};
pub use products::{Noise, Products, products};
pub use residual::residuals;
pub use stability::is_stable;
