//! Exact discretisation of the linear structure: one step of the sample time, both dead times included, with derivatives.
//!
//! Divided by `tau_n`, the loop has three rates only: `a = (p - g)/tau_n`, `b = v K_p/tau_n`, `c = v K_i/tau_n`,
//!
//! ```text
//! n' = -a n + b u2 + y      E' = u1 - n      u1(t) = r(t - T_set)      u2(t) = u1(t - T_d)
//! ```
//!
//! where `y` is `z = c E - b n` delayed by `T_d`. Every derivative is taken by the rates, the dead times and the initial state
//! (the `DIRECTIONS`); the parameters follow by the chain rule.
//!
//! The set point is delayed exactly: a sample interval is split where the delayed hold has its corner (Astrom and Wittenmark,
//! *Computer-Controlled Systems*, 3rd ed., section 3.2). `z` is continuous and goes through a Legendre delay network of order 6
//! (Voelker and Eliasmith 2018, DOI `10.1162/neco_a_01046`), the [5/6] Pade approximation of `exp(-s T_d)`, in error by
//! 2.4e-6 at `omega T_d = 3`. The network's states are scaled to be orthonormal.

pub use super::number::DIRECTIONS;
use super::number::{Matrix, Number};
use super::parameters::Parameters;
use crate::hold::Hold;

/// States without a dead time in the loop: n, E.
pub const DIRECT: usize = 2;
/// States with one: n, E and the delay network.
pub const DELAYED: usize = 8;

/// Directions of differentiation, [`DIRECTIONS`] in all: the rates a, b, c, the dead times, the initial n and E.
pub const BY_A: usize = 0;
pub const BY_B: usize = 1;
pub const BY_C: usize = 2;
pub const BY_T_D: usize = 3;
pub const BY_T_SET: usize = 4;
pub const BY_START_N: usize = 5;
pub const BY_START_E: usize = 6;

/// The shortest dead time, in samples, that gets its network: a shorter one changes nothing worth a stiffer matrix.
pub const SHORTEST_NETWORK: f64 = 1e-8;
/// Dead times are at most so long [samples].
const LATEST: f64 = (1_u64 << 50) as f64;
/// A dead time this close to a whole number of samples is one: 0.3 s at 100 Hz is 30 samples, not 29 and a rounding error.
const WHOLE: f64 = 1e-9;

/// One step and what is read at its start, or the derivatives of both by one direction.
///
/// With `rho[j]` the samples `r[k-m-1], r[k-m], r[k-m+1]` of input `j` (`m` whole samples late):
/// `x[k+1] = phi x[k] + sum_j taps[.][j] rho[j]`, `n'[k] = slope x[k] + sum_j slope_feed[j] rho[j]`, `u1[k] = set_feed rho[0]`.
/// A step over `T - 2` samples at once has as many taps more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<const N: usize, const J: usize, const T: usize> {
    pub phi: [[f64; N]; N],
    pub taps: [[[f64; T]; J]; N],
    pub slope: [f64; N],
    pub slope_feed: [[f64; T]; J],
    pub set_feed: [f64; T],
    /// Whether `phi` is not zero: a dead time of the set point and the initial state leave the loop as it is.
    pub moves_phi: bool,
    /// Whether what is fed in and read depends on it: the initial state leaves both as they are.
    pub moves_feed: bool,
}

/// A step and its derivatives by the directions asked for.
#[derive(Debug, Clone)]
pub struct Stepper<const N: usize, const J: usize, const T: usize> {
    pub step: Step<N, J, T>,
    pub by: Vec<Step<N, J, T>>,
}

/// Samples that a leap takes at once.
pub const LEAP: usize = 8;

/// The discrete model.
#[derive(Debug, Clone)]
pub struct Model<const N: usize, const J: usize> {
    pub stepper: Stepper<N, J, 3>,
    /// The same over [`LEAP`] samples at once, for a pass that only wants the last state.
    pub leaper: Stepper<N, J, { LEAP + 2 }>,
    pub start: [f64; N],
    pub start_by: Vec<[f64; N]>,
    /// How many whole samples each input is late.
    pub late: [usize; J],
    /// `phi` to the power of the segment's length, and its derivatives.
    pub across: [[f64; N]; N],
    pub across_by: Vec<[[f64; N]; N]>,
}

/// A delayed input: whole samples, and the fraction of a sample on top.
struct Delay {
    whole: usize,
    fraction: Number,
}

impl Delay {
    fn new(time: Number, dt: f64) -> Self {
        // Later than any record is long; past that a quotient would lose its fraction, and then its value.
        let samples = (time.value() / dt).min(LATEST);
        let nearest = samples.round();
        let whole = if (samples - nearest).abs() < WHOLE { nearest } else { samples.floor() };
        let excess = samples - whole;
        let fraction = (time * dt.recip()).with_value(if excess < WHOLE { 0.0 } else { excess });
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturates, and is not negative
        Self { whole: whole as usize, fraction }
    }

