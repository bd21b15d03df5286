//! Numbers that carry their derivatives in every direction, matrices of them, and the matrix exponential.

use std::array::from_fn;
use std::ops::{Add, Mul, Neg, Sub};

use pulp::{Simd, WithSimd};

use crate::instruction_set::arch;

/// Directions of differentiation; `discrete` says what they are.
pub const DIRECTIONS: usize = 7;

const PARTS: usize = 1 + DIRECTIONS;

/// A value and its derivatives, together as wide as a vector register.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number([f64; PARTS]);

impl Number {
    pub const ZERO: Self = Self::constant(0.0);
    pub const ONE: Self = Self::constant(1.0);

    pub const fn constant(value: f64) -> Self {
        let mut parts = [0.0; PARTS];
        parts[0] = value;
        Self(parts)
    }

    /// The quantity that a direction is named after.
    pub const fn variable(value: f64, direction: usize) -> Self {
        let mut number = Self::constant(value);
        number.0[1 + direction] = 1.0;
        number
    }

    pub const fn value(&self) -> f64 {
        self.0[0]
    }

    /// The value (`None`) or the derivative in one direction (`Some`).
    pub fn part(&self, direction: Option<usize>) -> f64 {
        self.0[direction.map_or(0, |direction| 1 + direction)]
    }

    /// The same derivatives with another value.
    pub const fn with_value(mut self, value: f64) -> Self {
        self.0[0] = value;
        self
    }

    /// One divided by the number.
    pub fn inverse(self) -> Self {
        let value = 1.0 / self.value();
        (self * (-value * value)).with_value(value)
    }
}

impl Add for Number {
    type Output = Self;
    #[inline]
    fn add(mut self, other: Self) -> Self {
        for i in 0..PARTS {
            self.0[i] += other.0[i];
        }
        self
    }
}

impl Sub for Number {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Neg for Number {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        self * -1.0
    }
}

impl Mul<f64> for Number {
    type Output = Self;
    #[inline]
    fn mul(mut self, factor: f64) -> Self {
        for i in 0..PARTS {
            self.0[i] *= factor;
        }
        self
    }
}

impl Mul for Number {
    type Output = Self;
    #[inline]
    fn mul(self, other: Self) -> Self {
        (self * other.value() + other * self.value()).with_value(self.value() * other.value())
    }
}

/// A small matrix of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Matrix<const R: usize, const C: usize>(pub [[Number; C]; R]);

impl<const R: usize, const C: usize> Matrix<R, C> {
    pub const ZERO: Self = Self([[Number::ZERO; C]; R]);

    pub fn from_values(values: [[f64; C]; R]) -> Self {
        Self(values.map(|row| row.map(Number::constant)))
    }

    /// The values (`None`) or the derivatives in one direction (`Some`).
    pub fn part(&self, direction: Option<usize>) -> [[f64; C]; R] {
        let mut part = [[0.0; C]; R];
        for (part, number) in part.as_flattened_mut().iter_mut().zip(self.0.as_flattened()) {
            *part = number.part(direction);
        }
        part
    }

    /// The block of `R2` rows and `C2` columns that begins at a row and a column.
    pub fn block<const R2: usize, const C2: usize>(&self, row: usize, column: usize) -> Matrix<R2, C2> {
        let mut block = Matrix::ZERO;
        for (to, from) in block.0.iter_mut().zip(&self.0[row..]) {
            to.copy_from_slice(&from[column..column + C2]);
        }
        block
    }

