//! Numbers with their derivatives by all parameters (automatic differentiation).

use std::ops::{Add, Mul, Sub};

use super::equations::COUNT;

/// A value and its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Dual {
    /// The number itself.
    pub value: f64,
    /// Its derivatives.
    pub slopes: [f64; COUNT],
}

impl Dual {
    /// A constant.
    pub const fn new(value: f64) -> Self {
        Self { value, slopes: [0.0; COUNT] }
    }

    /// The parameter of an index, with derivative 1 by itself.
    pub fn parameter(values: &[f64; COUNT], index: usize) -> Self {
        let mut found = Self::new(values[index]);
        found.slopes[index] = 1.0;
        found
    }

    /// Reciprocal.
    pub fn inverse(self) -> Self {
        let value = 1.0 / self.value;
        Self { value, slopes: self.slopes.map(|slope| -slope * value * value) }
    }

    /// Exponential.
    pub fn exponential(self) -> Self {
        let value = self.value.exp();
        Self { value, slopes: self.slopes.map(|slope| slope * value) }
    }

    /// A number of the given value; its derivatives are `own` times those of `self` plus `others` times those of `other`.
    fn combined(mut self, own: f64, other: &Self, others: f64, value: f64) -> Self {
        for (mine, theirs) in self.slopes.iter_mut().zip(&other.slopes) {
            *mine = *mine * own + theirs * others;
        }
        Self { value, ..self }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.combined(1.0, &other, 1.0, self.value + other.value)
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.combined(1.0, &other, -1.0, self.value - other.value)
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.combined(other.value, &other, self.value, self.value * other.value)
    }
}

impl Add<f64> for Dual {
    type Output = Self;
    fn add(self, other: f64) -> Self {
        Self { value: self.value + other, ..self }
    }
}

impl Mul<f64> for Dual {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self { value: self.value * factor, slopes: self.slopes.map(|slope| slope * factor) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Every operation at once.
    fn formula<T>(x: T, y: T) -> T
    where
        T: Copy
            + Add<Output = T>
            + Sub<Output = T>
            + Mul<Output = T>
            + Add<f64, Output = T>
            + Mul<f64, Output = T>,
    {
        (x * y + x * 3.0 - y) * (y + 1.0) * x
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_a_fine_difference(x in 1.0..3.0_f64, y in 1.2..2.5_f64) {
            let mut values = [0.0; COUNT];
            (values[1], values[6]) = (x, y);
            let found = formula(Dual::parameter(&values, 1), Dual::parameter(&values, 6));
            let h = 1e-5;
            let by_x = (formula(x + h, y) - formula(x - h, y)) / (2.0 * h);
            let by_y = (formula(x, y + h) - formula(x, y - h)) / (2.0 * h);
            let size = found.value.abs() + by_x.abs() + by_y.abs();
            prop_assert!((found.value - formula(x, y)).abs() < 1e-12 * size);
            prop_assert!((found.slopes[1] - by_x).abs() < 1e-6 * size && (found.slopes[6] - by_y).abs() < 1e-6 * size);
        }
    }
}
