//! State levels of a pulse train, from histograms.

use multiversion::multiversion;

use super::sample::{LARGEST, Sample};
use crate::error::Result;
use crate::stop::{CHECK_EVERY, Stop};

const BINS: usize = 100;
/// Share of samples in each tail that may be disturbances: samples with radio interference are rarer than this, samples
/// at the top of a pulse are not.
const TAIL: f64 = 1e-3;
/// Largest number of rounds; each narrows the range at least twofold, and a hundredfold if everything is in one bin.
const ROUNDS: usize = 12;
const LANES: usize = 8;

#[inline(always)]
fn is_usable(x: f64) -> bool {
    x.abs() <= LARGEST
}

/// Low and high state level: the modes of the lower and upper half of a histogram of the finite samples.
///
/// The histogram has 100 bins, like MATLAB's `statelevels`. Rare high peaks would put both states into one bin. A
/// thousandth of the samples at each end is therefore cut off, and the histogram is repeated over the remaining bins, as
/// long as these bins cover less than half of the range.
///
/// Both are NaN if no sample is finite.
///
/// # Errors
/// On a stop.
pub fn pulse_levels<T: Sample>(samples: &[T], stop: &Stop) -> Result<(f64, f64)> {
    let (mut low, mut high, count) = finite_range(samples, stop)?;
    if count == 0 {
        return Ok((f64::NAN, f64::NAN));
    }
    let tail = count as f64 * TAIL;
    for _ in 0..ROUNDS {
        let width = (high - low) / BINS as f64;
        if width <= 0.0 {
            break;
        }
        let bins = histogram(samples, low, width, stop)?;
        let first = past_tail(bins.iter(), tail);
        let last = BINS - 1 - past_tail(bins.iter().rev(), tail);
        if last - first >= BINS / 2 {
            let (lower, upper) = bins.split_at(BINS / 2);
            // The narrowest ranges have a rounded-up width.
            let centre = |bin: usize| (low + width * (bin as f64 + 0.5)).min(high);
            return Ok((centre(mode(lower)), centre(BINS / 2 + mode(upper))));
        }
        (low, high) = (low + width * first as f64, (low + width * (last + 1) as f64).min(high));
    }
    Ok((low, high))
}

/// Least and greatest finite sample, and number of finite samples.
fn finite_range<T: Sample>(samples: &[T], stop: &Stop) -> Result<(f64, f64, u64)> {
    let (mut low, mut high, mut count) = (f64::INFINITY, f64::NEG_INFINITY, 0);
    for part in samples.chunks(CHECK_EVERY) {
        stop.check()?;
        let found = range_of(part);
        (low, high, count) = (low.min(found.0), high.max(found.1), count + u64::from(found.2));
    }
    Ok((low, high, count))
}

/// Least and greatest finite sample of a few samples, and number of finite ones.
///
/// Compiled for each instruction set and chosen at run time.
///
/// Neighbouring samples are compared in different lanes, so that no comparison waits for the previous one.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2", "x86_64+avx2"))]
fn range_of<T: Sample>(samples: &[T]) -> (f64, f64, u32) {
    let mut low = [f64::INFINITY; LANES];
    let mut high = [f64::NEG_INFINITY; LANES];
    let mut count = [0; LANES];
    let (rows, rest) = samples.as_chunks::<LANES>();
    // By index: an iterator would keep the lanes in memory.
    #[allow(clippy::needless_range_loop)]
    for row in rows {
        for lane in 0..LANES {
            let x: f64 = row[lane].into();
            let finite = is_usable(x);
            low[lane] = if finite && x < low[lane] { x } else { low[lane] };
            high[lane] = if finite && x > high[lane] { x } else { high[lane] };
            count[lane] += u32::from(finite);
        }
    }
    for x in rest.iter().map(|&x| x.into()).filter(|&x| is_usable(x)) {
        (low[0], high[0], count[0]) = (low[0].min(x), high[0].max(x), count[0] + 1);
    }
    let low = low.into_iter().fold(f64::INFINITY, f64::min);
    let high = high.into_iter().fold(f64::NEG_INFINITY, f64::max);
    (low, high, count.iter().sum())
}

