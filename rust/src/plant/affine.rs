//! Quantities that are affine in the set point and the states.

use std::ops::{Add, Mul, Sub};

use super::{Number, State};

/// `constant` + `set_speed` `n_set` + `speed` `n_e` + `error` `E_n`.
///
/// Governor and engine are affine up to the torque limit. They are composed into one such form before a simulation,
/// so that its loop pays for one dot product instead of a chain of components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine<T = f64> {
    pub(super) constant: T,
    pub(super) set_speed: T,
    pub(super) speed: T,
    pub(super) error: T,
}

impl Affine {
    const ZERO: Self = Self { constant: 0.0, set_speed: 0.0, speed: 0.0, error: 0.0 };
    /// The set point of the engine speed.
    pub const SET_SPEED: Self = Self { set_speed: 1.0, ..Self::ZERO };
    /// The engine speed.
    pub const SPEED: Self = Self { speed: 1.0, ..Self::ZERO };
    /// The integrated speed error.
    pub const ERROR: Self = Self { error: 1.0, ..Self::ZERO };
}

impl<T: Number> Affine<T> {
    /// The value at a set point and state.
    // What waits for the speed of the stage before comes last: it is the critical path of a step.
    #[inline(always)]
    #[must_use]
    pub fn at<const FUSED: bool>(&self, set_speed: T, state: State<T>) -> T {
        let constant = self.set_speed.times_plus::<FUSED>(set_speed, self.constant);
        let constant = self.error.times_plus::<FUSED>(state.error, constant);
        self.speed.times_plus::<FUSED>(state.speed, constant)
    }
}

impl<const LANES: usize> Affine<[f64; LANES]> {
    /// Those of some lanes.
    #[inline(always)]
    pub(super) fn load<T: Number>(&self, place: T::Place) -> Affine<T> {
        Affine {
            constant: T::load(place, &self.constant),
            set_speed: T::load(place, &self.set_speed),
            speed: T::load(place, &self.speed),
            error: T::load(place, &self.error),
        }
    }
}

impl Add for Affine {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            constant: self.constant + other.constant,
            set_speed: self.set_speed + other.set_speed,
            speed: self.speed + other.speed,
            error: self.error + other.error,
        }
    }
}

impl Add<f64> for Affine {
    type Output = Self;
    fn add(self, constant: f64) -> Self {
        Self { constant: self.constant + constant, ..self }
    }
}

impl Sub for Affine {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + other * -1.0
    }
}

impl Mul<f64> for Affine {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self {
            constant: self.constant * factor,
            set_speed: self.set_speed * factor,
            speed: self.speed * factor,
            error: self.error * factor,
        }
    }
}
