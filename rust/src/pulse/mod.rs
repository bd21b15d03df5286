//! Pulse trains to crossing times, streaming over chunks.

mod crossings;
#[cfg(test)]
mod fuzz;
mod levels;
mod sample;

pub use crossings::PulseCrossings;
pub use levels::pulse_levels;
pub use sample::Sample;
