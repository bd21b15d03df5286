//! Standard deviation of a channel's noise, from short stretches.

use super::sample::{LARGEST, Sample};

/// Samples per stretch.
const STRETCH: usize = 128;
/// Stretches for dense trains.
const DENSE_STRETCHES: usize = 8;
/// Fewest samples for a noise estimate.
const LEAST: usize = 16;
/// Median magnitude of a standard normal variable.
const MEDIAN: f64 = 0.674_489_750_196_081_7;
/// Bias of the estimate for white noise, by simulation: the least of several medians is too low.
const FOUND: f64 = 0.91;
/// Gains of white noise in differences of order p = 2, 4 and 6: roots of the binomials (2p over p).
const GAINS: [f64; 3] = [2.449_489_742_783_178, 8.366_600_265_340_756, 30.397_368_307_141_326];

/// Standard deviations of the noise in different stretches of `samples`, ascending; empty for too few samples.
///
/// Each stretch's noise is the least of three estimates: medians of differences of second, fourth and sixth order. A smooth
/// signal and rare edges do not affect these medians; anything else increases them.
pub fn noises<T: Sample>(samples: &[T], stretches: usize) -> Vec<f64> {
    of_stretches(samples, stretches, |stretch, _| Some(least_difference(stretch) / FOUND))
}

/// Lower quartile of ascending noise estimates, 0 if empty; higher estimates may contain more than noise.
pub fn quarter(ascending: &[f64]) -> f64 {
    ascending.get(ascending.len() / 4).copied().unwrap_or(0.0)
}

/// Standard deviation of the noise in a sinusoidal train with few samples per pulse. Unlike in [`noises`], a filter with
/// zeros at the train's frequency and at frequency zero replaces the differences. `period` returns the number of samples
/// per pulse between two sample indices.
pub fn noise_beside<T: Sample>(samples: &[T], period: impl Fn(usize, usize) -> Option<f64>) -> Option<f64> {
    let found = of_stretches(samples, DENSE_STRETCHES, |stretch, first| {
        let back = -2.0 * (std::f64::consts::TAU / period(first, first + STRETCH)?).cos();
        let taps = [[1.0, -1.0, 0.0], [1.0, back, 1.0], [1.0, back, 1.0]]
            .iter()
            .fold(vec![1.0], |taps, factor| product(&taps, factor));
        let gain = taps.iter().map(|tap| tap * tap).sum::<f64>().sqrt();
        let mut filtered: Vec<f64> = stretch
            .windows(taps.len())
            .map(|part| part.iter().zip(&taps).map(|(x, tap)| x * tap).sum::<f64>().abs())
            .collect();
        Some(median(&mut filtered) / (MEDIAN * gain))
    });
    (!found.is_empty()).then(|| quarter(&found))
}

fn product(one: &[f64], other: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; one.len() + other.len() - 1];
    for (i, x) in one.iter().enumerate() {
        for (j, y) in other.iter().enumerate() {
            product[i + j] += x * y;
        }
    }
    product
}

/// Noise estimates of stretches, in ascending order; `estimate` gets a stretch's samples and the first sample's index.
fn of_stretches<T: Sample>(
    samples: &[T],
    stretches: usize,
    estimate: impl Fn(&mut [f64], usize) -> Option<f64>,
) -> Vec<f64> {
    let size = STRETCH.min(samples.len());
    let count = if size < STRETCH { 1 } else { stretches.min(samples.len() / size) };
    let mut buffer = [0.0; STRETCH];
    let mut found = Vec::with_capacity(count);
    for k in 0..count {
        let first = (samples.len() - size) * k / (count - 1).max(1);
        let mut kept = 0;
        for x in samples[first..first + size].iter().map(|&x| x.into()) {
            buffer[kept] = x;
            kept += usize::from(x.abs() <= LARGEST);
        }
        if kept >= LEAST {
            found.extend(estimate(&mut buffer[..kept], first));
        }
    }
    found.sort_by(f64::total_cmp);
    found
}

fn least_difference(stretch: &mut [f64]) -> f64 {
    let mut count = stretch.len();
    let mut magnitudes = [0.0; STRETCH];
    let mut least = f64::INFINITY;
    for gain in GAINS {
        count -= 2;
        for k in 0..count {
            stretch[k] = stretch[k] - 2.0 * stretch[k + 1] + stretch[k + 2];
            magnitudes[k] = stretch[k].abs();
        }
        least = least.min(median(&mut magnitudes[..count]) / (MEDIAN * gain));
    }
    if least.is_finite() { least } else { 0.0 }
}

/// Median; for an even count the upper of the middle two.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise<T: Sample>(samples: &[T]) -> f64 {
        quarter(&noises(samples, 8))
    }

    /// Approximately normal numbers: sums of twelve uniform ones.
    fn normal(count: usize) -> Vec<f64> {
        let mut state = 7_u64;
        let mut uniform = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
    }

    #[test]
    fn noise_shows_beside_sines_and_edges() {
        let plain = normal(50_000);
        assert!((noise(&plain) - 1.0).abs() < 0.2, "{}", noise(&plain));
        let sine: Vec<f64> =
            plain.iter().enumerate().map(|(k, x)| x + 100.0 * (k as f64 * 0.3).sin()).collect();
        assert!((noise(&sine) - 1.0).abs() < 0.2, "{}", noise(&sine));
        let square: Vec<f64> =
            plain.iter().enumerate().map(|(k, x)| x + 100.0 * f64::from(k % 97 < 30)).collect();
        assert!((noise(&square) - 1.0).abs() < 0.3, "{}", noise(&square));
    }

    #[test]
    fn noise_shows_beside_a_sine_of_four_samples() {
        let dense: Vec<f64> = normal(50_000)
            .iter()
            .enumerate()
            .map(|(k, x)| x + 100.0 * (k as f64 * std::f64::consts::TAU / 4.1).sin())
            .collect();
        assert!(noise(&dense) > 5.0);
        let found = noise_beside(&dense, |_, _| Some(4.1)).unwrap();
        assert!((found - 1.0).abs() < 0.2, "{found}");
        assert!(noise_beside(&dense, |_, _| None).is_none());
    }

    #[test]
    fn what_is_short_or_missing_or_constant_has_no_noise() {
        assert!(noise::<i16>(&[]) == 0.0 && noise(&[1.0, 2.0]) == 0.0);
        assert!(noise(&[f64::NAN; 300]) == 0.0 && noise(&[2.5_f32; 300]) == 0.0);
    }
}