    /// The set point and its slope just after the start of either part of a sample interval, from `rho`.
    fn corners(&self, dt: f64, hold: Hold) -> [Matrix<2, 3>; 2] {
        let f = self.fraction;
        match hold {
            Hold::Zero => [
                Matrix::from_values([[1.0, 0.0, 0.0], [0.0; 3]]),
                Matrix::from_values([[0.0, 1.0, 0.0], [0.0; 3]]),
            ],
            Hold::First => {
                let slope = Number::constant(dt.recip());
                [
                    Matrix([[f, Number::ONE - f, Number::ZERO], [-slope, slope, Number::ZERO]]),
                    Matrix([[Number::ZERO, Number::ONE, Number::ZERO], [Number::ZERO, -slope, slope]]),
                ]
            }
        }
    }

    /// The set point at the sample itself: the right-hand limit at a step.
    fn at_sample(&self, dt: f64, hold: Hold) -> [Number; 3] {
        let late = hold == Hold::Zero && self.fraction.value() == 0.0;
        self.corners(dt, hold)[usize::from(late)].0[0]
    }
}

/// The loop's rates and dead time as numbers.
#[derive(Clone, Copy)]
struct Loop {
    a: Number,
    b: Number,
    c: Number,
    t_d: Number,
}

impl Loop {
    /// The matrix of the states.
    #[allow(clippy::needless_range_loop)] // a row and a column at once
    fn matrix<const N: usize>(self) -> Matrix<N, N> {
        let Self { a, b, c, t_d } = self;
        let mut matrix = Matrix::<N, N>::ZERO;
        let entries = &mut matrix.0;
        entries[0][0] = -a;
        entries[1][0] = -Number::ONE;
        if N == DIRECT {
            entries[0][0] = -a - b;
            entries[0][1] = c;
        }
        for i in 2..N {
            let norm = |i: usize| ((2 * (i - 2) + 1) as f64).sqrt();
            let rate = t_d.inverse() * norm(i);
            let into = if i % 2 == 0 { rate } else { -rate };
            entries[0][i] = Number::constant(norm(i));
            entries[i][0] = -b * into;
            entries[i][1] = c * into;
            for (j, entry) in entries[i].iter_mut().enumerate().skip(2) {
                *entry = if i < j || (i - j) % 2 == 0 { -rate } else { rate } * norm(j);
            }
        }
        matrix
    }

    /// The states at the first sample. The delay network's input was constant before the record, so only its constant part
    /// is not zero.
    fn start<const N: usize>(self, [n, e]: [f64; 2]) -> [Number; N] {
        let (n, e) = (Number::variable(n, BY_START_N), Number::variable(e, BY_START_E));
        let z = self.c * e - self.b * n;
        std::array::from_fn(|i| [n, e, z].get(i).copied().unwrap_or(Number::ZERO))
    }
}

/// One step of the sample time, in numbers that carry all derivatives.
struct OneStep<const N: usize, const J: usize> {
    loop_: Loop,
    delays: [Delay; J],
    dynamics: Matrix<N, N>,
    phi: Matrix<N, N>,
    taps: [Matrix<N, 3>; J],
    feeds: [[Number; 3]; J],
    slope_feed: [[Number; 3]; J],
}

impl<const N: usize, const J: usize> OneStep<N, J> {
    /// Discretise; `A` is `N + 2`.
    fn new<const A: usize>(parameters: &Parameters, dt: f64, hold: Hold) -> Self {
        let [a, b, c] = rates(parameters);
        let loop_ = Loop {
            a: Number::variable(a, BY_A),
            b: Number::variable(b, BY_B),
            c: Number::variable(c, BY_C),
            t_d: Number::variable(parameters.t_d.max(SHORTEST_NETWORK * dt), BY_T_D),
        };
        let dynamics = loop_.matrix::<N>();
        let t_set = Number::variable(parameters.t_set, BY_T_SET);
        let t_d = Number::variable(parameters.t_d, BY_T_D);
        let delays: [Delay; J] =
            std::array::from_fn(|j| Delay::new(if j == 0 { t_set } else { t_set + t_d }, dt));
        // Input 0 drives E (and n, where no dead time stands between), the last input n.
        let drives_speed = |j: usize| j + 1 == J;

        let mut phi = Matrix::ZERO;
        let taps: [Matrix<N, 3>; J] = std::array::from_fn(|j| {
            let Delay { fraction, .. } = delays[j];
            let mut augmented = Matrix::<A, A>::ZERO;
            augmented.put(0, 0, &dynamics);
            augmented.0[0][N] = if drives_speed(j) { loop_.b } else { Number::ZERO };
            augmented.0[1][N] = if j == 0 { Number::ONE } else { Number::ZERO };
            augmented.0[N][N + 1] = Number::ONE;
            let early = augmented.times(fraction * dt).exp();
            let late = augmented.times((Number::ONE - fraction) * dt).exp();
            let over: [Matrix<N, N>; 2] = [early.block(0, 0), late.block(0, 0)];
            let from_input: [Matrix<N, 2>; 2] = [early.block(0, N), late.block(0, N)];
            let [early_corner, late_corner] = delays[j].corners(dt, hold);
            phi = over[1].product(&over[0]);
            let mut taps = over[1].product(&from_input[0].product(&early_corner));
            taps.add(&[1.0], [&from_input[1].product(&late_corner)]);
            taps
        });

        let feeds: [[Number; 3]; J] = std::array::from_fn(|j| delays[j].at_sample(dt, hold));
        let slope_feed: [[Number; 3]; J] = std::array::from_fn(|j| {
            if drives_speed(j) { feeds[j].map(|tap| tap * loop_.b) } else { [Number::ZERO; 3] }
        });
        Self { loop_, delays, dynamics, phi, taps, feeds, slope_feed }
    }

