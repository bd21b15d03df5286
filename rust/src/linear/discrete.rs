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

use nalgebra::SMatrix;

use super::jet::Jet;
use super::parameters::Parameters;
use crate::integrate::Hold;

/// States without a dead time in the loop: n, E.
pub const DIRECT: usize = 2;
/// States with one: n, E and the delay network.
pub const DELAYED: usize = 8;

/// Directions of differentiation: the rates a, b, c, the dead times, the initial n and E.
pub const DIRECTIONS: usize = 7;
pub const BY_A: usize = 0;
pub const BY_B: usize = 1;
pub const BY_C: usize = 2;
pub const BY_T_D: usize = 3;
pub const BY_T_SET: usize = 4;
pub const BY_START_N: usize = 5;
pub const BY_START_E: usize = 6;
/// The directions that the step depends on: all but the initial state.
const STEP_DIRECTIONS: usize = 5;

/// The shortest dead time, in samples, that gets its network: a shorter one changes nothing worth a stiffer matrix.
pub const SHORTEST_NETWORK: f64 = 1e-8;
/// A dead time this close to a whole number of samples is one: 0.3 s at 100 Hz is 30 samples, not 29 and a rounding error.
const WHOLE: f64 = 1e-9;

/// One step and what is read from it, or the derivatives of both by one direction.
///
/// With `rho[j]` the samples `r[k-m-1], r[k-m], r[k-m+1]` of input `j` (`m` whole samples late):
/// `x[k+1] = phi x[k] + sum_j taps[.][j] rho[j]`, `n'[k] = slope x[k] + sum_j slope_feed[j] rho[j]`, `u1[k] = set_feed rho[0]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<const N: usize, const J: usize> {
    pub phi: [[f64; N]; N],
    pub taps: [[[f64; 3]; J]; N],
    pub slope: [f64; N],
    pub slope_feed: [[f64; 3]; J],
    pub set_feed: [f64; 3],
    pub start: [f64; N],
}

/// The discrete model: its step, the derivatives asked for, and how many whole samples each input is late.
#[derive(Debug, Clone)]
pub struct Model<const N: usize, const J: usize> {
    pub step: Step<N, J>,
    pub by: Vec<Step<N, J>>,
    pub late: [usize; J],
    /// `phi` to the power of the segment's length, and its derivatives.
    pub across: [[f64; N]; N],
    pub across_by: Vec<[[f64; N]; N]>,
}

/// A delayed input: whole samples, the fraction of a sample on top, and the fraction's derivatives.
struct Delay<const P: usize> {
    whole: usize,
    fraction: f64,
    by: [f64; P],
}

impl<const P: usize> Delay<P> {
    fn new(time: f64, dt: f64, depends: &[usize]) -> Self {
        let samples = time / dt;
        let nearest = samples.round();
        let whole = if (samples - nearest).abs() < WHOLE { nearest } else { samples.floor() };
        let fraction = (samples - whole).max(0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturates, and is not negative
        Self {
            whole: whole as usize,
            fraction: if fraction < WHOLE { 0.0 } else { fraction },
            by: std::array::from_fn(|i| if depends.contains(&i) { 1.0 / dt } else { 0.0 }),
        }
    }

    fn minus_by(&self) -> [f64; P] {
        self.by.map(|slope| -slope)
    }
}

/// What the loop's matrix is linear in: a constant, and a, b, c and the network's rate `1/T_d` as they stand in it.
#[derive(Clone, Copy)]
struct Entries {
    one: f64,
    a: f64,
    b: f64,
    c: f64,
    rate: f64,
}

impl Entries {
    fn matrix<const N: usize>(self) -> SMatrix<f64, N, N> {
        let mut matrix = SMatrix::<f64, N, N>::zeros();
        matrix[(0, 0)] = -self.a;
        matrix[(1, 0)] = -self.one;
        if N == DIRECT {
            matrix[(0, 0)] -= self.b;
            matrix[(0, 1)] = self.c;
        }
        for i in 2..N {
            let norm = ((2 * (i - 2) + 1) as f64).sqrt();
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            matrix[(0, i)] = norm * self.one;
            matrix[(i, 0)] = -sign * norm * self.b;
            matrix[(i, 1)] = sign * norm * self.c;
            for j in 2..N {
                let norm = norm * ((2 * (j - 2) + 1) as f64).sqrt();
                let sign = if i < j || (i - j) % 2 == 0 { -1.0 } else { 1.0 };
                matrix[(i, j)] = sign * norm * self.rate;
            }
        }
        matrix
    }
}

fn rows<const R: usize, const C: usize>(matrix: &SMatrix<f64, R, C>) -> [[f64; C]; R] {
    std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]))
}

