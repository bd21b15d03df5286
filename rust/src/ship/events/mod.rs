//! The path of ships that sample, or limit more than their torque: between events the equations are smooth, and steps end at every event.
//!
//! Elements that act here beside the smooth path's:
//! - a governor that samples at `T_0 + k T_s` and holds: it reads speed and set point, and its order reaches the actuator `T_d` later;
//! - limits of the rack's position and rate and of the torque, `M_max + M_max_slope (N - 1)` and `M_min`;
//! - anti-windup: the sum stands while the governor's command is beyond what the rack or, at the present speed, the torque can
//!   follow, and the error drives it further there. Where the sum would come and go, it slides along that ceiling;
//! - a shaft with a spring and a damper between the engine's inertia `tau_n - tau_prop` and the propeller's.

mod command;
mod flow;
mod happen;
mod held;
mod inputs;
mod locate;
mod march;
mod pace;
mod readings;
mod rise;
mod switches;
mod terms;
mod tight;

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::instruction_set::arch;
use crate::scalar::{Dual, Scalar, Tangent};
use crate::stop::Stop;

use super::march::{Consume, Task};
use super::parameters::at;
use super::run::Run;
use flow::Equations;
use march::March;
use terms::{Elements, Terms};

/// Simulate, and give every block of samples to `consume`.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) where the fastest time constant or the governor's samples ask for too many steps,
/// [`Error::Stopped`](crate::error::Error::Stopped) on request, and what `consume` returns.
pub fn march(task: &Task<'_>, run: &Run<'_>, stop: &Stop, consume: &mut Consume<'_>) -> Result<()> {
    match task.wrt.len() {
        0 => march_of::<0>(task, run, stop, consume),
        1..=8 => march_of::<8>(task, run, stop, consume),
        9..=16 => march_of::<16>(task, run, stop, consume),
        _ => march_of::<MOST>(task, run, stop, consume),
    }
}

/// As many directions as there are parameters.
const MOST: usize = super::parameters::COUNT;

fn march_of<const N: usize>(
    task: &Task<'_>,
    run: &Run<'_>,
    stop: &Stop,
    consume: &mut Consume<'_>,
) -> Result<()> {
    arch().dispatch(Through::<'_, '_, N> { task, run, stop, consume })
}

struct Through<'a, 'c, const N: usize> {
    task: &'a Task<'a>,
    run: &'a Run<'a>,
    stop: &'a Stop,
    consume: &'a mut Consume<'c>,
}

impl<const N: usize> WithSimd for Through<'_, '_, N> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        let Self { task, run, stop, consume } = self;
        let first = run.set.first().copied().unwrap_or(0.0);
        let first_load = run.load.first().copied().unwrap_or(0.0);
        let plain = equations(task, run);
        let number = |place: usize| {
            let along = |direction: usize| task.wrt.get(direction) == Some(&place);
            let slopes = std::array::from_fn(|direction| f64::from(u8::from(along(direction))));
            Dual::<S, N>::new(simd, Tangent { value: task.parameters.of(place), slopes })
        };
        let mut terms = Terms::new(number);
        if !plain.elements.lag {
            // A lag that is off acts like a dead time, to first order.
            terms.t_d = terms.t_d + terms.tau_act;
        }
        if plain.elements.sampled {
            let (t_0, t_s) = (task.parameters.of(at::T_0), task.parameters.of(at::T_S));
            terms.t_0 = (terms.t_0 - terms.t_s * (t_0 / t_s).floor()).function(plain.terms.t_0, 1.0);
        }
        let numbers = Equations::new(terms, plain.elements, first, first_load);
        March::new(task, run, numbers, &plain, stop)?.through(simd, task.wrt.len(), consume)
    }
}

/// Roughly how many steps of the smooth path a simulation is worth.
#[must_use]
pub fn work(task: &Task<'_>, run: &Run<'_>) -> usize {
    /// A step that looks for switches, over one of a series.
    const STEP: f64 = 8.0;
    let longest = pace::longest_step(&equations(task, run), run).unwrap_or(run.dt);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Positive; saturates.
    run.samples().saturating_mul((STEP * (1.0 + run.dt / longest)) as usize)
}

/// The equations without derivatives.
fn equations(task: &Task<'_>, run: &Run<'_>) -> Equations<f64> {
    let first = run.set.first().copied().unwrap_or(0.0);
    let first_load = run.load.first().copied().unwrap_or(0.0);
    let of = |place: usize| task.parameters.of(place);
    let mut terms = Terms::new(of);
    if terms.t_s > 0.0 {
        // The first sample in the record, exactly, however far off that one is.
        terms.t_0 = terms.t_0.rem_euclid(terms.t_s);
    }
    // A gain of zero by which is differentiated acts on the derivatives.
    let derivative = of(at::K_D) != 0.0 || task.wrt.contains(&at::K_D);
    let switches = [of(at::ANTI_WINDUP) > 0.0, of(at::UPDATE) > 0.0, !run.load.is_empty(), derivative];
    let elements = Elements::of(&terms, switches, run.dt, run.sharp);
    let mut plain = Equations::new(terms, elements, first, first_load);
    if !elements.lag {
        plain.terms.t_d += terms.tau_act;
    }
    plain
}
