//! The path of ships without sampling or limits: pieces of time between breaks, and series on them.
//!
//! Inputs are straight or constant between samples; a break of the set point arrives at the shaft after both dead times, and
//! again, weaker by an order, after every further one in the loop. A piece ends wherever one of the first few arrives, so on a
//! piece every signal is smooth, and a few terms of its Taylor series, which the equations give one after the other, are the
//! solution to far below a millionth. The same series, differentiated by the parameters, carries the sensitivities. Where a
//! break's time itself moves with a parameter, a derivative jumps there by what the signal's rate jumps.

mod cruise;
mod emit;
mod feed;
mod flexible;
mod grid;
mod history;
mod limited;
mod model;
mod outside;
mod power;
mod reading;
mod slopes;
mod sources;
mod steps;

use pulp::{Simd, WithSimd};

use crate::error::{Error, Result, require_slow};
use crate::instruction_set::arch;
use crate::integrate::Hold;
use crate::stop::Stop;

use super::march::{Consume, Task};
use super::parameters::at;
use super::run::Run;

use cruise::{Aboard, Cruise};
use emit::Emit;
use grid::Grid;
use history::History;
use model::{FLEXIBLE_TERMS, Jets, Model, TERMS, is_flexible, total};
use outside::Outside;
use reading::OfTorque;
use slopes::{Derivatives, On};
use sources::Sources;
use steps::Steps;

pub use limited::{is_limited, march as march_limited};

/// Dead times through which a break is followed, where it is a kink of the set point. A jump is followed through one more, and
/// where the governor's derivative term hands breaks on as strong as they come, through more of them.
const LEVELS: usize = 3;
/// Length of a piece over the shortest time constant.
const FINE: f64 = 0.18;
/// The same where a millionth of a step does not count.
const ROUGH: f64 = 0.5;
/// Both of a flexible shaft, whose series have more terms, and which swings on for long.
const FINE_FLEXIBLE: f64 = 0.35;
const ROUGH_FLEXIBLE: f64 = 0.9;
/// Most pieces a sample interval.
const MOST: f64 = 4096.0;
/// The same where a millionth of a step does not count: such a ship is no minimum of a search, and would hold it up.
const ROUGH_MOST: f64 = 40.0;
/// Lags and dead times below this part of a sample interval are taken to first order: pieces as short would cost too much.
const QUICK: f64 = 1.0 / 256.0;
/// The same where a millionth of a step does not count.
const ROUGH_QUICK: f64 = 0.125;

/// Lags and dead times below this [s] are taken to first order.
fn quick(run: &Run<'_>) -> f64 {
    run.dt * if run.sharp { QUICK } else { ROUGH_QUICK }
}

/// Simulate, and give every block of samples to `consume`.
///
/// # Errors
/// [`Error::Stopped`] on request, and what `consume` returns.
pub fn march(task: &Task<'_>, run: &Run<'_>, stop: &Stop, consume: &mut Consume<'_>) -> Result<()> {
    match (task.wrt.contains(&at::P), task.parameters.is_off(at::TAU_TWIST)) {
        (true, true) => arch().dispatch(Pass::<true, TERMS> { task, run, stop, consume }),
        (false, true) => arch().dispatch(Pass::<false, TERMS> { task, run, stop, consume }),
        (true, false) => arch().dispatch(Pass::<true, FLEXIBLE_TERMS> { task, run, stop, consume }),
        (false, false) => arch().dispatch(Pass::<false, FLEXIBLE_TERMS> { task, run, stop, consume }),
    }
}

/// `T`: terms of the rates.
struct Pass<'a, 'c, const EXPONENT: bool, const T: usize> {
    task: &'a Task<'a>,
    run: &'a Run<'a>,
    stop: &'a Stop,
    consume: &'a mut Consume<'c>,
}

/// The longest piece [sample intervals].
fn longest(model: &Model, run: &Run<'_>) -> Result<f64> {
    let flexible = model.tau_twist > 0.0;
    let at_once = if model.t_d > 0.0 { 0.0 } else { 1.0 };
    let (engine, propeller) =
        (model.inertia.abs(), if flexible { model.tau_prop } else { model.inertia.abs() });
    let own = if flexible {
        model.g.abs() / engine + model.p.abs() / propeller
    } else {
        (model.p - model.g).abs() / engine
    };
    let mut fastest = own + model.damping.abs() / propeller + at_once * (model.v * model.k_p).abs() / engine;
    fastest += at_once * ((model.v * model.k_i).abs() / engine).sqrt();
    if flexible {
        let both = 1.0 / engine + 1.0 / propeller;
        fastest += (both / model.tau_twist).sqrt() + model.zeta * both;
    }
    if model.tau_act > 0.0 {
        fastest += 1.0 / model.tau_act;
    }
    let fine = match (flexible, run.sharp) {
        (false, true) => FINE,
        (false, false) => ROUGH,
        (true, true) => FINE_FLEXIBLE,
        (true, false) => ROUGH_FLEXIBLE,
    };
    let mut longest = (fine / (fastest * run.dt)).min(1.0);
    let most = if run.sharp { MOST } else { ROUGH_MOST };
    require_slow(longest * most >= 1.0 || run.sharp && !flexible, || {
        format!(
            "found {:.0} steps of the fastest time constant in a sample of the record, expected at most {most}; check tau_n and tau_act, or tau_twist and zeta_twist",
            1.0 / longest
        )
    })?;
    longest = longest.min(1.0 / run.substeps.max(1) as f64);
    if model.t_d > 0.0 {
        longest = longest.min(model.t_d / run.dt);
    }
    Ok(longest.max(1.0 / MOST))
}

