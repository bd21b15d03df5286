//! Numbers that equations are written in once: plain ones, and ones that carry derivatives along.

use std::ops::{Add, Div, Mul, Sub};

use pulp::Simd;

use crate::subnormal::{cut, cut_all};

/// What the equations of a component ask of a number.
pub trait Scalar:
    Copy
    + PartialEq
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// A number of the same kind that depends on nothing.
    #[must_use]
    fn constant(self, value: f64) -> Self;

    /// The number without what it carries; comparisons are by it.
    fn value(self) -> f64;

    /// Whether it carries no derivative other than zero.
    #[must_use]
    fn is_constant(&self) -> bool;

    /// A function of the number, by its value and its slope there.
    #[must_use]
    fn function(self, value: f64, slope: f64) -> Self;

    /// A function of two numbers, by its value and its slopes along both.
    #[must_use]
    fn function_with(self, other: Self, value: f64, slopes: [f64; 2]) -> Self;

    /// `self + other factor`.
    #[must_use]
    fn plus(self, other: Self, factor: f64) -> Self;

    /// `self + a b`.
    #[must_use]
    fn plus_product(self, a: Self, b: Self) -> Self;

    /// Whether value and derivatives are zero.
    #[inline(always)]
    #[must_use]
    fn is_zero(&self) -> bool {
        self.value() == 0.0 && self.is_constant()
    }

    /// The number with its value and derivatives set to zero where they are tiny.
    #[must_use]
    fn cut(self) -> Self;
}

impl Scalar for f64 {
    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self
    }

    #[inline(always)]
    fn is_constant(&self) -> bool {
        true
    }

    #[inline(always)]
    fn function(self, value: f64, _slope: f64) -> f64 {
        value
    }

    #[inline(always)]
    fn function_with(self, _other: f64, value: f64, _slopes: [f64; 2]) -> f64 {
        value
    }

    #[inline(always)]
    fn plus(self, other: f64, factor: f64) -> f64 {
        self + other * factor
    }

    #[inline(always)]
    fn plus_product(self, a: f64, b: f64) -> f64 {
        self + a * b
    }

    #[inline(always)]
    fn cut(self) -> f64 {
        cut(self)
    }
}

/// A value and its derivatives in `N` directions, at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tangent<const N: usize> {
    /// The number itself.
    pub value: f64,
    /// Its derivatives.
    pub slopes: [f64; N],
}

/// Derivatives aligned to half a line of the cache: to a whole one, copies of what is left of it behind the value stall.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
struct Lanes<const N: usize>([f64; N]);

/// A value and its derivatives in `N` directions, a multiple of 8, computed with in the vectors of `S`.
///
/// Forward differentiation: every operation carries the derivatives along, so that they are those of the computation as
/// it is done, step by step. The value stands apart: its chain of operations is what a recursion waits for, and the
/// derivatives, side by side in vectors, are computed in its shade
/// (a vector full of the value is slower, too). Left to the compiler, the loops over directions
/// become shuffles of single numbers, twice as slow.
#[derive(Debug, Clone, Copy)]
pub struct Dual<S, const N: usize> {
    simd: S,
    /// The number itself.
    pub value: f64,
    slopes: Lanes<N>,
}

impl<S: Simd, const N: usize> Dual<S, N> {
    /// To compute with the vectors of `simd`.
    #[inline(always)]
    pub fn new(simd: S, Tangent { value, slopes }: Tangent<N>) -> Self {
        Self { simd, value, slopes: Lanes(slopes) }
    }

    /// What is to be kept.
    #[inline(always)]
    pub fn tangent(&self) -> Tangent<N> {
        Tangent { value: self.value, slopes: self.slopes.0 }
    }

    /// A value whose derivative is 1 in one direction, if there is that one, and 0 in the others.
    #[inline(always)]
    #[must_use]
    pub fn along(self, value: f64, direction: usize) -> Self {
        let mut slopes = [0.0; N];
        if let Some(slope) = slopes.get_mut(direction) {
            *slope = 1.0;
        }
        Self { value, slopes: Lanes(slopes), ..self }
    }

    /// A number with this value, whose derivatives are `own` times these plus `others` times the other's.
    #[inline(always)]
    fn combined(mut self, own: f64, other: &Self, others: f64, value: f64) -> Self {
        let (own, others) = (self.simd.splat_f64s(own), self.simd.splat_f64s(others));
        let (mine, theirs) = (S::as_mut_simd_f64s(&mut self.slopes.0).0, S::as_simd_f64s(&other.slopes.0).0);
        for i in 0..N / S::F64_LANES {
            mine[i] = self.simd.mul_add_e_f64s(mine[i], own, self.simd.mul_f64s(theirs[i], others));
        }
        Self { value, ..self }
    }

    /// One operation on every derivative, about a value.
    #[inline(always)]
    fn each(mut self, other: &Self, value: f64, op: impl Fn(S, S::f64s, S::f64s) -> S::f64s) -> Self {
        let (mine, theirs) = (S::as_mut_simd_f64s(&mut self.slopes.0).0, S::as_simd_f64s(&other.slopes.0).0);
        for i in 0..N / S::F64_LANES {
            mine[i] = op(self.simd, mine[i], theirs[i]);
        }
        Self { value, ..self }
    }