/// Counts in bins of `width` from `low` on; outliers are counted at the ends.
fn histogram<T: Sample>(samples: &[T], low: f64, width: f64, stop: &Stop) -> Result<[u64; BINS]> {
    // Samples that are not finite are counted past the last bin.
    let mut lanes = [[0_u64; BINS + 1]; LANES];
    let scale = width.recip();
    let mut places = [0; CHECK_EVERY];
    for part in samples.chunks(CHECK_EVERY) {
        stop.check()?;
        places_of(part, low, scale, &mut places[..part.len()]);
        let (rows, rest) = places[..part.len()].as_chunks::<LANES>();
        // Neighbours are mostly in the same bin: separate tables avoid dependencies.
        for row in rows {
            for (table, &place) in lanes.iter_mut().zip(row) {
                table[usize::from(place)] += 1;
            }
        }
        for &place in rest {
            lanes[0][usize::from(place)] += 1;
        }
    }
    Ok(std::array::from_fn(|bin| lanes.iter().map(|bins| bins[bin]).sum()))
}

/// Bin of each sample; compiled for each instruction set and chosen at run time.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl+avx512dq+avx2", "x86_64+avx2"))]
fn places_of<T: Sample>(samples: &[T], low: f64, scale: f64, places: &mut [u8]) {
    for (place, &x) in places.iter_mut().zip(samples) {
        let x: f64 = x.into();
        // Clamped as floating point, so that a bin fits in a byte. Values that are not finite are clamped, too.
        let bin =
            if is_usable(x) { ((x - low) * scale).max(0.0).min((BINS - 1) as f64) } else { BINS as f64 };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let bin = bin as i32 as u8;
        *place = bin;
    }
}

/// The first bin that is not completely within the tail.
fn past_tail<'a>(bins: impl Iterator<Item = &'a u64>, tail: f64) -> usize {
    let mut sum = 0;
    bins.take_while(|&&count| {
        sum += count;
        sum as f64 <= tail
    })
    .count()
}

/// The fullest bin, the first of equal ones.
fn mode(bins: &[u64]) -> usize {
    (0..bins.len()).rev().max_by_key(|&bin| bins[bin]).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels<T: Sample>(samples: &[T]) -> (f64, f64) {
        pulse_levels(samples, &Stop::new()).unwrap()
    }

    #[test]
    fn a_clean_train_gives_its_levels_within_half_a_bin() {
        let train: Vec<f32> = (0..10_000).map(|k| if k % 97 < 30 { 4.5 } else { 0.25 }).collect();
        let (low, high) = levels(&train);
        assert!((low - 0.25).abs() < 0.022 && (high - 4.5).abs() < 0.022, "{low} {high}");
        let counts: Vec<i16> = (0..10_000).map(|k| if k % 97 < 30 { 3000 } else { -3000 }).collect();
        let (low, high) = levels(&counts);
        assert!((low + 3000.0).abs() <= 30.0 && (high - 3000.0).abs() <= 30.0, "{low} {high}");
    }

    #[test]
    fn rare_high_peaks_and_missing_samples_do_not_move_the_levels() {
        let train: Vec<f64> = (0..20_000)
            .map(|k| match k {
                _ if k % 2500 == 7 => 1e4,
                _ if k % 331 == 0 => f64::NAN,
                _ if k % 333 == 0 => f64::INFINITY,
                _ => [0.5, 5.5][usize::from(k % 97 < 30)] + 0.1 * f64::from(k).sin(),
            })
            .collect();
        let (low, high) = levels(&train);
        assert!((low - 0.5).abs() < 0.2 && (high - 5.5).abs() < 0.2, "{low} {high}");
    }

    #[test]
    fn a_constant_train_has_one_level_and_an_empty_one_none() {
        assert_eq!(levels(&[2.5_f32; 100]), (2.5, 2.5));
        let mut glitch = vec![2.5; 5000];
        glitch[77] = 80.0;
        let (low, high) = levels(&glitch);
        assert!((low - 2.5).abs() < 1e-9 && (high - 2.5).abs() < 1e-9, "{low} {high}");
        assert!(levels(&[f64::NAN]).0.is_nan() && levels::<i16>(&[]).1.is_nan());
    }
}