/// Roughly how many steps of a rigid shaft a simulation is worth.
pub fn work(task: &Task<'_>, run: &Run<'_>) -> usize {
    if task.parameters.is_off(at::TAU_TWIST) {
        return run.samples().saturating_mul(run.substeps.max(1));
    }
    let model = Model::new(&task.parameters, 1.0, 0.0, quick(run));
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // positive; saturates
    run.samples().saturating_mul(longest(&model, run).map_or(1, |longest| (2.0 / longest) as usize))
}

impl<const EXPONENT: bool, const T: usize> WithSimd for Pass<'_, '_, EXPONENT, T> {
    type Output = Result<()>;

    #[inline(always)]
    #[allow(clippy::too_many_lines)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        let Self { task, run, stop, consume } = self;
        let (set0, load0) = (run.set[0], run.load.first().copied().unwrap_or(0.0));
        let model = Model::new(&task.parameters, set0, load0, quick(run));
        let delayed = model.t_d > 0.0;
        let longest = longest(&model, run)?;
        let (grid, history) = pieces(&model, task, run, longest)?;
        let places = history.as_ref().map_or(0, History::places);
        let mut outside = Outside::new(run, &model, places);
        let mut derivatives = Derivatives::<T>::start(&model, task.wrt, places, load0);
        let sources = Sources::new(&model, task.wrt, set0, load0);
        let mut emit = Emit::new(&model, (&model, OfTorque::FREE), task, run);
        let mut steps = Steps::new(grid, history, &emit.channels(), run.dt);
        let mut state = model.start(load0);
        let mut jets = Jets::default();
        let (mut fed_at_end, mut set_at_end) = (model.f0 / model.v, set0);
        let carry = slopes::carry::<S, T>(&model);
        let mut count = 0_usize;
        let mut ordinary = const { !is_flexible(T) } && cruise::is_ordinary(&model, task, run);
        while !emit.is_done() {
            if let Some(lap) = steps.lap().filter(|_| ordinary) {
                let aboard = Aboard {
                    model: &model,
                    sources: &sources,
                    run,
                    stop,
                    outside,
                    state,
                    derivatives,
                    count,
                    emit,
                };
                if let Some(cruise) = Cruise::new(lap, &aboard) {
                    return cruise.sail::<S, EXPONENT, T>(simd, aboard, consume);
                }
                Aboard { outside, derivatives, emit, .. } = aboard;
                ordinary = false;
            }
            count += 1;
            if count.is_multiple_of(4096) {
                stop.check()?;
            }
            let (step, window, place) = steps.next();
            let piece = &step.piece;
            let over = outside.over::<T>(&model, piece, window.as_ref(), step.inverse);
            let feed = &over.feed;
            let broken = piece.cut.filter(|_| run.hold == Hold::Zero || model.k_d != 0.0);
            let less = if delayed {
                fed_at_end - feed[0]
            } else {
                model.k_p * model.s_u * (set_at_end - over.set.value)
            };
            if broken.is_some() && model.ahead > 0.0 {
                state = model.kicked(&state, less);
            }
            let times = [piece.length * run.dt, step.inverse];
            let end = model.jets::<EXPONENT, T>(&state, times, feed, over.load, &mut jets);
            let back = outside.returned::<T>(&model, &jets, place, &over);
            if let Some(moves) = broken {
                sources.jump(&model, moves, less, &mut derivatives.state);
            }
            emit.aim::<T>(step, &jets);
            if derivatives.packs() > 0 {
                let given = sources.given::<T>(&model, &jets, &over, back);
                let on = On { model: &model, given: &given, window: window.as_ref(), pack: 0 };
                derivatives.carry(simd, carry, &sources, on, place, &mut emit);
            }
            emit.add_sums();
            emit.flush(consume)?;
            fed_at_end = total(feed, T);
            set_at_end = over.set.value + over.set.slope;
            state = end;
        }
        Ok(())
    }
}

/// The pieces between the inputs' breaks, and room for those of a dead time.
fn pieces(model: &Model, task: &Task<'_>, run: &Run<'_>, longest: f64) -> Result<(Grid, Option<History>)> {
    let (dead_time, set_dead_time) = (model.t_d / run.dt, model.t_set / run.dt);
    let loaded = !run.load.is_empty();
    let handed_on = if model.k_d == 0.0 { usize::from(task.wrt.contains(&at::K_D)) } else { 4 };
    let levels = if run.sharp { LEVELS } else { 1 } + usize::from(run.hold == Hold::Zero) + handed_on;
    let grid = Grid::new(dead_time, set_dead_time, loaded, levels, longest);
    let back = pieces_back(dead_time, run.samples(), longest, if loaded { 2 * levels } else { levels })?;
    Ok((grid, (model.t_d > 0.0).then(|| History::new(dead_time, back))))
}

/// Most pieces within a dead time, and a few more.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked
fn pieces_back(dead_time: f64, samples: usize, longest: f64, cuts: usize) -> Result<usize> {
    let pieces = (dead_time.min(samples as f64) + 3.0) * (1.0 / longest + (cuts + 1) as f64);
    if pieces > 1e8 {
        return Err(Error::Invalid(format!(
            "T_d and the steps ask for {pieces:.1e} pieces of time within the dead time, expected at most 1e8; use fewer substeps"
        )));
    }
    Ok(pieces as usize + 8 + cuts)
}
