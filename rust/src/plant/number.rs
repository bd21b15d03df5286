//! What the equations of motion are computed with: a number, or one of each of several plants in vector registers.

use std::ops::{Add, Mul, Sub};

use pulp::Simd;

/// A number, or several.
pub trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// The same number for all.
    #[must_use]
    fn like(self, value: f64) -> Self;

    /// `self factor + summand`; where the machine has an instruction for it, `FUSED`, rounded once.
    #[must_use]
    fn times_plus<const FUSED: bool>(self, factor: Self, summand: Self) -> Self;

    /// Without their signs.
    #[must_use]
    fn abs(self) -> Self;

    /// What is less than `other`, else `other`.
    #[must_use]
    fn at_most(self, other: Self) -> Self;

    /// What is greater than `other`, else `other`.
    #[must_use]
    fn at_least(self, other: Self) -> Self;

    /// Each joined with that of another by a function of numbers.
    #[must_use]
    fn join(self, other: Self, join: impl FnMut(f64, f64) -> f64) -> Self;

    /// Which of the lanes it holds, and what it takes to load them.
    type Place: Copy;

    /// Take them from the lanes.
    #[must_use]
    fn load(place: Self::Place, lanes: &[f64]) -> Self;

    /// Lay them down again.
    fn store(self, place: Self::Place, lanes: &mut [f64]);
}

// Written so that each is one instruction; `f64::min` and `f64::max` would drop a NaN and cost three.
impl Number for f64 {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn times_plus<const FUSED: bool>(self, factor: Self, summand: Self) -> Self {
        if FUSED { self.mul_add(factor, summand) } else { self * factor + summand }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }

    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    #[inline(always)]
    fn join(self, other: Self, mut join: impl FnMut(f64, f64) -> f64) -> Self {
        join(self, other)
    }

    type Place = ();

    #[inline(always)]
    fn load((): (), lanes: &[f64]) -> Self {
        lanes[0]
    }

    #[inline(always)]
    fn store(self, (): (), lanes: &mut [f64]) {
        lanes[0] = self;
    }
}

/// Lanes that a vector register has at most.
const MOST: usize = 8;

/// Registers whose operations take turns, so that one computes while the other waits.
#[derive(Debug, Clone, Copy)]
pub struct Registers<S: Simd, const R: usize> {
    simd: S,
    values: [S::f64s; R],
}

/// Numbers in memory as registers hold them.
#[repr(align(64))]
struct Spilt<const R: usize>([[f64; MOST]; R]);

impl<S: Simd, const R: usize> Number for Registers<S, R> {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self { values: [self.simd.splat_f64s(value); R], ..self }
    }

    #[inline(always)]
    fn times_plus<const FUSED: bool>(mut self, factor: Self, summand: Self) -> Self {
        for r in 0..R {
            self.values[r] = self.simd.mul_add_e_f64s(self.values[r], factor.values[r], summand.values[r]);
        }
        self
    }

    #[inline(always)]
    fn abs(mut self) -> Self {
        // The crate's own `abs` is a call.
        let but_sign = self.simd.splat_f64s(f64::from_bits(!(1 << 63)));
        for r in 0..R {
            self.values[r] = self.simd.and_f64s(but_sign, self.values[r]);
        }
        self
    }

    #[inline(always)]
    fn at_most(mut self, other: Self) -> Self {
        for r in 0..R {
            self.values[r] = self.simd.min_f64s(self.values[r], other.values[r]);
        }
        self
    }

    #[inline(always)]
    fn at_least(mut self, other: Self) -> Self {
        for r in 0..R {
            self.values[r] = self.simd.max_f64s(self.values[r], other.values[r]);
        }
        self
    }

    #[inline(always)]
    fn join(self, other: Self, mut join: impl FnMut(f64, f64) -> f64) -> Self {
        let (mut ones, mut others) = (Spilt([[0.0; MOST]; R]), Spilt([[0.0; MOST]; R]));
        let place = (self.simd, 0);
        self.store(place, ones.0.as_flattened_mut());
        other.store(place, others.0.as_flattened_mut());
        let count = R * S::F64_LANES;
        for (one, other) in ones.0.as_flattened_mut()[..count].iter_mut().zip(others.0.as_flattened()) {
            *one = join(*one, *other);
        }
        Self::load(place, ones.0.as_flattened())
    }

    /// The instructions, and the first of the registers.
    type Place = (S, usize);

    #[inline(always)]
    #[allow(clippy::manual_memcpy)] // a copy of so few is a call
    fn load((simd, first): (S, usize), lanes: &[f64]) -> Self {
        let lanes = &S::as_simd_f64s(lanes).0[first..first + R];
        let mut values = [simd.splat_f64s(0.0); R];
        for r in 0..R {
            values[r] = lanes[r];
        }
        Self { simd, values }
    }

    #[inline(always)]
    #[allow(clippy::manual_memcpy)] // as above
    fn store(self, (_, first): (S, usize), lanes: &mut [f64]) {
        let lanes = &mut S::as_mut_simd_f64s(lanes).0[first..first + R];
        for r in 0..R {
            lanes[r] = self.values[r];
        }
    }
}

impl<S: Simd, const R: usize> Add for Registers<S, R> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for r in 0..R {
            self.values[r] = self.simd.add_f64s(self.values[r], other.values[r]);
        }
        self
    }
}

impl<S: Simd, const R: usize> Sub for Registers<S, R> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        for r in 0..R {
            self.values[r] = self.simd.sub_f64s(self.values[r], other.values[r]);
        }
        self
    }
}

impl<S: Simd, const R: usize> Mul for Registers<S, R> {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, other: Self) -> Self {
        for r in 0..R {
            self.values[r] = self.simd.mul_f64s(self.values[r], other.values[r]);
        }
        self
    }
}
