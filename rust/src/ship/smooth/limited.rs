//! Limits of the torque: pieces end where one takes hold or lets go.
//!
//! While a limit holds, the engine's torque is a line of the speed, and the governor goes on without moving it: the same ship with
//! another slope and without a rack. Neither the torque nor the speed's rate jumps at a switch, so the derivatives go on as they
//! are. What breaks there comes back a dead time later, weaker by an order each time; the first few times a piece begins with it.

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::instruction_set::arch;
use crate::integrate::Hold;
use crate::ship::march::{Consume, Task};
use crate::ship::parameters::{Parameters, at};
use crate::ship::run::Run;
use crate::stop::Stop;

use super::emit::{Emit, readings};
use super::history::{History, Window, moved};
use super::model::{FLEXIBLE_TERMS, Jets, Model, Series, State, TERMS};
use super::outside::{Outside, Over};
use super::reading::{OfTorque, Reading};
use super::slopes::{Derivatives, On, carry};
use super::sources::Sources;
use super::steps::Steps;
use super::{longest, pieces, quick};

/// Dead times through which a switch is followed.
const LEVELS: usize = 3;
/// The same where a millionth of a step does not count.
const ROUGH_LEVELS: usize = 2;
/// A switch within this part of a piece from an end of it comes at that end.
const LEAST: f64 = 1e-7;
/// Parts of a piece at which a switch is looked for.
const LOOKS: usize = 8;
/// Halvings that find a switch to rounding.
const HALVINGS: usize = 52;

/// Whether a ship switches only by limits of its torque.
pub fn is_limited(parameters: &Parameters, wrt: &[usize], run: &Run<'_>) -> bool {
    const OTHERS: [usize; 7] =
        [at::T_S, at::RATE_UP, at::RATE_DOWN, at::X_MAX, at::X_MIN, at::ANTI_WINDUP, at::K_D];
    // Where two limits may cross, the lower one wins: another switch.
    let crossing = !parameters.is_off(at::M_MIN)
        && (!parameters.is_off(at::M_MAX_SLOPE) || wrt.contains(&at::M_MAX_SLOPE));
    OTHERS.iter().all(|&place| parameters.is_off(place))
        && !wrt.contains(&at::K_D)
        && run.hold == Hold::First
        && !crossing
}

/// Simulate, and give every block of samples to `consume`.
///
/// # Errors
/// As the smooth path.
pub fn march(task: &Task<'_>, run: &Run<'_>, stop: &Stop, consume: &mut Consume<'_>) -> Result<()> {
    match (task.wrt.contains(&at::P), task.parameters.is_off(at::TAU_TWIST)) {
        (true, true) => arch().dispatch(Pass::<true, TERMS> { task, run, stop, consume }),
        (false, true) => arch().dispatch(Pass::<false, TERMS> { task, run, stop, consume }),
        (true, false) => arch().dispatch(Pass::<true, FLEXIBLE_TERMS> { task, run, stop, consume }),
        (false, false) => arch().dispatch(Pass::<false, FLEXIBLE_TERMS> { task, run, stop, consume }),
    }
}

/// Which limit holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Held {
    Not,
    High,
    Low,
}

impl Held {
    /// Parameters of the engine's torque meanwhile.
    const fn torque(self) -> OfTorque {
        match self {
            Self::Not => OfTorque::FREE,
            Self::High => OfTorque { slope: Some(at::M_MAX_SLOPE), rack: None, level: Some(at::M_MAX) },
            Self::Low => OfTorque { slope: None, rack: None, level: Some(at::M_MIN) },
        }
    }
}

/// A limit: the torque at the speed of one, and its slope by the speed.
#[derive(Debug, Clone, Copy)]
struct Limit {
    level: f64,
    slope: f64,
}

impl Limit {
    /// How far the torque without limits is above it, over a piece.
    #[inline(always)]
    fn passed<const T: usize>(&self, free: &Model, jets: &Jets) -> Series {
        let mut above = [0.0; 8];
        for k in 0..=T {
            above[k] = (free.g - self.slope) * jets.n[k] + free.v * jets.rack[k];
        }
        above[0] += 1.0 - self.level;
        above
    }
}

/// A piece up to a switch, if there is one.
struct Reached {
    /// So much of the piece that was proposed; next to nothing where the switch is at its start.
    part: f64,
    next: Option<(f64, Held)>,
    window: Option<Window>,
    over: Over,
    end: State,
}

