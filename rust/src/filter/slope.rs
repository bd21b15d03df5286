//! Slope of a piecewise cubic polynomial at even times.

use multiversion::multiversion;

use crate::error::{Result, require};
use crate::stop::{CHECK_EVERY, Stop};

/// Slope at the times `start + k / rate` that lie within [first edge, last edge), and the first such k.
///
/// `coefficients` are four rows with one value for each stretch between edges, the highest power first, as in `SciPy`'s
/// `PPoly`; the values are its own to the last bit.
///
/// # Errors
/// Unless there are four rows, edges ascend and `rate` is positive; or on a stop.
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
    let grid = Grid { start, rate, count };
    let first = grid.first_from(edges[0]);
    let mut slopes = vec![0.0; grid.first_from(edges[stretches]) - first];
    let [cubic, square, line] = [0, 1, 2].map(|row| &coefficients[row * stretches..][..stretches]);
    let (mut at, mut next_check) = (first, first + CHECK_EVERY);
    for (((pair, c0), c1), c2) in edges.windows(2).zip(cubic).zip(square).zip(line) {
        let end = grid.first_from(pair[1]).max(at);
        stretch(&mut slopes[at - first..end - first], at, &grid, pair[0], [*c0, *c1, *c2]);
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

    /// The first time at or after an edge, `count` if there is none.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a guess, clamped
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

/// Slopes over one stretch; compiled once for each instruction set and chosen at run time.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2", "x86_64+avx2"))]
fn stretch(slopes: &mut [f64], first: usize, grid: &Grid, edge: f64, [c0, c1, c2]: [f64; 3]) {
    for (k, slope) in (first..).zip(slopes) {
        let s = grid.time(k) - edge;
        *slope = c2 + c1 * s * 2.0 + c0 * (s * s) * 3.0;
    }
}