/// The value (`None`) or the derivative in one direction (`Some`).
fn part<const R: usize, const C: usize, const P: usize>(
    jet: &Jet<R, C, P>,
    direction: Option<usize>,
) -> SMatrix<f64, R, C> {
    match direction {
        None => jet.value,
        Some(direction) => jet.by.get(direction).copied().unwrap_or_else(SMatrix::zeros),
    }
}

/// Corners of the delayed hold inside one sample interval, as (u, u') at the start of its two parts from `rho`.
fn hold_corners<const P: usize>(delay: &Delay<P>, dt: f64, hold: Hold) -> [Jet<2, 3, P>; 2] {
    let f = delay.fraction;
    match hold {
        Hold::Zero => [
            Jet::constant(SMatrix::<f64, 2, 3>::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
            Jet::constant(SMatrix::<f64, 2, 3>::new(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)),
        ],
        Hold::First => {
            let slope = 1.0 / dt;
            let early = SMatrix::<f64, 2, 3>::new(f, 1.0 - f, 0.0, -slope, slope, 0.0);
            let by = delay.by.map(|by| SMatrix::<f64, 2, 3>::new(by, -by, 0.0, 0.0, 0.0, 0.0));
            let late = SMatrix::<f64, 2, 3>::new(0.0, 1.0, 0.0, 0.0, -slope, slope);
            [Jet { value: early, by }, Jet::constant(late)]
        }
    }
}

/// Discretise with derivatives in `P` directions; `A` is `N + 2`.
fn discretise<const N: usize, const A: usize, const J: usize, const P: usize>(
    parameters: &Parameters,
    dt: f64,
    hold: Hold,
    initial: [f64; 2],
    directions: &[usize],
    segment: usize,
) -> Model<N, J> {
    let [a, b, c] = rates(parameters);
    let rate = if N == DIRECT { 1.0 } else { 1.0 / parameters.t_d.max(SHORTEST_NETWORK * dt) };
    let zero = Entries { one: 0.0, a: 0.0, b: 0.0, c: 0.0, rate: 0.0 };
    let entries = Entries { one: 1.0, a, b: b * rate, c: c * rate, rate };
    let entries_by = |direction| match direction {
        BY_A => Entries { a: 1.0, ..zero },
        BY_B => Entries { b: rate, ..zero },
        BY_C => Entries { c: rate, ..zero },
        BY_T_D if N == DELAYED => {
            Entries { b: -b * rate * rate, c: -c * rate * rate, rate: -rate * rate, ..zero }
        }
        _ => zero,
    };
    let dynamics: Jet<N, N, P> =
        Jet { value: entries.matrix(), by: std::array::from_fn(|i| entries_by(i).matrix()) };

    let delays: [Delay<P>; J] = std::array::from_fn(|j| {
        if j == 0 {
            Delay::new(parameters.t_set, dt, &[BY_T_SET])
        } else {
            Delay::new(parameters.t_set + parameters.t_d, dt, &[BY_T_SET, BY_T_D])
        }
    });
    // Input 0 drives E (and n, where no dead time stands between), input 1 drives n.
    let gain = |j: usize| -> [f64; 2] { [if j + 1 == J { b } else { 0.0 }, if j == 0 { 1.0 } else { 0.0 }] };
    let gain_by_b = |j: usize| -> f64 { if j + 1 == J { 1.0 } else { 0.0 } };

    let mut phi = dynamics;
    let taps: [Jet<N, 3, P>; J] = std::array::from_fn(|j| {
        let delay = &delays[j];
        let mut augmented = dynamics.map(|matrix| matrix.fixed_resize::<A, A>(0.0));
        let [to_n, to_e] = gain(j);
        augmented.value[(0, N)] = to_n;
        augmented.value[(1, N)] = to_e;
        augmented.value[(N, N + 1)] = 1.0;
        if let Some(by_b) = augmented.by.get_mut(BY_B) {
            by_b[(0, N)] = gain_by_b(j);
        }
        let [early, late] = [
            augmented.scale(delay.fraction * dt, delay.by.map(|by| by * dt)).exp(),
            augmented.scale((1.0 - delay.fraction) * dt, delay.minus_by().map(|by| by * dt)).exp(),
        ];
        let over = |part: &Jet<A, A, P>| part.map(|matrix| matrix.fixed_view::<N, N>(0, 0).into_owned());
        let from_input =
            |part: &Jet<A, A, P>| part.map(|matrix| matrix.fixed_view::<N, 2>(0, N).into_owned());
        let [early_corner, late_corner] = hold_corners(delay, dt, hold);
        let early_taps = over(&late).mul(&from_input(&early).mul(&early_corner));
        let late_taps = from_input(&late).mul(&late_corner);
        phi = over(&late).mul(&over(&early));
        early_taps.add(&late_taps)
    });

    // The set point as it stands at the sample itself: the right-hand limit at a step.
    let feeds: [Jet<1, 3, P>; J] = std::array::from_fn(|j| {
        if hold == Hold::Zero && delays[j].fraction == 0.0 {
            Jet::constant(SMatrix::<f64, 1, 3>::new(0.0, 1.0, 0.0))
        } else {
            hold_corners(&delays[j], dt, hold)[0].map(|corner| corner.fixed_rows::<1>(0).into_owned())
        }
    });
    let b_by: [f64; P] = std::array::from_fn(|i| if i == BY_B { 1.0 } else { 0.0 });
    let slope_feed: [Jet<1, 3, P>; J] = std::array::from_fn(|j| {
        if j + 1 == J { feeds[j].scale(b, b_by) } else { Jet::constant(SMatrix::zeros()) }
    });

    let [n, e] = initial;
    let start = |direction| {
        let (n, e, z) = match direction {
            None => (n, e, c * e - b * n),
            Some(BY_B) => (0.0, 0.0, -n),
            Some(BY_C) => (0.0, 0.0, e),
            Some(BY_START_N) => (1.0, 0.0, -b),
            Some(BY_START_E) => (0.0, 1.0, c),
            Some(_) => (0.0, 0.0, 0.0),
        };
        // z stood still before the record: only the network's constant part is filled.
        std::array::from_fn(|i| [n, e, z].get(i).copied().unwrap_or(0.0))
    };
    let step = |direction: Option<usize>| Step {
        phi: rows(&part(&phi, direction)),
        taps: std::array::from_fn(|i| std::array::from_fn(|j| rows(&part(&taps[j], direction))[i])),
        slope: rows(&part(&dynamics, direction))[0],
        slope_feed: std::array::from_fn(|j| rows(&part(&slope_feed[j], direction))[0]),
        set_feed: rows(&part(&feeds[0], direction))[0],
        start: start(direction),
    };
    let across = phi.power(segment);
    Model {
        step: step(None),
        by: directions.iter().map(|&direction| step(Some(direction))).collect(),
        late: std::array::from_fn(|j| delays[j].whole),
        across: rows(&across.value),
        across_by: directions.iter().map(|&direction| rows(&part(&across, Some(direction)))).collect(),
    }
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
    if directions.is_empty() {
        discretise::<DIRECT, 4, 1, 0>(parameters, dt, hold, initial, directions, segment)
    } else {
        discretise::<DIRECT, 4, 1, STEP_DIRECTIONS>(parameters, dt, hold, initial, directions, segment)
    }
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
    if directions.is_empty() {
        discretise::<DELAYED, 10, 2, 0>(parameters, dt, hold, initial, directions, segment)
    } else {
        discretise::<DELAYED, 10, 2, STEP_DIRECTIONS>(parameters, dt, hold, initial, directions, segment)
    }
}