/// The ship while nothing or one of its limits holds, with all that differs.
struct Modes {
    models: [Model; 3],
    sources: [Sources; 3],
    /// How outputs are read; the present ones are with what emits them.
    readings: [Vec<Reading>; 3],
    high: Limit,
    low: Limit,
    now: Held,
    /// The limit that holds has just begun or ended to: the torque is on it.
    fresh: bool,
}

impl Modes {
    fn new(task: &Task<'_>, free: Model, set0: f64, load0: f64) -> Self {
        let of = |place: usize| task.parameters.of(place);
        let high = Limit { level: of(at::M_MAX), slope: of(at::M_MAX_SLOPE) };
        let low = Limit { level: of(at::M_MIN), slope: 0.0 };
        let models = [free, free.held(high.level, high.slope), free.held(low.level, low.slope)];
        let sources = Sources::new(&free, task.wrt, set0, load0);
        let torque = 1.0 + free.g * free.n0 + free.f0;
        let now = if torque > high.level + high.slope * free.n0 {
            Held::High
        } else if torque < low.level {
            Held::Low
        } else {
            Held::Not
        };
        Self {
            models,
            readings: [Held::Not, Held::High, Held::Low]
                .map(|held| readings(&models[held as usize], task, held.torque())),
            sources: [
                sources.clone(),
                sources.held(at::M_MAX, Some(at::M_MAX_SLOPE)),
                sources.held(at::M_MIN, None),
            ],
            high,
            low,
            now,
            fresh: false,
        }
    }

    /// The first switch within a piece: at which part of it, and to what.
    #[inline(always)]
    fn switch<const T: usize>(&self, jets: &Jets) -> Option<(f64, Held)> {
        let free = &self.models[0];
        let high = || self.high.passed::<T>(free, jets);
        let low = || self.low.passed::<T>(free, jets).map(|above| -above);
        let less = |series: Series| series.map(|term| -term);
        let look = |series: Series, next| {
            self.first_above::<T>(series)
                .map(|part| (part, next))
                .filter(|&(part, _)| !self.fresh || part > LEAST)
        };
        match self.now {
            Held::High => look(less(high()), Held::Not),
            Held::Low => look(less(low()), Held::Not),
            Held::Not => {
                let above = self.high.level.is_finite().then(|| look(high(), Held::High)).flatten();
                let below = self.low.level.is_finite().then(|| look(low(), Held::Low)).flatten();
                match (above, below) {
                    (Some(above), Some(below)) if below.0 < above.0 => Some(below),
                    (above, below) => above.or(below),
                }
            }
        }
    }

    /// The first part of a piece at which a signal is above nothing. Of one that was just on it, what it does from there on.
    #[inline(always)]
    fn first_above<const T: usize>(&self, mut series: Series) -> Option<f64> {
        if self.fresh && series[0].abs() < 1e-6 {
            series.copy_within(1.., 0);
            series[7] = 0.0;
            if series[0] > 0.0 {
                return None;
            }
        } else if series[0] > 0.0 {
            return Some(0.0);
        }
        let most: f64 = series[0] + series[1..=T].iter().map(|term| term.max(0.0)).sum::<f64>();
        if most <= 0.0 { None } else { above_within(&series) }
    }

    /// Over the piece to come, as far as nothing switches.
    #[inline(always)]
    fn reach<const EXPONENT: bool, const T: usize>(
        &self,
        state: &State,
        steps: &mut Steps,
        outside: &mut Outside<'_>,
        run: &Run<'_>,
        jets: &mut Jets,
    ) -> Reached {
        let (free, present) = (&self.models[0], &self.models[self.now as usize]);
        let (mut part, mut next) = (1.0, None);
        loop {
            let (piece, window) = steps.propose(part);
            let length = piece.length * run.dt;
            let over = outside.over::<T>(free, &piece, window.as_ref(), 1.0 / length);
            let end = present.jets::<EXPONENT, T>(state, [length, 1.0 / length], &over.feed, over.load, jets);
            if next.is_none() {
                next = self.switch::<T>(jets);
                if let Some((at, _)) = next.filter(|&(at, _)| at < 1.0 - LEAST) {
                    part = at;
                    if part > LEAST {
                        continue;
                    }
                }
            }
            return Reached { part, next, window, over, end };
        }
    }

