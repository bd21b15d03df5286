//! The whole drive train: the plant of eq. 3.1-3.11 with what it leaves out, each element off unless its
//! parameters say so.
//!
//! Set point -> dead time -> governor -> dead time -> rate limit -> lag -> engine -> rate limit -> firing -> gearbox ->
//! shaft -> propeller -> ship. Where all elements are off the equations are the plant's.

mod cosine;
mod delay;
mod engine;
mod event_stepper;
mod firing;
mod gearbox;
mod governor;
mod motion;
mod parameters;
mod propeller;
mod ramp;
mod set_point;
mod shaft;
mod ship;
mod simulate;
mod state;

pub use cosine::cosine;
pub use event_stepper::{March, NAMES, ROWS};
pub use governor::{Governor, Timing};
pub use motion::{DriveTrain, FLOW, flow_at};
pub use parameters::{PARAMETERS, Tables};
pub use propeller::{Propeller, Quadrants};
pub use ramp::Ramp;
pub use shaft::{Answer, Shaft};
pub use simulate::{Run, simulate};
pub use state::{STATES, State};
