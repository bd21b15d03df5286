//! Derivative of a piecewise cubic polynomial at equidistant times.

use pulp::{Simd, WithSimd};

use crate::error::{Result, require};
use crate::instruction_set::arch;
use crate::memory::zeros;
use crate::stop::{CHECK_EVERY, Stop};

/// Largest number of slopes per call: 24 days at 2 kHz.
const MOST: usize = 1 << 32;
/// Least distance between two times, in units in the last place of the latest time.
const RESOLUTION: f64 = 8.0;

/// Derivative at the times `start + k / rate` in [first edge, last edge), and the first such k.
///
/// `coefficients` are four rows with a value for each interval between edges, highest power first, as in `SciPy`'s `PPoly`;
/// the results are bitwise equal.
///
/// # Errors
/// If there are not four rows; if the edges do not ascend; if `rate` is not positive, or so high that neighbouring times are
/// equal after rounding; if the slopes are too many for memory; or after a request to stop.
pub fn slope_at_even_times(
    edges: &[f64],
    coefficients: &[f64],
    start: f64,
    rate: f64,
    count: usize,
    stop: &Stop,
) -> Result<(usize, Vec<f64>)> {
    let stretches = edges.len().saturating_sub(1);
    require(stretches > 0 && coefficients.len() == 4 * stretches, || {
        format!(
            "coefficients: found {} of them for {} edges, expected [4, N - 1]",
            coefficients.len(),
            edges.len()
        )
    })?;
    require(edges.is_sorted() && edges.iter().all(|edge| edge.is_finite()), || {
        "edges: expected finite times that ascend".to_owned()
    })?;
    require(start.is_finite() && rate.is_finite() && rate > 0.0, || {
        format!("start, rate: found {start} and {rate}, expected finite numbers, the rate positive")
    })?;
    let latest = start.abs().max(edges[0].abs()).max(edges[stretches].abs());
    // The search would not end if times were equal after rounding.
    require(1.0 / rate >= RESOLUTION * f64::EPSILON * latest, || {
        format!(
            "rate: found {rate} Hz at times up to {latest} s, expected one that a number of 64 bits can tell apart there"
        )
    })?;
    let grid = Grid { start, rate, count };
    let first = grid.first_from(edges[0]);
    let within = grid.first_from(edges[stretches]) - first;
    require(within <= MOST, || {
        format!("rate, count: found {within} times within the edges, expected up to {MOST}; use a lower rate")
    })?;
    let mut slopes = zeros(within)?;
    let [cubic, square, line] = [0, 1, 2].map(|row| &coefficients[row * stretches..][..stretches]);
    let arch = arch();
    let (mut at, mut next_check) = (first, first + CHECK_EVERY);
    for (((pair, c0), c1), c2) in edges.windows(2).zip(cubic).zip(square).zip(line) {
        let end = grid.first_from(pair[1]).max(at);
        let slopes = &mut slopes[at - first..end - first];
        let coefficients = [*c0, *c1, *c2];
        arch.dispatch(Stretch { slopes, first: at, grid: &grid, edge: pair[0], coefficients });
        at = end;
        if at >= next_check {
            stop.check()?;
            next_check = at + CHECK_EVERY;
        }
    }
    Ok((first, slopes))
}

struct Grid {
    start: f64,
    rate: f64,
    count: usize,
}

impl Grid {
    #[inline(always)]
    fn time(&self, k: usize) -> f64 {
        self.start + k as f64 / self.rate
    }

    /// Index of the first time at or after an edge, or `count`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // an estimate, clamped
    fn first_from(&self, edge: f64) -> usize {
        let mut k = (((edge - self.start) * self.rate) as usize).min(self.count);
        while k > 0 && self.time(k - 1) >= edge {
            k -= 1;
        }
        while k < self.count && self.time(k) < edge {
            k += 1;
        }
        k
    }
}

/// Derivative over one interval; compiled for each instruction set.
struct Stretch<'a> {
    slopes: &'a mut [f64],
    first: usize,
    grid: &'a Grid,
    edge: f64,
    coefficients: [f64; 3],
}

impl WithSimd for Stretch<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { slopes, first, grid, edge, coefficients: [c0, c1, c2] } = self;
        for (k, slope) in (first..).zip(slopes) {
            let s = grid.time(k) - edge;
            *slope = c2 + c1 * s * 2.0 + c0 * (s * s) * 3.0;
        }
    }
}
