//! Vectors of complex numbers, one frequency per lane.

use pulp::Simd;

/// -x; pulp's negation is not inlined.
#[inline(always)]
pub fn negative<S: Simd>(simd: S, x: S::f64s) -> S::f64s {
    simd.sub_f64s(simd.splat_f64s(0.0), x)
}

/// Real and imaginary parts of the numbers at neighbouring frequencies.
#[derive(Debug, Clone, Copy)]
pub struct Complex<S: Simd> {
    pub re: S::f64s,
    pub im: S::f64s,
}

impl<S: Simd> Complex<S> {
    /// One number, equal in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, re: f64, im: f64) -> Self {
        Self { re: simd.splat_f64s(re), im: simd.splat_f64s(im) }
    }

    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        Self::splat(simd, 0.0, 0.0)
    }

    #[inline(always)]
    pub fn plus(self, simd: S, other: Self) -> Self {
        Self { re: simd.add_f64s(self.re, other.re), im: simd.add_f64s(self.im, other.im) }
    }

    #[inline(always)]
    pub fn minus(self, simd: S, other: Self) -> Self {
        Self { re: simd.sub_f64s(self.re, other.re), im: simd.sub_f64s(self.im, other.im) }
    }

    #[inline(always)]
    pub fn times(self, simd: S, other: Self) -> Self {
        Self {
            re: simd.negate_mul_add_e_f64s(self.im, other.im, simd.mul_f64s(self.re, other.re)),
            im: simd.mul_add_e_f64s(self.re, other.im, simd.mul_f64s(self.im, other.re)),
        }
    }

    /// `self + a b`.
    #[inline(always)]
    pub fn plus_product(self, simd: S, a: Self, b: Self) -> Self {
        Self {
            re: simd.negate_mul_add_e_f64s(a.im, b.im, simd.mul_add_e_f64s(a.re, b.re, self.re)),
            im: simd.mul_add_e_f64s(a.re, b.im, simd.mul_add_e_f64s(a.im, b.re, self.im)),
        }
    }

    /// `self - a b`.
    #[inline(always)]
    pub fn minus_product(self, simd: S, a: Self, b: Self) -> Self {
        Self {
            re: simd.mul_add_e_f64s(a.im, b.im, simd.negate_mul_add_e_f64s(a.re, b.re, self.re)),
            im: simd.negate_mul_add_e_f64s(a.re, b.im, simd.negate_mul_add_e_f64s(a.im, b.re, self.im)),
        }
    }

    /// `self + a factor` with a real factor.
    #[inline(always)]
    pub fn plus_scaled(self, simd: S, a: Self, factor: S::f64s) -> Self {
        Self {
            re: simd.mul_add_e_f64s(a.re, factor, self.re),
            im: simd.mul_add_e_f64s(a.im, factor, self.im),
        }
    }

    #[inline(always)]
    pub fn scaled(self, simd: S, factor: S::f64s) -> Self {
        Self { re: simd.mul_f64s(self.re, factor), im: simd.mul_f64s(self.im, factor) }
    }

    /// `j omega self + other`.
    #[inline(always)]
    pub fn risen(self, simd: S, omega: S::f64s, other: Self) -> Self {
        Self {
            re: simd.negate_mul_add_e_f64s(omega, self.im, other.re),
            im: simd.mul_add_e_f64s(omega, self.re, other.im),
        }
    }

    #[inline(always)]
    pub fn conjugate(self, simd: S) -> Self {
        Self { re: self.re, im: negative(simd, self.im) }
    }

    #[inline(always)]
    pub fn inverse(self, simd: S) -> Self {
        let square = simd.mul_add_e_f64s(self.im, self.im, simd.mul_f64s(self.re, self.re));
        let one = simd.div_f64s(simd.splat_f64s(1.0), square);
        Self { re: simd.mul_f64s(self.re, one), im: negative(simd, simd.mul_f64s(self.im, one)) }
    }
}

/// exp(-j omega t) at equidistant frequencies, by rotation.
#[derive(Debug, Clone, Copy)]
pub struct Rotation<S: Simd> {
    pub now: Complex<S>,
    step: Complex<S>,
}

impl<S: Simd> Rotation<S> {
    /// From frequency 0, `spacing` [rad/s] apart, for a time t [s].
    #[inline(always)]
    pub fn new(simd: S, spacing: f64, t: f64) -> Self {
        let lanes = S::F64_LANES;
        let (mut re, mut im) = ([0.0; 16], [0.0; 16]);
        for lane in 0..lanes {
            let (sin, cos) = (spacing * lane as f64 * t).sin_cos();
            (re[lane], im[lane]) = (cos, -sin);
        }
        let (sin, cos) = (spacing * lanes as f64 * t).sin_cos();
        let now = Complex { re: S::as_simd_f64s(&re[..lanes]).0[0], im: S::as_simd_f64s(&im[..lanes]).0[0] };
        Self { now, step: Complex::splat(simd, cos, -sin) }
    }

    #[inline(always)]
    pub fn advance(&mut self, simd: S) {
        self.now = self.now.times(simd, self.step);
    }
}
