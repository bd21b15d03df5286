//! Standard deviations of crossing times, from sampling and from noise.

use super::noise::noise_beside;
use super::sample::{LARGEST, Sample};
use super::thresholds::Edge;

/// Crossings that are processed together.
const TOGETHER: usize = 64;
/// Error of linear interpolation [samples] for each rise between the two samples around a crossing, as a share of the
/// train's height. It is 1 / sqrt(12) for steps, and an average over sample positions for ramps and sines.
const GRID: [(f64, f64); 20] = [
    (0.0, 0.0),
    (0.156, 0.0011),
    (0.221, 0.0023),
    (0.304, 0.0046),
    (0.373, 0.0073),
    (0.419, 0.0097),
    (0.477, 0.0133),
    (0.512, 0.0161),
    (0.55, 0.0197),
    (0.592, 0.0249),
    (0.614, 0.0283),
    (0.637, 0.0324),
    (0.659, 0.0377),
    (0.681, 0.0443),
    (0.701, 0.0532),
    (0.716, 0.0652),
    (0.812, 0.1144),
    (0.875, 0.1715),
    (0.938, 0.2298),
    (1.0, 0.2887),
];
/// With noise, an edge crosses the level several times, and the last crossing counts. Pairs: the noise over the rise per
/// sample, and the factor on the standard deviation of the last crossing, from simulations.
const LAST: [(f64, f64); 9] = [
    (0.3, 1.0),
    (0.5, 0.982),
    (1.0, 0.928),
    (1.5, 0.891),
    (2.0, 0.86),
    (3.0, 0.813),
    (5.0, 0.766),
    (12.0, 0.678),
    (20.0, 0.627),
];
/// Mean variance of a linearly interpolated value, over the variance of a sample.
const BETWEEN: f64 = 2.0 / 3.0;
/// Samples per pulse below which noise is measured away from the train's frequency.
const DENSE: f64 = 10.0;
/// Rise of an edge between two samples, in standard deviations of the noise, above which this rise gives the slope.
const STEEP: f64 = 4.0;
/// Rise as a share of the height above which an edge is a step; noise does not affect the time at which a step crosses.
const STEP: f64 = 0.95;

/// Standard deviations of crossing times [samples], from sampling and from noise.
#[derive(Debug, Clone, Default)]
pub struct Timing {
    /// Standard deviation from sampling.
    pub grid: Vec<f64>,
    /// Standard deviation from noise.
    pub noise: Vec<f64>,
}

impl Timing {
    /// Compute the standard deviations for crossings in `samples`, which start at sample `first` of the record. `heights`
    /// is the train's height at each crossing (0 if unknown), `noise` the standard deviation of the noise.
    pub fn of<T: Sample>(samples: &[T], first: u64, edges: &[Edge], heights: &[f64], noise: f64) -> Self {
        let mut found = Self::default();
        let noise = beside(samples, first, edges, noise);
        for (edges, heights) in edges.chunks(TOGETHER).zip(heights.chunks(TOGETHER)) {
            let (grid, spread) = together(samples, first, edges, heights, noise);
            found.grid.extend(std::iter::repeat_n(grid, edges.len()));
            found.noise.extend(std::iter::repeat_n(spread, edges.len()));
        }
        found
    }
}

/// Standard deviation of the noise. For pulses of few samples, only the noise beside the train's frequency is measured.
fn beside<T: Sample>(samples: &[T], first: u64, edges: &[Edge], noise: f64) -> f64 {
    if period(edges).is_none_or(|period| period > DENSE) {
        return noise;
    }
    let near = |from: usize, to: usize| {
        let place = |at: usize| edges.partition_point(|edge| edge.time < first as f64 + at as f64);
        period(&edges[place(from)..place(to)]).filter(|&period| period > 2.0)
    };
    noise_beside(samples, near).map_or(noise, |found| noise.min(found))
}

fn period(edges: &[Edge]) -> Option<f64> {
    let (first, last) = (edges.first()?, edges.last()?);
    (edges.len() > 2).then(|| (last.time - first.time) / (edges.len() - 1) as f64)
}

fn together<T: Sample>(samples: &[T], first: u64, edges: &[Edge], heights: &[f64], noise: f64) -> (f64, f64) {
    let known = |height: &&f64| **height > 0.0;
    let height =
        heights.iter().filter(known).sum::<f64>() / heights.iter().filter(known).count().max(1) as f64;
    if height <= 0.0 {
        return (GRID[GRID.len() - 1].1, 0.0);
    }
    let rise = edges.iter().map(|edge| edge.rise.min(height)).sum::<f64>() / edges.len() as f64;
    // Each level is the extreme of the samples in half a pulse; noise increases extremes.
    let period = period(edges).unwrap_or(2.0 * DENSE);
    let pushed = noise * ((2.0 * (0.5 * period).max(2.0).ln()).sqrt() - 0.6).max(0.0);
    let share = rise / (height - 2.0 * pushed).max(rise);
    let grid = interpolated(&GRID, share);
    if share > STEP {
        return (grid, 0.0);
    }
    let steep = rise > STEEP * noise;
    // Crossings are more frequent where noise adds to the rise: for slope s the mean rise is s + 2 noise^2 / s.
    let own = 0.5 * (rise + (rise * rise - 8.0 * noise * noise).max(0.0).sqrt());
    let slope = if steep { own } else { wide_slope(samples, first, edges, period).unwrap_or(own) };
    let ratio = noise / slope;
    // Even on a flat edge a crossing is within its pulse.
    (grid, (BETWEEN.sqrt() * ratio * interpolated(&LAST, ratio)).min(0.5 * period))
}

/// Rise per sample over a sixth of a pulse around the crossings.
fn wide_slope<T: Sample>(samples: &[T], first: u64, edges: &[Edge], period: f64) -> Option<f64> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a period is positive and short
    let reach = (period / 12.0) as usize;
    let (mut sum, mut count) = (0.0, 0.0);
    for edge in edges {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // a crossing is at most slightly before the window
        let Some(at) = (edge.time as u64).checked_sub(first).map(|at| at as usize) else { continue };
        if at + 1 < reach || at + reach >= samples.len() || reach < 2 {
            continue;
        }
        let rise: f64 = samples[at + reach].into() - samples[at + 1 - reach].into();
        if rise.abs() <= LARGEST {
            sum += rise;
            count += (2 * reach - 1) as f64;
        }
    }
    (sum > 0.0).then(|| sum / count)
}

/// Linear interpolation in a table, constant beyond its ends.
fn interpolated(table: &[(f64, f64)], x: f64) -> f64 {
    let above = table.partition_point(|&(place, _)| place <= x);
    if above == 0 {
        return table[0].1;
    }
    let Some(&(right, last)) = table.get(above) else { return table[table.len() - 1].1 };
    let (left, value) = table[above - 1];
    value + (last - value) * (x - left) / (right - left)
}
