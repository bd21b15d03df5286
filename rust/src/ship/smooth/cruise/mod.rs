//! The ordinary ship under way: once every sample interval has the pieces of the one before, several are passed side by side.
//!
//! What the rack is fed is known for a dead time ahead. So the sample intervals of a dead time, at most eight, stand in the
//! lanes of a vector: each starts from a guess, and by what the end of one misses the start of the next the starts are moved,
//! by Newton's rule, until nothing is missed. The derivatives follow from one piece to the next, a direction in each lane.

mod carry;
mod fed;
mod passage;

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::integrate::Hold;
use crate::ship::march::{Consume, Task};
use crate::ship::output::Output;
use crate::ship::parameters::at;
use crate::ship::run::Run;
use crate::stop::Stop;

use super::emit::Emit;
use super::grid::{Piece, Time};
use super::history::{Window, past_value};
use super::model::{Jets, Model, PER_ORDER, Series, State, TERMS};
use super::outside::Outside;
use super::slopes::{Derivatives, LANES, Pack};
use super::sources::Sources;
use super::steps::Step;

use passage::Passage;

/// Whether it is an ordinary ship: a rigid shaft, no lag, no derivative gain, a dead time, and straight lines between samples.
pub fn is_ordinary(model: &Model, task: &Task<'_>, run: &Run<'_>) -> bool {
    let plain = model.tau_twist == 0.0 && model.tau_act == 0.0 && model.k_d == 0.0;
    let begins = |place| task.wrt.contains(&place);
    plain
        && model.t_d > 0.0
        && run.hold == Hold::First
        && !begins(at::K_D)
        && !task.outputs.contains(&Output::Sum)
}

/// A past piece that is read: how many pieces back it lies, how many sample intervals, and which piece of that one; and what its
/// terms make, less, of those fed to the rack.
#[derive(Debug, Clone, Copy)]
struct Past {
    pieces: usize,
    laps: usize,
    leg: usize,
    less: [[f64; TERMS]; TERMS],
}

/// A piece of every sample interval.
#[derive(Debug, Clone)]
struct Leg {
    /// In the interval to come.
    piece: Piece,
    /// [s], and its inverse.
    length: f64,
    inverse: f64,
    /// Its length over the shaft's time constant and by itself, each by one over the number of a term and one.
    paces: [f64; TERMS],
    lengths: [f64; TERMS],
    first: Past,
    last: Option<Past>,
}

/// What a parameter adds by itself to an output: the lanes of those that do, and the weights of the terms of speed and rack; none
/// where it is the output's level.
struct Own {
    packs: Vec<Pack>,
    weights: Option<[Series; 2]>,
    size: Pack,
}

/// A sample of every sample interval: the piece in which it lies, and what the terms of speed and rack weigh in it.
struct Point {
    output: usize,
    channel: usize,
    leg: usize,
    constant: f64,
    speeds: Series,
    racks: Option<Series>,
    own: Vec<Own>,
}

/// A ship under way.
pub struct Cruise {
    legs: Vec<Leg>,
    points: Vec<Point>,
    /// Sample intervals side by side.
    width: usize,
    passages: Vec<Passage>,
    past: fed::Past,
}

/// What is at hand where the ordinary pieces begin.
pub struct Aboard<'s, 'a, const T: usize> {
    pub model: &'s Model,
    pub sources: &'s Sources,
    pub run: &'s Run<'a>,
    pub stop: &'s Stop,
    pub outside: Outside<'a>,
    pub state: State,
    pub derivatives: Derivatives<T>,
    pub count: usize,
    pub emit: Emit<'a>,
}

struct Sail<'s, 'a, 'c, 'f, const EXPONENT: bool, const T: usize> {
    cruise: Cruise,
    aboard: Aboard<'s, 'a, T>,
    consume: &'c mut Consume<'f>,
}

impl<const EXPONENT: bool, const T: usize> WithSimd for Sail<'_, '_, '_, '_, EXPONENT, T> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        self.cruise.through::<S, EXPONENT, T>(simd, self.aboard, self.consume)
    }
}

impl Cruise {
    /// For a sample interval whose pieces repeat; None where its past is not a few of them, or samples don't repeat.
    pub fn new<const T: usize>(lap: &[Step], aboard: &Aboard<'_, '_, T>) -> Option<Self> {
        let legs: Vec<Leg> = lap
            .iter()
            .enumerate()
            .map(|(at, step)| leg(step, at, lap.len(), aboard.model.per_inertia))
            .collect::<Option<_>>()?;
        let pasts = || legs.iter().flat_map(|leg| [Some(leg.first), leg.last]).flatten();
        let width = pasts().map(|past| past.laps).min()?.min(LANES);
        let points = points(lap, aboard)?;
        if width < 2 {
            return None;
        }
        let keep = pasts().map(|past| past.laps).max()?;
        let past = fed::Past::new(keep, lap.len(), &aboard.outside.backs, aboard.count);
        let passages = vec![Passage::default(); lap.len()];
        Some(Self { legs, points, width, passages, past })
    }

    /// To the end of the record. Apart from what calls it, whose numbers would stand in the way of those here.
    #[inline(never)]
    pub fn sail<S: Simd, const EXPONENT: bool, const T: usize>(
        self,
        simd: S,
        aboard: Aboard<'_, '_, T>,
        consume: &mut Consume<'_>,
    ) -> Result<()> {
        simd.vectorize(Sail::<EXPONENT, T> { cruise: self, aboard, consume })
    }

