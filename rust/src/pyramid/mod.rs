//! The levels of a min/max pyramid: what a long channel looks like at any zoom, without a sample left out.

mod extremes;
mod gaps;

pub use extremes::{Extremes, coarser};
pub use gaps::Gaps;
