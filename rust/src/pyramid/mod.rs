//! Levels of a min/max pyramid, which show a long channel at any zoom without omitting a sample.

mod extremes;
mod gaps;

pub use extremes::{Extremes, coarser};
pub use gaps::Gaps;
