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
