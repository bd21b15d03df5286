//! Matrices that carry their derivatives, and their exponential.

use std::array::from_fn;

use nalgebra::SMatrix;

/// A matrix and its derivatives by `P` quantities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jet<const R: usize, const C: usize, const P: usize> {
    pub value: SMatrix<f64, R, C>,
    pub by: [SMatrix<f64, R, C>; P],
}

impl<const R: usize, const C: usize, const P: usize> Jet<R, C, P> {
    pub fn constant(value: SMatrix<f64, R, C>) -> Self {
        Self { value, by: [SMatrix::zeros(); P] }
    }

    /// Apply a linear map to the value and to every derivative.
    pub fn map<const R2: usize, const C2: usize>(
        &self,
        linear: impl Fn(&SMatrix<f64, R, C>) -> SMatrix<f64, R2, C2>,
    ) -> Jet<R2, C2, P> {
        Jet { value: linear(&self.value), by: from_fn(|i| linear(&self.by[i])) }
    }

    pub fn add(&self, other: &Self) -> Self {
        Self { value: self.value + other.value, by: from_fn(|i| self.by[i] + other.by[i]) }
    }

    pub fn mul<const C2: usize>(&self, other: &Jet<C, C2, P>) -> Jet<R, C2, P> {
        Jet {
            value: self.value * other.value,
            by: from_fn(|i| self.by[i] * other.value + self.value * other.by[i]),
        }
    }

    /// Multiply by a number that has derivatives of its own.
    pub fn scale(&self, factor: f64, factor_by: [f64; P]) -> Self {
        Self { value: self.value * factor, by: from_fn(|i| self.by[i] * factor + self.value * factor_by[i]) }
    }
}

impl<const N: usize, const P: usize> Jet<N, N, P> {
    /// Matrix exponential by a Taylor polynomial, scaling and squaring; its derivatives are the exact ones of that
    /// computation and so as good as it (Al-Mohy and Higham 2009, DOI 10.1137/080716426).
    pub fn exp(&self) -> Self {
        /// With a norm of at most 1/2 the first term left out is below 2e-17.
        const DEGREE: u32 = 14;
        let norm = self.value.column_iter().map(|column| column.lp_norm(1)).fold(0.0, f64::max);
        #[allow(clippy::cast_possible_truncation)] // clamped first
        let squarings = (2.0 * norm).log2().ceil().clamp(0.0, 100.0) as i32;
        let scaled = self.map(|matrix| matrix * 0.5_f64.powi(squarings));
        // exp - 1 is squared, not exp: slow modes beside fast ones would drown in the 1.
        let identity = Self::constant(SMatrix::identity());
        let mut series = identity;
        for term in (2..=DEGREE).rev() {
            series = identity.add(&scaled.mul(&series).map(|matrix| matrix / f64::from(term)));
        }
        let mut less_one = scaled.mul(&series);
        for _ in 0..squarings {
            less_one = less_one.mul(&less_one).add(&less_one).add(&less_one);
        }
        identity.add(&less_one)
    }

    /// Power by repeated squaring.
    pub fn power(&self, mut exponent: usize) -> Self {
        let (mut result, mut square) = (Self::constant(SMatrix::identity()), *self);
        while exponent > 0 {
            if exponent & 1 == 1 {
                result = result.mul(&square);
            }
            square = square.mul(&square);
            exponent >>= 1;
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix4};
    use proptest::prelude::*;

    use super::*;

    fn close<const N: usize>(
        found: &SMatrix<f64, N, N>,
        expected: &SMatrix<f64, N, N>,
        tolerance: f64,
    ) -> bool {
        (found - expected).amax() <= tolerance * expected.amax().max(1.0)
    }

    #[test]
    fn a_turn_is_a_rotation() {
        let jet = Jet::<2, 2, 1> {
            value: Matrix2::new(0.0, -2.5, 2.5, 0.0),
            by: [Matrix2::new(0.0, -1.0, 1.0, 0.0)], // by the angle
        }
        .exp();
        let (sine, cosine) = 2.5_f64.sin_cos();
        assert!(close(&jet.value, &Matrix2::new(cosine, -sine, sine, cosine), 1e-15));
        assert!(close(&jet.by[0], &Matrix2::new(-sine, -cosine, cosine, -sine), 1e-15));
    }

    /// A decay of 1e9/s beside one of 1/s: squaring the exponential itself would leave seven digits of the slow one.
    #[test]
    fn a_slow_mode_keeps_its_digits_beside_a_fast_one() {
        let jet = Jet::<2, 2, 0>::constant(Matrix2::new(-1.0, 0.0, 1e9, -1e9)).exp();
        let slow = (-1.0_f64).exp();
        assert!((jet.value[(0, 0)] / slow - 1.0).abs() < 1e-14);
        assert!((jet.value[(1, 0)] / (slow / (1.0 - 1e-9)) - 1.0).abs() < 1e-14);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn agrees_with_the_block_exponential(
            entries in prop::array::uniform16(-3.0..3.0),
            slopes in prop::array::uniform16(-1.0..1.0),
        ) {
            let (value, by) = (Matrix4::from_row_slice(&entries), Matrix4::from_row_slice(&slopes));
            let mut block = SMatrix::<f64, 8, 8>::zeros();
            block.fixed_view_mut::<4, 4>(0, 0).copy_from(&value);
            block.fixed_view_mut::<4, 4>(4, 4).copy_from(&value);
            block.fixed_view_mut::<4, 4>(0, 4).copy_from(&by);
            let expected = block.exp();
            let found = Jet::<4, 4, 1> { value, by: [by] }.exp();
            let tolerance = 1e-12 * expected.amax();
            prop_assert!(close(&found.value, &expected.fixed_view::<4, 4>(0, 0).into_owned(), tolerance));
            prop_assert!(close(&found.by[0], &expected.fixed_view::<4, 4>(0, 4).into_owned(), tolerance));
        }

        #[test]
        fn a_power_is_a_repeated_product(entries in prop::array::uniform4(-1.0..1.0), exponent in 0_usize..20) {
            let jet = Jet::<2, 2, 1> { value: Matrix2::from_row_slice(&entries), by: [Matrix2::new(1.0, 2.0, 3.0, 4.0)] };
            let mut expected = Jet::constant(Matrix2::identity());
            for _ in 0..exponent {
                expected = expected.mul(&jet);
            }
            let found = jet.power(exponent);
            prop_assert!(close(&found.value, &expected.value, 1e-12));
            prop_assert!(close(&found.by[0], &expected.by[0], 1e-10));
        }
    }
}