    /// Write over the block that begins at a row and a column.
    pub fn put<const R2: usize, const C2: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &Matrix<R2, C2>,
    ) {
        for (to, from) in self.0[row..].iter_mut().zip(&block.0) {
            to[column..column + C2].copy_from_slice(from);
        }
    }

    pub fn times(&self, factor: Number) -> Self {
        let mut result = *self;
        for number in result.0.as_flattened_mut() {
            *number = *number * factor;
        }
        result
    }

    /// Add multiples of other matrices.
    pub fn add<const K: usize>(&mut self, factors: &[f64], others: [&Self; K]) {
        for (&factor, other) in factors.iter().zip(others) {
            for (sum, number) in self.0.as_flattened_mut().iter_mut().zip(other.0.as_flattened()) {
                *sum = *sum + *number * factor;
            }
        }
    }

    pub fn product<const C2: usize>(&self, other: &Matrix<C, C2>) -> Matrix<R, C2> {
        let mut result = Matrix::ZERO;
        arch().dispatch(Product { one: self, other, result: &mut result });
        result
    }
}

impl<const N: usize> Matrix<N, N> {
    pub fn identity() -> Self {
        Self(from_fn(|i| from_fn(|j| if i == j { Number::ONE } else { Number::ZERO })))
    }

    /// Matrix exponential by a Taylor polynomial, scaling and squaring; its derivatives are the exact ones of that
    /// computation and so as good as it (Al-Mohy and Higham 2009, DOI 10.1137/080716426).
    pub fn exp(&self) -> Self {
        let norm = (0..N).map(|j| self.0.iter().map(|row| row[j].value().abs()).sum()).fold(0.0, f64::max);
        let mut result = Self::identity();
        if norm == 0.0 {
            result.add(&[1.0], [self]);
            return result;
        }
        // With a norm of at most 1/4 the first term left out, of degree 13, is below 3e-18.
        #[allow(clippy::cast_possible_truncation)] // clamped first
        let squarings = (4.0 * norm).log2().ceil().clamp(0.0, 100.0) as i32;
        let a = self.times(Number::constant(0.5_f64.powi(squarings)));
        let a2 = a.product(&a);
        let a3 = a2.product(&a);
        let a4 = a2.product(&a2);
        let mut factors = [1.0; 13];
        for k in 1..13 {
            factors[k] = factors[k - 1] / k as f64;
        }
        let mut sum = a4.times(Number::constant(factors[12]));
        for first in [8, 4] {
            sum.add(&factors[first..], [&result, &a, &a2, &a3]);
            sum = a4.product(&sum);
        }
        // exp - 1 is squared, not exp: slow modes beside fast ones would drown in the 1.
        sum.add(&factors[1..], [&a, &a2, &a3]);
        for _ in 0..squarings {
            let square = sum.product(&sum);
            sum.add(&[1.0, 1.0], [&sum.clone(), &square]);
        }
        result.add(&[1.0], [&sum]);
        result
    }

    /// Power by repeated squaring.
    pub fn power(&self, mut exponent: usize) -> Self {
        let (mut result, mut square) = (Self::identity(), *self);
        while exponent > 0 {
            if exponent & 1 == 1 {
                result = result.product(&square);
            }
            square = square.product(&square);
            exponent >>= 1;
        }
        result
    }
}

/// A matrix product, its parts side by side in vectors.
struct Product<'a, const R: usize, const K: usize, const C: usize> {
    one: &'a Matrix<R, K>,
    other: &'a Matrix<K, C>,
    result: &'a mut Matrix<R, C>,
}