    /// The step, or its derivatives by one direction.
    fn part(&self, direction: Option<usize>) -> Step<N, J, 3> {
        Step {
            phi: self.phi.part(direction),
            taps: taps_by_state(&self.taps, direction),
            slope: self.dynamics.part(direction)[0],
            slope_feed: self.slope_feed.map(|feed| feed.map(|tap| tap.part(direction))),
            set_feed: self.feeds[0].map(|tap| tap.part(direction)),
            moves_phi: moves_phi(direction),
            moves_feed: !matches!(direction, Some(BY_START_N | BY_START_E)),
        }
    }

    /// How many whole samples each input is late.
    fn late(&self) -> [usize; J] {
        std::array::from_fn(|j| self.delays[j].whole)
    }
}

/// Discretise; `A` is `N + 2`.
fn discretise<const N: usize, const A: usize, const J: usize>(
    parameters: &Parameters,
    dt: f64,
    hold: Hold,
    initial: [f64; 2],
    directions: &[usize],
    segment: usize,
) -> Model<N, J> {
    let one = OneStep::<N, J>::new::<A>(parameters, dt, hold);
    let OneStep { loop_, phi, taps, .. } = &one;

    let mut leap_phi = Matrix::identity();
    let mut leap_taps = [Matrix::<N, { LEAP + 2 }>::ZERO; J];
    for sample in 0..LEAP {
        leap_phi = phi.product(&leap_phi);
        for (leap_taps, taps) in leap_taps.iter_mut().zip(taps) {
            let mut shifted = Matrix::ZERO;
            shifted.put(0, sample, taps);
            *leap_taps = phi.product(leap_taps);
            leap_taps.add(&[1.0], [&shifted]);
        }
    }

    let leap = |direction| Step {
        phi: leap_phi.part(direction),
        taps: taps_by_state(&leap_taps, direction),
        slope: [0.0; N],
        slope_feed: [[0.0; LEAP + 2]; J],
        set_feed: [0.0; LEAP + 2],
        moves_phi: moves_phi(direction),
        moves_feed: !matches!(direction, Some(BY_START_N | BY_START_E)),
    };
    let start = loop_.start::<N>(initial);
    let start = |direction| start.map(|state| state.part(direction));
    let across = phi.power(segment);
    let each = directions.iter().map(|&direction| Some(direction));
    Model {
        stepper: Stepper {
            step: one.part(None),
            by: each.clone().map(|direction| one.part(direction)).collect(),
        },
        leaper: Stepper { step: leap(None), by: each.clone().map(leap).collect() },
        start: start(None),
        start_by: each.clone().map(start).collect(),
        late: one.late(),
        across: across.part(None),
        across_by: each.map(|direction| across.part(direction)).collect(),
    }
}

/// Whether the loop's own matrix depends on that direction.
const fn moves_phi(direction: Option<usize>) -> bool {
    !matches!(direction, Some(BY_T_SET | BY_START_N | BY_START_E))
}

fn taps_by_state<const N: usize, const J: usize, const T: usize>(
    taps: &[Matrix<N, T>; J],
    direction: Option<usize>,
) -> [[[f64; T]; J]; N] {
    let by_input = taps.each_ref().map(|taps| taps.part(direction));
    std::array::from_fn(|i| std::array::from_fn(|j| by_input[j][i]))
}

/// The three rates of the loop, a, b, c.
pub fn rates(parameters: &Parameters) -> [f64; 3] {
    let Parameters { tau_n, g, v, k_p, k_i, p, .. } = *parameters;
    [(p - g) / tau_n, v * k_p / tau_n, v * k_i / tau_n]
}

/// The model without a dead time in the loop.
pub fn direct(
    parameters: &Parameters,
    dt: f64,
    hold: Hold,
    initial: [f64; 2],
    directions: &[usize],
    segment: usize,
) -> Model<DIRECT, 1> {
    discretise::<DIRECT, 4, 1>(parameters, dt, hold, initial, directions, segment)
}

/// The model with a delay network in the loop.
pub fn delayed(
    parameters: &Parameters,
    dt: f64,
    hold: Hold,
    initial: [f64; 2],
    directions: &[usize],
    segment: usize,
) -> Model<DELAYED, 2> {
    discretise::<DELAYED, 10, 2>(parameters, dt, hold, initial, directions, segment)
}

#[cfg(test)]
mod tests;
