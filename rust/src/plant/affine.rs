//! Quantities that are affine in the set point and the states.

use std::ops::{Add, Mul, Sub};

use super::{State, times_plus};

/// `constant` + `set_speed` `n_set` + `speed` `n_e` + `error` `E_n`.
///
/// Governor and engine are affine up to the torque limit. They are composed into one such form before a simulation,
/// so that its loop pays for one dot product instead of a chain of components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    constant: f64,
    set_speed: f64,
    speed: f64,
    error: f64,
}

impl Affine {
    const ZERO: Self = Self { constant: 0.0, set_speed: 0.0, speed: 0.0, error: 0.0 };
    /// The set point of the engine speed.
    pub const SET_SPEED: Self = Self { set_speed: 1.0, ..Self::ZERO };
    /// The engine speed.
    pub const SPEED: Self = Self { speed: 1.0, ..Self::ZERO };
    /// The integrated speed error.
    pub const ERROR: Self = Self { error: 1.0, ..Self::ZERO };

    /// The value at a set point and state.
    // What waits for the speed of the stage before comes last: it is the critical path of a step.
    #[inline(always)]
    #[must_use]
    pub fn at<const FUSED: bool>(&self, set_speed: f64, state: State) -> f64 {
        let constant = times_plus::<FUSED>(self.set_speed, set_speed, self.constant);
        let constant = times_plus::<FUSED>(self.error, state.error, constant);
        times_plus::<FUSED>(self.speed, state.speed, constant)
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
