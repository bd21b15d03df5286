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

    let mut leap_phi = Jet::constant(SMatrix::identity());
    let mut leap_taps = [Jet::constant(SMatrix::<f64, N, { LEAP + 2 }>::zeros()); J];
    for sample in 0..LEAP {
        leap_phi = phi.mul(&leap_phi);
        for (leap_taps, taps) in leap_taps.iter_mut().zip(&taps) {
            let shifted = taps.map(|taps| {
                let mut shifted = SMatrix::<f64, N, { LEAP + 2 }>::zeros();
                shifted.fixed_view_mut::<N, 3>(0, sample).copy_from(taps);
                shifted
            });
            *leap_taps = phi.mul(leap_taps).add(&shifted);
        }
    }

    let step = |direction: Option<usize>| Step {
        phi: rows(&part(&phi, direction)),
        taps: taps_by_state(&taps, direction),
        slope: rows(&part(&dynamics, direction))[0],
        slope_feed: std::array::from_fn(|j| rows(&part(&slope_feed[j], direction))[0]),
        set_feed: rows(&part(&feeds[0], direction))[0],
        moves_phi: moves_phi(direction),
    };
    let leap = |direction: Option<usize>| Step {
        phi: rows(&part(&leap_phi, direction)),
        taps: taps_by_state(&leap_taps, direction),
        slope: [0.0; N],
        slope_feed: [[0.0; LEAP + 2]; J],
        set_feed: [0.0; LEAP + 2],
        moves_phi: moves_phi(direction),
    };
    let start = |direction| start(direction, initial, b, c);
    let across = phi.power(segment);
    let each = directions.iter().map(|&direction| Some(direction));
    Model {
        stepper: Stepper { step: step(None), by: each.clone().map(step).collect() },
        leaper: Stepper { step: leap(None), by: each.clone().map(leap).collect() },
        start: start(None),
        start_by: each.clone().map(start).collect(),
        late: std::array::from_fn(|j| delays[j].whole),
        across: rows(&across.value),
        across_by: each.map(|direction| rows(&part(&across, direction))).collect(),
    }
}

/// Whether the loop's own matrix depends on that direction.
const fn moves_phi(direction: Option<usize>) -> bool {
    !matches!(direction, Some(BY_T_SET | BY_START_N | BY_START_E))
}

fn taps_by_state<const N: usize, const J: usize, const T: usize, const P: usize>(
    taps: &[Jet<N, T, P>; J],
    direction: Option<usize>,
) -> [[[f64; T]; J]; N] {
    let by_input: [[[f64; T]; N]; J] = std::array::from_fn(|j| rows(&part(&taps[j], direction)));
    std::array::from_fn(|i| std::array::from_fn(|j| by_input[j][i]))
}

