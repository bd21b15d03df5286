//! Kernels of `shipfp_rs`: the ship, linear models, pulse extraction.

pub mod engine_side;
pub mod error;
mod finite;
pub mod hold;
pub mod instruction_set;
mod places;
pub mod power;
pub mod pulse;
pub mod statespace;
pub mod stepper;
pub mod stop;
mod subnormal;
pub mod two_equations;

#[cfg(feature = "python")]
mod python;
