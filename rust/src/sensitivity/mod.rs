//! The plant with the elements that a trial at full scale shows, and its derivatives by parameters and initial state.
//!
//! Set point -> dead time -> governor -> rate limit -> engine -> rate limit -> gearbox -> gauge -> propeller, of the
//! components of `plant/` and `drive_train/`, whose equations are written for any number. Run with numbers that carry
//! their derivatives, the steps of the method are themselves differentiated, to rounding. Limits have a derivative on
//! either side: at the limit itself it is the one of the side that is being computed.

mod march;
mod parameters;
mod products;
mod simulate;

pub use march::{OUTPUTS, Output};
pub use parameters::{MOST, PARAMETERS, Subject};
pub use products::{Record, Sums};
pub use simulate::simulate;
