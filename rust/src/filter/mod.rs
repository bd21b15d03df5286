//! Filters of long channels: running median, spikes, decimating low-pass, slopes of a spline.

mod decimate;
mod median;
mod slope;
mod spikes;

pub use decimate::Decimator;
pub use median::running_median;
pub use slope::slope_at_even_times;
pub use spikes::{SpikeRule, find_spikes};
