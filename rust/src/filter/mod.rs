//! Filters over long recorded channels: the running median and the decimating low-pass.

mod decimate;
mod median;

pub use decimate::Decimator;
pub use median::running_median;
