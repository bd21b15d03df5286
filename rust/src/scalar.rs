//! Numbers that equations are written in once: plain ones, and ones that carry derivatives along.

use std::ops::{Add, Div, Mul, Sub};

use crate::plant::{Library, Power, Square, power_and_slopes};

/// What the equations of a component ask of a number.
pub trait Scalar:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// A number that depends on nothing.
    fn constant(value: f64) -> Self;

    /// The number without what it carries; comparisons are by it.
    fn value(self) -> f64;

    /// `self` |`self`|^(`exponent` - 1).
    #[must_use]
    fn power(self, exponent: Self) -> Self;
}

impl Scalar for f64 {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self
    }

    #[inline(always)]
    fn power(self, exponent: f64) -> f64 {
        Library::of(self, exponent)
    }
}

/// A value and its derivatives in `N` directions.
///
/// Forward differentiation: every operation carries the derivatives along, so that they are those of the computation as
/// it is done, step by step. The value stands apart: its chain of operations is what a recursion waits for, and the
/// derivatives, side by side in vectors, are computed in its shade. (`linear::number` keeps the value in a lane instead,
/// which suits matrix products.)
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual<const N: usize> {
    /// The number itself.
    pub value: f64,
    /// Its derivatives.
    pub slopes: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// The same derivatives times `own`, plus the other's times `others`, about a value.
    #[inline(always)]
    fn combined(mut self, own: f64, other: &Self, others: f64, value: f64) -> Self {
        for i in 0..N {
            self.slopes[i] = self.slopes[i] * own + other.slopes[i] * others;
        }
        Self { value, ..self }
    }

    #[inline(always)]
    fn scaled(mut self, factor: f64, value: f64) -> Self {
        for slope in &mut self.slopes {
            *slope *= factor;
        }
        Self { value, ..self }
    }
}

impl<const N: usize> Scalar for Dual<N> {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self { value, slopes: [0.0; N] }
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self.value
    }

    #[inline(always)]
    fn power(self, exponent: Self) -> Self {
        // Mostly 2 and known: a branch that is always foreseen, and no power function.
        if exponent == Self::constant(2.0) {
            return self.scaled(2.0 * self.value.abs(), Square::of(self.value, 2.0));
        }
        let [value, by_base, by_exponent] = power_and_slopes(self.value, exponent.value);
        self.combined(by_base, &exponent, by_exponent, value)
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for i in 0..N {
            self.slopes[i] += other.slopes[i];
        }
        Self { value: self.value + other.value, ..self }
    }
}

impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        for i in 0..N {
            self.slopes[i] -= other.slopes[i];
        }
        Self { value: self.value - other.value, ..self }
    }
}

impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.combined(other.value, &other, self.value, self.value * other.value)
    }
}

impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, inverse) = (self.value / other.value, 1.0 / other.value);
        self.combined(inverse, &other, -value * inverse, value)
    }
}

impl<const N: usize> Add<f64> for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f64) -> Self {
        Self { value: self.value + other, ..self }
    }
}

impl<const N: usize> Mul<f64> for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self.scaled(factor, self.value * factor)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Every operation at once, smooth for positive numbers.
    fn formula<T: Scalar>(x: T, y: T) -> T {
        (x * y + x / y - y * 3.0 + 2.0).power(y) - x.power(T::constant(2.17)) / y
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_a_fine_difference(x in 1.0..3.0_f64, y in 1.2..2.5_f64) {
            let dual = formula(Dual { value: x, slopes: [1.0, 0.0] }, Dual { value: y, slopes: [0.0, 1.0] });
            let h = 1e-5;
            let by_x = (formula(x + h, y) - formula(x - h, y)) / (2.0 * h);
            let by_y = (formula(x, y + h) - formula(x, y - h)) / (2.0 * h);
            let size = dual.value.abs() + by_x.abs() + by_y.abs();
            prop_assert!((dual.value - formula(x, y)).abs() < 1e-12 * size);
            prop_assert!((dual.slopes[0] - by_x).abs() < 1e-6 * size && (dual.slopes[1] - by_y).abs() < 1e-6 * size);
        }
    }
}
