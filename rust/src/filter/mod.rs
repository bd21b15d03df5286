//! Filters over long recorded channels: the running median, the decimating low-pass, the all-pole filter backwards.

mod all_pole;
mod decimate;
mod median;

pub use all_pole::all_pole_backwards;
pub use decimate::Decimator;
pub use median::running_median;
