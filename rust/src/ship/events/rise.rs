//! The speed of a rigid shaft under constant fuel, as a series in time with its derivatives by what it starts from.
//!
//! With `d = N - N_0` the rate is `phi_0 + phi_1 d + phi_2 d^2 + phi_3 d^3`, and the terms of `d(t) = c_1 t + c_2 t^2 + ...` follow one
//! after the other. Each is differentiated by the speed and the fuel at the start and by the shaft's parameters, in lanes; from
//! these the derivatives in any number of directions are one sum of products a value.

use pulp::Simd;

use crate::scalar::{Dual, Scalar, Tangent};

use super::terms::Terms;

/// Lanes of what a series starts from: the speed, the fuel, then `tau_n`, `g`, `p` and the damping.
const LANES: usize = 8;
/// Terms of a series.
const TERMS: usize = 5;
/// A series holds for this share of the shaft's time constant: its last term is then below 1e-9 of the change.
const SHARE: f64 = 0.1;
/// Largest change of the speed over the speed.
const CHANGE: f64 = 0.03;
/// Slower shafts have no series: their power law bends too much.
const SLOWEST: f64 = 0.05;

/// What all series of a ship share.
pub struct Shaft<S, const N: usize> {
    pub terms: Terms<Dual<S, N>>,
    per_inertia: Dual<S, LANES>,
    /// `g` less the damping.
    slope: Dual<S, LANES>,
    /// The exponent, and it over 2 and over 3: `p (p - 1) / 2`, `p (p - 1) (p - 2) / 6`.
    exponent: [Dual<S, LANES>; 3],
    like: Dual<S, LANES>,
    /// Shorter series are not worth it [s].
    least: f64,
}

impl<S: Simd, const N: usize> Shaft<S, N> {
    #[inline(always)]
    pub fn new(simd: S, terms: Terms<Dual<S, N>>, least: f64) -> Self {
        let lane = |value: f64, lane: usize| {
            let slopes = std::array::from_fn(|place| f64::from(u8::from(place == lane)));
            Dual::new(simd, Tangent { value, slopes })
        };
        let like = lane(0.0, LANES);
        let p = lane(terms.p.value(), 4);
        let second = p * (p + -1.0) * 0.5;
        Self {
            per_inertia: like.constant(1.0) / lane(terms.tau_n.value(), 2),
            slope: lane(terms.g.value(), 3) - lane(terms.damping.value(), 5),
            exponent: [p, second, second * (p + -2.0) * (1.0 / 3.0)],
            like,
            least,
            terms,
        }
    }
}

/// The speed from a time on.
pub struct Rise<S, const N: usize> {
    begin: Dual<S, N>,
    speed: Dual<S, N>,
    pub fuel: Dual<S, N>,
    terms: [Dual<S, LANES>; TERMS],
    /// When it ends.
    pub end: f64,
}

impl<S: Simd, const N: usize> Rise<S, N> {
    /// From a time, a speed and a fuel on; None where a series does not hold for long.
    #[inline(always)]
    pub fn new(shaft: &Shaft<S, N>, begin: Dual<S, N>, speed: Dual<S, N>, fuel: Dual<S, N>) -> Option<Self> {
        if !(speed.value() > SLOWEST && speed.value() < 1.0 / SLOWEST) {
            return None;
        }
        let Shaft { per_inertia, slope, exponent, like, .. } = shaft;
        let lane = |value: f64, lane: usize| like.along(value, lane);
        let (n, f) = (lane(speed.value(), 0), lane(fuel.value(), 1));
        let power = n.power(exponent[0]);
        let inverse = like.constant(1.0) / n;
        let first = power * inverse;
        let phi_0 = (*slope * (n + -1.0) + f - power + 1.0) * *per_inertia;
        let phi_1 = (*slope - exponent[0] * first) * *per_inertia;
        let third = first * inverse * *per_inertia * -1.0;
        let (phi_2, phi_3) = (exponent[1] * third, exponent[2] * third * inverse);
        let c1 = phi_0;
        let c2 = phi_1 * c1 * 0.5;
        let c11 = c1 * c1;
        let c3 = (phi_1 * c2 + phi_2 * c11) * (1.0 / 3.0);
        let c12 = c1 * c2;
        let c4 = (phi_1 * c3 + phi_2 * c12 * 2.0 + phi_3 * c11 * c1) * 0.25;
        let c5 = (phi_1 * c4 + phi_2 * (c1 * c3 * 2.0 + c2 * c2) + phi_3 * c1 * c12 * 3.0) * 0.2;
        let length = (SHARE / phi_1.value().abs()).min(CHANGE * speed.value() / c1.value().abs());
        let end = begin.value() + length;
        (length > shaft.least && end > begin.value()).then_some(Self {
            begin,
            speed,
            fuel,
            terms: [c1, c2, c3, c4, c5],
            end,
        })
    }

    /// A sum over the local lanes, as a number with the directions' derivatives.
    #[inline(always)]
    fn gathered(&self, shaft: &Shaft<S, N>, value: f64, by: Dual<S, LANES>, after: Dual<S, N>) -> Dual<S, N> {
        let [speed, fuel, tau, g, p, damping, ..] = by.tangent().slopes;
        let t = &shaft.terms;
        let own = self.speed.function(value, speed) + self.fuel.function(0.0, fuel);
        let shafts = t.tau_n.function(0.0, tau) + t.g.function(0.0, g);
        let others = t.p.function(0.0, p) + t.damping.function(0.0, damping);
        (own + shafts) + (others + after)
    }

    /// The speed at a time.
    #[inline(always)]
    pub fn at(&self, shaft: &Shaft<S, N>, time: Dual<S, N>) -> Dual<S, N> {
        let elapsed = time - self.begin;
        let t = elapsed.value();
        let [c1, c2, c3, c4, c5] = self.terms;
        let change = ((((c5 * t + c4) * t + c3) * t + c2) * t + c1) * t;
        let rate = (((5.0 * t * c5.value + 4.0 * c4.value) * t + 3.0 * c3.value) * t + 2.0 * c2.value) * t
            + c1.value;
        let by = change + shaft.like.along(0.0, 0);
        self.gathered(shaft, self.speed.value() + change.value, by, elapsed.function(0.0, rate))
    }

    /// The rate of the speed at a time.
    #[inline(always)]
    pub fn rate_at(&self, shaft: &Shaft<S, N>, time: Dual<S, N>) -> Dual<S, N> {
        let elapsed = time - self.begin;
        let t = elapsed.value();
        let [c1, c2, c3, c4, c5] = self.terms;
        let rate = (((c5 * (5.0 * t) + c4 * 4.0) * t + c3 * 3.0) * t + c2 * 2.0) * t + c1;
        let bend = ((20.0 * t * c5.value + 12.0 * c4.value) * t + 6.0 * c3.value) * t + 2.0 * c2.value;
        self.gathered(shaft, rate.value, rate, elapsed.function(0.0, bend))
    }
}
