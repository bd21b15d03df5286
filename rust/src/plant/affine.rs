//! Quantities that are affine in the set point and the states.

use std::ops::{Add, Mul, Sub};

use super::State;

/// constant + `set_speed` `n_set` + `shaft_speed` `n_s` + `integrated_error` `E_n`.
///
/// Governor, gearbox and engine are affine up to the torque limit. They are composed into one such form when a plant
/// is built, so that the hot loop pays for one dot product instead of a chain of components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    constant: f64,
    set_speed: f64,
    shaft_speed: f64,
    integrated_error: f64,
}

impl Affine {
    const ZERO: Self = Self { constant: 0.0, set_speed: 0.0, shaft_speed: 0.0, integrated_error: 0.0 };
    /// The set point of the engine speed.
    pub const SET_SPEED: Self = Self { set_speed: 1.0, ..Self::ZERO };
    /// The shaft speed.
    pub const SHAFT_SPEED: Self = Self { shaft_speed: 1.0, ..Self::ZERO };
    /// The integrated speed error.
    pub const INTEGRATED_ERROR: Self = Self { integrated_error: 1.0, ..Self::ZERO };

    /// The value at a set point and state.
    // The part that waits for the speed of the stage before comes last: it is the critical path of a step.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, set_speed: f64, state: State) -> f64 {
        (self.constant + self.set_speed * set_speed + self.integrated_error * state.error)
            + self.shaft_speed * state.speed
    }
}

impl Add for Affine {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            constant: self.constant + other.constant,
            set_speed: self.set_speed + other.set_speed,
            shaft_speed: self.shaft_speed + other.shaft_speed,
            integrated_error: self.integrated_error + other.integrated_error,
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
            shaft_speed: self.shaft_speed * factor,
            integrated_error: self.integrated_error * factor,
        }
    }
}
