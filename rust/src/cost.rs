//! What a search needs of a record: sums of products of residuals and sensitivities, from which cost, gradient and
//! Gauss-Newton matrix follow for any weights.
//!
//! The pass does not form the sensitivities of the outputs. It sums the products of all pairs of rows: the residuals, and the
//! signals that outputs are made of and their derivatives in the few directions the loop depends on. All else are small
//! combinations of these sums, so many parameters cost no more than few.

pub(crate) mod columns;
mod products;
pub(crate) mod sums;

pub use products::{Products, Record};
