//! The propeller's power law `N^p` at a speed, and how it moves with the speed.

use super::model::{Model, fma};

/// `N^p`, `1 / N` and `ln N`.
#[derive(Debug, Clone, Copy)]
pub struct Power {
    pub speed: f64,
    pub value: f64,
    pub inverse: f64,
    pub logarithm: f64,
}

impl Power {
    pub fn at(speed: f64, p: f64) -> Self {
        let size = speed.abs().max(f64::MIN_POSITIVE);
        let value = size.powf(p).copysign(speed);
        // About standing still a power has no series; it is next to nothing there.
        let inverse = if size < 1e-2 { 0.0 } else { 1.0 / speed };
        Self { speed, value, inverse, logarithm: size.ln() }
    }

    /// At a speed nearby: about the old one `(1 + x)^p` is a series, which is off by less than 1e-16 below [`Self::NEAR`].
    #[inline(always)]
    pub fn moved(&self, speed: f64, model: &Model) -> Self {
        let x = (speed - self.speed) * self.inverse;
        if x.abs() < Self::NEAR && self.inverse != 0.0 {
            let square = x * x;
            let b = &model.binomial;
            let low = fma(square, fma(b[3], x, b[2]), fma(b[1], x, 1.0));
            let high = fma(square, fma(b[7], x, b[6]), fma(b[5], x, b[4]));
            let value = self.value * fma(square * square, high, low);
            let low = fma(square, fma(-0.25, x, 1.0 / 3.0), fma(-0.5, x, 1.0));
            let high = fma(square, fma(-0.125, x, 1.0 / 7.0), fma(-1.0 / 6.0, x, 0.2));
            let logarithm = fma(x, fma(square * square, high, low), self.logarithm);
            Self { speed, value, inverse: 1.0 / speed, logarithm }
        } else {
            Self::at(speed, model.p)
        }
    }

    /// Its slope by `N`.
    #[inline(always)]
    pub fn slope(&self, p: f64) -> f64 {
        p * self.value * self.inverse
    }

    /// Its derivative by `p`.
    pub fn by_exponent(&self) -> f64 {
        self.value * self.logarithm
    }

    /// How far of itself a speed may move.
    pub const NEAR: f64 = 1.0 / 64.0;
}
