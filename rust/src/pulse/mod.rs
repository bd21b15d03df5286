//! Pulse trains to crossing times, streaming over chunks.

mod crossings;
#[cfg(test)]
mod fuzz;
mod gaps;
mod levels;
mod noise;
mod sample;
mod swings;
mod thresholds;
mod timing;
mod tracker;

pub use crossings::PulseCrossings;
pub use levels::pulse_levels;
pub use sample::Sample;
pub use thresholds::{Edge, Levels};
pub use timing::Timing;
pub use tracker::{PulseTracker, Pulses};
