//! One ship: the model that every fit uses, with its derivatives.
//!
//! Speeds, torques and the set point `u` are divided by the operating point's. With `N` the speed, `e` its error, `I` the
//! governor's sum, `X` its command, `A` the rack and `w` the deviation of a measured load:
//!
//! ```text
//! e(t) = s_u u(t - T_set) - N          dI/dt = e          X = K_p e + K_i I - K_d dN/dt
//! tau_act dA/dt = X(t - T_d) - A                           M_b = 1 + g (N - 1) + v A
//! L = N^p + damping (N - 1) + load_gain w                  tau_n dN/dt = M_b - L
//! ```
//!
//! Before the record the set point stands at its first sample, the rack at `initial_F / v`, the speed at `initial_N`; the sum
//! starts where the command is the rack (at 0 where `K_i` is 0, and the command is then raised by a constant).
//! Outputs: `dn = N - 1`, `dM_b = s_M M_b - 1`, `dM_g = s_M (L + tau_prop dN/dt) - 1`, `dX = A`, `dE = I`, `dn_prop`; a
//! channel's delay makes speeds late by `T_n`, torques by `T_M`. In the smooth path a dead time in the loop or a lag below 1/256 of
//! a sample interval is taken to first order: signals are then off by half the square of its part of the loop's time constant,
//! derivatives by that part.

#![allow(clippy::needless_range_loop)] // One index runs along several series at once.
#![allow(clippy::float_cmp)] // Places on a grid repeat to the last bit.
#![allow(clippy::large_types_passed_by_value)] // Equations are built where they are used.
#![allow(clippy::match_same_arms)] // Each parameter keeps its own line.
#![allow(clippy::out_of_bounds_indexing)] // The index is a constant below the branch's own limit.

mod events;
mod march;
mod output;
pub mod parameters;
mod products;
mod run;
mod simulate;
mod smooth;

pub use march::{BLOCK, Block, Consume, Task, march};
pub use output::{OUTPUTS, Output};
pub use parameters::{OFF, PARAMETERS, Parameters};
pub use products::{Record, Sums};
pub use run::Run;
pub use simulate::simulate;
