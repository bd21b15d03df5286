//! Kernels of `shipfp_rs`: the ship, linear models, pulse extraction.

pub mod duplicate_rows;
pub mod engine_side;
pub mod error;
pub mod filter;
mod finite;
pub mod hold;
pub mod instruction_set;
pub mod memory;
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