    /// A limit takes hold or lets go.
    fn turn(&mut self, next: Held, emit: &mut Emit<'_>) {
        std::mem::swap(&mut self.readings[self.now as usize], &mut emit.readings);
        self.now = next;
        std::mem::swap(&mut self.readings[next as usize], &mut emit.readings);
        self.fresh = true;
    }
}

/// The first part of a piece at which a series that begins below nothing is above it.
#[inline(never)]
fn above_within(series: &Series) -> Option<f64> {
    let value = |x: f64| series.iter().rev().fold(0.0, |sum, term| sum * x + term);
    let rate = |x: f64| (1..8_u8).rev().fold(0.0, |sum, k| sum * x + f64::from(k) * series[usize::from(k)]);
    let halved = |mut low: f64, mut high: f64, is: &dyn Fn(f64) -> bool| {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if is(middle) { high = middle } else { low = middle }
        }
        high
    };
    let mut from = 0.0;
    for look in 1..=LOOKS {
        let to = look as f64 / LOOKS as f64;
        let mut end = to;
        if value(to) <= 0.0 && rate(from) > 0.0 && rate(to) < 0.0 {
            // A rise that falls again within the part.
            end = halved(from, to, &|x| rate(x) < 0.0);
        }
        if value(end) > 0.0 {
            return Some(halved(from, end, &|x| value(x) > 0.0));
        }
        from = to;
    }
    None
}

struct Pass<'a, 'c, const EXPONENT: bool, const T: usize> {
    task: &'a Task<'a>,
    run: &'a Run<'a>,
    stop: &'a Stop,
    consume: &'a mut Consume<'c>,
}

impl<const EXPONENT: bool, const T: usize> WithSimd for Pass<'_, '_, EXPONENT, T> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        let Self { task, run, stop, consume } = self;
        let (set0, load0) = (run.set[0], run.load.first().copied().unwrap_or(0.0));
        let model = Model::new(&task.parameters, set0, load0, quick(run));
        let mut modes = Modes::new(task, model, set0, load0);
        let mut longest_piece = f64::INFINITY;
        for model in &modes.models {
            longest_piece = longest_piece.min(longest(model, run)?);
        }
        let (grid, history) = pieces(&model, task, run, longest_piece)?;
        let places = history.as_ref().map_or(0, History::places);
        let mut outside = Outside::new(run, &model, places);
        let mut derivatives = Derivatives::<T>::start(&model, task.wrt, places, load0);
        let mut emit = Emit::new(&model, (&modes.models[modes.now as usize], modes.now.torque()), task, run);
        let mut steps = Steps::new(grid, history, &emit.channels(), run.dt);
        let levels = match (model.t_d > 0.0, run.sharp) {
            (false, _) => 0,
            (true, true) => LEVELS,
            (true, false) => ROUGH_LEVELS,
        };
        let mut state = model.start(load0);
        let mut jets = Jets::default();
        let carry = carry::<S, T>(&model);
        let mut count = 0_usize;
        while !emit.is_done() {
            count += 1;
            if count.is_multiple_of(1024) {
                stop.check()?;
            }
            if let Some(moves) = steps.grow() {
                outside.backs = moved(&outside.backs, 1, &moves);
                derivatives.backs = moved(&derivatives.backs, derivatives.packs(), &moves);
            }
            let present = modes.now as usize;
            let reached = modes.reach::<EXPONENT, T>(&state, &mut steps, &mut outside, run, &mut jets);
            let Reached { part, next, window, over, end } = reached;
            if let Some((_, held)) = next.filter(|_| part <= LEAST) {
                modes.turn(held, &mut emit);
                steps.expect(model.t_d / run.dt, levels);
                continue;
            }
            let (step, place) = steps.take(part, window);
            let back = outside.returned::<T>(&model, &jets, place, &over);
            emit.aim::<T>(&step, &jets);
            if derivatives.packs() > 0 {
                let sources = &modes.sources[present];
                let given = sources.given::<T>(&model, &jets, &over, back);
                let on =
                    On { model: &modes.models[present], given: &given, window: window.as_ref(), pack: 0 };
                derivatives.carry(simd, carry, sources, on, place, &mut emit);
            }
            emit.add_sums();
            emit.flush(consume)?;
            state = end;
            modes.fresh = false;
            if let Some((_, held)) = next {
                modes.turn(held, &mut emit);
                steps.expect(model.t_d / run.dt, levels);
            }
        }
        Ok(())
    }
}
