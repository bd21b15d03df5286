//! Crossing times of pulse trains, streamed in chunks.

mod crossings;
#[cfg(test)]
mod fuzz;
mod gaps;
mod heights;
mod intervals;
mod levels;
mod noise;
mod record;
mod sample;
mod scan;
mod steady;
mod swings;
mod thresholds;
mod timing;
mod tracker;

pub use crossings::PulseCrossings;
pub use intervals::{COLUMNS, Counted, interval_speeds, is_even};
pub use levels::pulse_levels;
pub use record::Record;
pub use sample::Sample;
pub use thresholds::{Edge, Levels};
pub use timing::Timing;
pub use tracker::{PulseTracker, Pulses};