/// The state at the first sample, or its derivative. z stood still before the record: only the network's constant part is filled.
fn start<const N: usize>(direction: Option<usize>, [n, e]: [f64; 2], b: f64, c: f64) -> [f64; N] {
    let (n, e, z) = match direction {
        None => (n, e, c * e - b * n),
        Some(BY_B) => (0.0, 0.0, -n),
        Some(BY_C) => (0.0, 0.0, e),
        Some(BY_START_N) => (1.0, 0.0, -b),
        Some(BY_START_E) => (0.0, 1.0, c),
        Some(_) => (0.0, 0.0, 0.0),
    };
    std::array::from_fn(|i| [n, e, z].get(i).copied().unwrap_or(0.0))
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

#[cfg(test)]
mod tests {
    use nalgebra::{Complex, DMatrix, DVector};

    use super::*;

    const LAUNCH: [f64; 9] = [1.5, -0.583, 1.583, 4.0, 1.0, 2.0, 1.0, 0.12, 0.033];

    fn parameters(vector: &[f64; 9]) -> Parameters {
        Parameters::new(vector, "parameters").expect("valid parameters")
    }

    /// The network alone, from z to y, at `omega T_d`: rows and columns 2 on of the matrix with `T_d` = 1 s.
    fn network(omega: f64) -> Complex<f64> {
        let matrix = Entries { one: 1.0, a: 0.0, b: 0.0, c: 1.0, rate: 1.0 }.matrix::<DELAYED>();
        let order = DELAYED - 2;
        let system = DMatrix::from_fn(order, order, |i, j| {
            let diagonal = if i == j { Complex::new(0.0, omega) } else { Complex::ZERO };
            diagonal - Complex::from(matrix[(i + 2, j + 2)])
        });
        let from_z = DVector::from_fn(order, |i, _| Complex::from(matrix[(i + 2, 1)]));
        let states = system.lu().solve(&from_z).expect("the network has no pole on the axis");
        (0..order).map(|i| states[i] * matrix[(0, i + 2)]).sum()
    }

    #[test]
    fn the_network_delays() {
        for (omega, tolerance) in [(0.0, 1e-14), (0.3, 1e-14), (1.0, 1e-11), (3.0, 2.4e-6), (6.0, 4.5e-3)] {
            let error = (network(omega) - Complex::new(0.0, -omega).exp()).norm();
            assert!(error <= tolerance, "error {error} at omega T_d = {omega}");
        }
    }

    #[test]
    fn a_leap_is_as_many_steps() {
        let model =
            delayed(&parameters(&LAUNCH), 0.05, Hold::First, [0.1, -0.2], &[BY_A, BY_T_D, BY_T_SET], 11);
        let samples: [f64; LEAP + 2] = std::array::from_fn(|k| (k as f64).sin());
        let apply = |phi: &[[f64; DELAYED]; DELAYED], x: &[f64; DELAYED]| -> [f64; DELAYED] {
            phi.map(|row| row.iter().zip(x).map(|(factor, x)| factor * x).sum())
        };
        let fed = |taps: &[&[f64]; 2], at: usize| -> f64 {
            taps.iter()
                .flat_map(|taps| taps.iter().zip(&samples[at..]))
                .map(|(tap, sample)| tap * sample)
                .sum()
        };
        let (mut x, mut by) = (model.start, model.start_by.clone());
        for k in 0..LEAP {
            for (s, step) in by.iter_mut().zip(&model.stepper.by) {
                let (from_s, from_x) = (apply(&model.stepper.step.phi, s), apply(&step.phi, &x));
                *s = std::array::from_fn(|i| {
                    from_s[i] + from_x[i] + fed(&std::array::from_fn(|j| &step.taps[i][j][..]), k)
                });
            }
            let from_x = apply(&model.stepper.step.phi, &x);
            let taps = &model.stepper.step.taps;
            x = std::array::from_fn(|i| from_x[i] + fed(&std::array::from_fn(|j| &taps[i][j][..]), k));
        }
        let leap = apply(&model.leaper.step.phi, &model.start);
        for i in 0..DELAYED {
            let taps = &model.leaper.step.taps;
            let found = leap[i] + fed(&std::array::from_fn(|j| &taps[i][j][..]), 0);
            assert!((found - x[i]).abs() < 1e-12, "state {i}");
        }
        for ((step, start), expected) in model.leaper.by.iter().zip(&model.start_by).zip(&by) {
            let (from_s, from_x) = (apply(&model.leaper.step.phi, start), apply(&step.phi, &model.start));
            for i in 0..DELAYED {
                let found = from_s[i] + from_x[i] + fed(&std::array::from_fn(|j| &step.taps[i][j][..]), 0);
                assert!((found - expected[i]).abs() < 1e-11 * (1.0 + expected[i].abs()), "state {i}");
            }
        }
    }

    /// Constant set point: what comes in over a step must not depend on where the hold has its corner.
    #[test]
    fn taps_sum_to_the_response_to_a_constant() {
        let mut vector = LAUNCH;
        let mut sums = Vec::new();
        for t_set in [0.0, 0.012, 0.049, 0.05, 0.07] {
            vector[8] = t_set;
            for hold in [Hold::Zero, Hold::First] {
                let model = delayed(&parameters(&vector), 0.05, hold, [0.0; 2], &[], 1);
                sums.push(model.stepper.step.taps.map(|inputs| inputs.as_flattened().iter().sum::<f64>()));
            }
        }
        for sum in &sums {
            for (one, first) in sum.iter().zip(&sums[0]) {
                assert!((one - first).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn a_whole_number_of_samples_stays_whole_in_spite_of_rounding() {
        for (time, dt, whole) in [(0.3, 0.01, 30), (0.7, 0.1, 7), (0.0, 0.1, 0), (1e-12, 0.1, 0)] {
            let delay = Delay::<0>::new(time, dt, &[]);
            assert_eq!((delay.whole, delay.fraction), (whole, 0.0));
        }
        let late = Delay::<0>::new(0.37, 0.1, &[]);
        assert_eq!(late.whole, 3);
        assert!((late.fraction - 0.7).abs() < 1e-12);
    }
}