    #[inline(always)]
    fn scaled(mut self, factor: f64, value: f64) -> Self {
        let factor = self.simd.splat_f64s(factor);
        for mine in S::as_mut_simd_f64s(&mut self.slopes.0).0 {
            *mine = self.simd.mul_f64s(*mine, factor);
        }
        Self { value, ..self }
    }
}

impl<S: Simd, const N: usize> Scalar for Dual<S, N> {
    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        Self { value, slopes: Lanes([0.0; N]), ..self }
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self.value
    }

    #[inline(always)]
    fn is_constant(&self) -> bool {
        let mut moves = false;
        for slope in &self.slopes.0 {
            moves |= *slope != 0.0;
        }
        !moves
    }

    #[inline(always)]
    fn function(self, value: f64, slope: f64) -> Self {
        self.scaled(slope, value)
    }

    #[inline(always)]
    fn function_with(self, other: Self, value: f64, [own, others]: [f64; 2]) -> Self {
        self.combined(own, &other, others, value)
    }

    #[inline(always)]
    fn plus(mut self, other: Self, factor: f64) -> Self {
        let by = self.simd.splat_f64s(factor);
        let (mine, theirs) = (S::as_mut_simd_f64s(&mut self.slopes.0).0, S::as_simd_f64s(&other.slopes.0).0);
        for i in 0..N / S::F64_LANES {
            mine[i] = self.simd.mul_add_e_f64s(theirs[i], by, mine[i]);
        }
        Self { value: self.value + other.value * factor, ..self }
    }

    #[inline(always)]
    fn plus_product(mut self, a: Self, b: Self) -> Self {
        let (by_a, by_b) = (self.simd.splat_f64s(b.value), self.simd.splat_f64s(a.value));
        let mine = S::as_mut_simd_f64s(&mut self.slopes.0).0;
        let (of_a, of_b) = (S::as_simd_f64s(&a.slopes.0).0, S::as_simd_f64s(&b.slopes.0).0);
        for i in 0..N / S::F64_LANES {
            let with_a = self.simd.mul_add_e_f64s(of_a[i], by_a, mine[i]);
            mine[i] = self.simd.mul_add_e_f64s(of_b[i], by_b, with_a);
        }
        Self { value: self.value + a.value * b.value, ..self }
    }

    #[inline(always)]
    fn cut(mut self) -> Self {
        cut_all(&mut self.slopes.0);
        Self { value: cut(self.value), ..self }
    }
}

impl<S: Simd, const N: usize> PartialEq for Dual<S, N> {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value && (*self - *other).is_constant()
    }
}

impl<S: Simd, const N: usize> Add for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.each(&other, self.value + other.value, S::add_f64s)
    }
}

impl<S: Simd, const N: usize> Sub for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.each(&other, self.value - other.value, S::sub_f64s)
    }
}

impl<S: Simd, const N: usize> Mul for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.combined(other.value, &other, self.value, self.value * other.value)
    }
}

impl<S: Simd, const N: usize> Div for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, inverse) = (self.value / other.value, 1.0 / other.value);
        self.function_with(other, value, [inverse, -value * inverse])
    }
}

impl<S: Simd, const N: usize> Add<f64> for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f64) -> Self {
        Self { value: self.value + other, ..self }
    }
}

impl<S: Simd, const N: usize> Mul<f64> for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self.scaled(factor, self.value * factor)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use pulp::{Arch, WithSimd};

    use super::*;

    /// Every operation at once, smooth for positive numbers.
    fn formula<T: Scalar>(x: T, y: T) -> T {
        let sum = (x * y + x / y).plus(y, -3.0).plus_product(x, y + 1.0) + 2.0;
        let both = x.function_with(y, x.value() * y.value(), [y.value(), x.value()]);
        let [value, slope] = [x.value().powf(2.17), 2.17 * x.value().powf(1.17)];
        sum * sum - x.function(value, slope) / y + both
    }

    struct Formula([Tangent<8>; 2]);

    impl WithSimd for Formula {
        type Output = Tangent<8>;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Tangent<8> {
            let [x, y] = self.0.map(|tangent| Dual::new(simd, tangent));
            formula(x, y).tangent()
        }
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_a_fine_difference(x in 1.0..3.0_f64, y in 1.2..2.5_f64) {
            let along = |direction: usize| std::array::from_fn(|i| f64::from(u8::from(i == direction)));
            let both = [Tangent { value: x, slopes: along(1) }, Tangent { value: y, slopes: along(6) }];
            let found = Arch::new().dispatch(Formula(both));
            let h = 1e-5;
            let by_x = (formula(x + h, y) - formula(x - h, y)) / (2.0 * h);
            let by_y = (formula(x, y + h) - formula(x, y - h)) / (2.0 * h);
            let size = found.value.abs() + by_x.abs() + by_y.abs();
            prop_assert!((found.value - formula(x, y)).abs() < 1e-12 * size);
            prop_assert!((found.slopes[1] - by_x).abs() < 1e-6 * size && (found.slopes[6] - by_y).abs() < 1e-6 * size);
        }
    }
}
