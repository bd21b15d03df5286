//! The whole drive train: the plant of `plant/` with what it leaves out, each element off unless its parameters say so.
//!
//! Set point -> dead time -> governor -> dead time -> rate limit -> lag -> engine -> rate limit -> firing -> gearbox ->
//! shaft -> propeller -> ship. Where all elements are off the equations are those of `plant/`.

mod cosine;
mod delay;
mod event_stepper;
mod firing;
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