impl<const R: usize, const K: usize, const C: usize> WithSimd for Product<'_, R, K, C> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for i in 0..R {
            for j in 0..C {
                for part in 0..PARTS / S::F64_LANES {
                    let mut sum = simd.splat_f64s(0.0);
                    for k in 0..K {
                        let (one, other) = (&self.one.0[i][k].0, &self.other.0[k][j].0);
                        let (ones, others) = (S::as_simd_f64s(one).0[part], S::as_simd_f64s(other).0[part]);
                        sum = simd.mul_add_e_f64s(simd.splat_f64s(one[0]), others, sum);
                        sum = simd.mul_add_e_f64s(simd.splat_f64s(other[0]), ones, sum);
                    }
                    S::as_mut_simd_f64s(&mut self.result.0[i][j].0).0[part] = sum;
                }
                // The product rule has each derivative once and the value twice.
                self.result.0[i][j].0[0] *= 0.5;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;
    use proptest::prelude::*;

    use super::*;

    fn close<const N: usize>(found: &[[f64; N]; N], expected: &[[f64; N]; N], tolerance: f64) -> bool {
        found.as_flattened().iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() <= tolerance)
    }

    #[test]
    fn a_turn_is_a_rotation() {
        let angle = Number::variable(2.5, 3);
        let turn = Matrix([[Number::ZERO, -angle], [angle, Number::ZERO]]).exp();
        let (sine, cosine) = 2.5_f64.sin_cos();
        assert!(close(&turn.part(None), &[[cosine, -sine], [sine, cosine]], 1e-15));
        assert!(close(&turn.part(Some(3)), &[[-sine, -cosine], [cosine, -sine]], 2e-15));
        assert!(close(&turn.part(Some(4)), &[[0.0; 2]; 2], 0.0));
    }

    #[test]
    fn no_time_is_the_identity_and_its_derivative_the_rate() {
        let rate = Matrix::from_values([[1.0, 2.0], [3.0, 4.0]]);
        let none = rate.times(Number::variable(0.0, 2)).exp();
        assert!(close(&none.part(None), &[[1.0, 0.0], [0.0, 1.0]], 0.0));
        assert!(close(&none.part(Some(2)), &[[1.0, 2.0], [3.0, 4.0]], 0.0));
    }

    /// A decay of 1e9/s beside one of 1/s: squaring the exponential itself would leave seven digits of the slow one.
    #[test]
    fn a_slow_mode_keeps_its_digits_beside_a_fast_one() {
        let found = Matrix::from_values([[-1.0, 0.0], [1e9, -1e9]]).exp().part(None);
        let slow = (-1.0_f64).exp();
        assert!((found[0][0] / slow - 1.0).abs() < 1e-14);
        assert!((found[1][0] / (slow / (1.0 - 1e-9)) - 1.0).abs() < 1e-14);
    }

    #[test]
    fn an_inverse_follows_the_quotient_rule() {
        let inverse = Number::variable(4.0, 0).inverse();
        assert_eq!((inverse.value(), inverse.part(Some(0))), (0.25, -0.0625));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn agrees_with_the_block_exponential(
            entries in prop::array::uniform4(prop::array::uniform4(-3.0..3.0)),
            slopes in prop::array::uniform4(prop::array::uniform4(-1.0..1.0)),
        ) {
            let block = SMatrix::<f64, 8, 8>::from_fn(|i, j| match (i / 4, j / 4) {
                (0, 1) => slopes[i][j - 4],
                (1, 0) => 0.0,
                _ => entries[i % 4][j % 4],
            });
            let expected = block.exp();
            let matrix = Matrix(from_fn(|i| from_fn(|j| {
                Number::constant(entries[i][j]) + Number::variable(0.0, 5) * slopes[i][j]
            })));
            let found = matrix.exp();
            let tolerance = 1e-13 * expected.amax().max(1.0);
            let corner = |column: usize| from_fn(|i| from_fn(|j| expected[(i, column + j)]));
            prop_assert!(close::<4>(&found.part(None), &corner(0), tolerance));
            prop_assert!(close::<4>(&found.part(Some(5)), &corner(4), tolerance));
        }

        #[test]
        fn a_power_is_a_repeated_product(entries in prop::array::uniform4(-1.0..1.0), exponent in 0_usize..20) {
            let [a, b, c, d] = entries;
            let x = Number::variable(a, 0);
            let matrix = Matrix([[x, Number::constant(b)], [x * c, Number::constant(d)]]);
            let mut expected = Matrix::identity();
            for _ in 0..exponent {
                expected = expected.product(&matrix);
            }
            let found = matrix.power(exponent);
            prop_assert!(close(&found.part(None), &expected.part(None), 1e-10));
            prop_assert!(close(&found.part(Some(0)), &expected.part(Some(0)), 1e-8));
        }
    }
}
