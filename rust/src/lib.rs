//! Kernels of `shipfp_rs`: plant stepping, linear structure and its cost, pulse extraction.

pub mod cost;
pub mod drive_train;
pub mod error;
pub mod filter;
mod finite;
pub mod integrate;
pub mod leftover;
pub mod linear;
pub mod plant;
pub mod pool;
pub mod pulse;
pub mod pyramid;
pub mod repeats;
pub mod scalar;
pub mod sensitivity;
pub mod ship;
pub mod statespace;
pub mod stop;

#[cfg(feature = "python")]
mod python;
