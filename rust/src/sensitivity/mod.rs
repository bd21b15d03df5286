//! The drive train and its derivatives by parameters and initial state.
//!
//! The equations of `drive_train/` are written for any number. Run with numbers that carry their derivatives, the steps
//! of the method are themselves differentiated, to rounding. Limits have a derivative on either side: at the limit
//! itself it is the one of the side that is being computed.
//!
//! Where nothing acts but rate limits and a dead time of the set point, two states are enough, and `two_state` is
//! 1.6 times as fast with seven derivatives as the whole drive train, 3.4 times without any (`benches/bench_grey_box.py`).

mod full_train;
mod output;
mod parameters;
mod pass;
mod products;
mod simulate;
mod two_state;

pub use output::{OUTPUTS, Output};
pub use parameters::{MOST, Subject};
pub use products::{Record, Sums};
pub use simulate::simulate;