    #[inline(always)]
    fn through<S: Simd, const EXPONENT: bool, const T: usize>(
        mut self,
        simd: S,
        mut aboard: Aboard<'_, '_, T>,
        consume: &mut Consume<'_>,
    ) -> Result<()> {
        let mut flights = 0_usize;
        while !aboard.emit.is_done() {
            flights += 1;
            if flights.is_multiple_of(512) {
                aboard.stop.check()?;
            }
            self.feed::<S, T>(simd, &mut aboard);
            self.pass::<S, EXPONENT, T>(simd, &mut aboard);
            self.read::<S, T>(simd, &mut aboard);
            carry::apart::<S, T>(simd, &self, &mut aboard);
            aboard.count += self.width * self.legs.len();
            aboard.emit.passed(self.width);
            aboard.emit.flush(consume)?;
        }
        Ok(())
    }

    /// Read the outputs, and what parameters add to their derivatives by themselves.
    #[inline(always)]
    fn read<S: Simd, const T: usize>(&mut self, simd: S, aboard: &mut Aboard<'_, '_, T>) {
        let s_m = aboard.model.s_m;
        for at in 0..self.points.len() {
            let point = &mut self.points[at];
            let passage = &self.passages[point.leg];
            let mut simulated = Pack([point.constant; LANES]);
            passage.add::<S, T>(simd, &point.speeds, point.racks.as_ref(), &mut simulated);
            for own in 0..point.own.len() {
                let own = &mut point.own[own];
                if let Some([speeds, racks]) = &own.weights {
                    own.size = Pack::ZERO;
                    passage.add::<S, T>(simd, speeds, Some(racks), &mut own.size);
                } else {
                    for lane in 0..LANES {
                        own.size.0[lane] = (simulated.0[lane] + 1.0) / s_m;
                    }
                }
            }
            for lap in 0..self.width {
                if let Some(slot) = aboard.emit.slot(point.output, point.channel, lap) {
                    aboard.emit.values[slot] = simulated.0[lap];
                }
            }
        }
    }
}

/// A piece of the sample interval to come, by the step that came before it, the place of that and their number.
fn leg(step: &Step, at: usize, legs: usize, per_inertia: f64) -> Option<Leg> {
    let Window { first, last } = step.window?;
    let window = Window { first: (0, first.1, first.2), last: last.map(|(_, x, scale)| (1, x, scale)) };
    let past = |pieces: usize, place: usize| {
        let mut less = [[0.0; TERMS]; TERMS];
        for j in 0..TERMS {
            let mut backs = [[0.0; 8]; 2];
            backs[place][j] = -1.0;
            let terms = past_value::<TERMS>(&window, &backs);
            for (row, term) in less.iter_mut().zip(terms) {
                row[j] = term;
            }
        }
        let laps = pieces.saturating_sub(at).div_ceil(legs);
        Past { pieces, laps, leg: at + laps * legs - pieces, less }
    };
    let Piece { start: Time { whole, part }, .. } = step.piece;
    Some(Leg {
        piece: Piece { start: Time { whole: whole + 1, part }, ..step.piece },
        length: 1.0 / step.inverse,
        inverse: step.inverse,
        paces: std::array::from_fn(|k| per_inertia / step.inverse * PER_ORDER[k]),
        lengths: std::array::from_fn(|k| PER_ORDER[k] / step.inverse),
        first: past(first.0, 0),
        last: last.map(|(pieces, ..)| past(pieces, 1)),
    })
}

/// The samples of a sample interval; None where a channel has not one of them.
fn points<const T: usize>(lap: &[Step], aboard: &Aboard<'_, '_, T>) -> Option<Vec<Point>> {
    let mut points = Vec::new();
    for (channel, outputs) in aboard.emit.outputs().enumerate() {
        let mut of = lap.iter().enumerate().filter_map(|(leg, step)| Some((leg, step.samples[channel]?)));
        let (Some((leg, part)), None) = (of.next(), of.next()) else { return None };
        let inverse = lap[leg].inverse;
        for &output in outputs {
            let mut reading = aboard.emit.readings[output].clone();
            reading.aim::<TERMS>(part, inverse);
            // What a term weighs: what it makes where it is one and all others are none.
            let weight = |own: usize, of: fn(&mut Jets) -> &mut Series| {
                let mut weights = [0.0; 8];
                for k in 0..=TERMS {
                    let mut jets = Jets { inverse, ..Jets::default() };
                    of(&mut jets)[k] = 1.0;
                    weights[k] = reading.sizes::<TERMS>(aboard.model, &jets, -1.0)[own];
                }
                weights
            };
            let own = reading.own.iter().map(|(own, packs)| Own {
                packs: packs.clone(),
                weights: (*own != 3)
                    .then(|| [weight(*own, |jets| &mut jets.n), weight(*own, |jets| &mut jets.rack)]),
                size: Pack::ZERO,
            });
            let own = own.collect();
            let (constant, speeds, racks) = (reading.constant, reading.speeds, reading.racks);
            points.push(Point { output, channel, leg, constant, speeds, racks, own });
        }
    }
    Some(points)
}
