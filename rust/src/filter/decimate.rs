//! Zero-phase FIR low-pass that computes only the requested samples, over input in pieces of any length.

use pulp::{Simd, WithSimd};

use crate::error::{Error, Result, require};
use crate::instruction_set::arch;
use crate::memory::reserve;
use crate::stop::{CHECK_EVERY, Stop};

/// Number of parallel sums, which hide the latency of additions.
const LANES: usize = 32;

/// Largest numerator and denominator of a rate ratio: each of `up` phases has its own row of taps.
const MOST: usize = 1 << 16;

/// Resamples by `up / down` with one filter: output m is the filter's output at input m down / up.
///
/// The input may come in pieces of any length. It is extended by its first and last samples. The outputs are bitwise equal
/// for any pieces. Samples must be finite.
#[derive(Debug, Clone)]
pub struct Decimator {
    /// Taps of each phase between two input samples, in the order of the samples, with leading zeros up to a multiple of the
    /// number of lanes.
    phases: Vec<Vec<f64>>,
    up: usize,
    down: usize,
    /// Taps on each side of the middle one.
    half: usize,
    /// Samples that later outputs need. At the start, the first sample is repeated for a whole row of taps.
    held: Vec<f64>,
    /// Number of dropped samples.
    given_up: usize,
    /// Number of computed outputs.
    made: usize,
}

impl Decimator {
    /// A filter with these taps at `up` times the input's rate; the middle tap is at the output's time, and the gain is the
    /// taps' sum.
    ///
    /// # Errors
    /// Unless the number of taps is odd, they are finite, and `up` and `down` are positive and not too large.
    pub fn new(taps: &[f64], up: usize, down: usize) -> Result<Self> {
        require(taps.len() % 2 == 1, || {
            format!("taps: found {} of them, expected an odd number", taps.len())
        })?;
        require(taps.iter().all(|tap| tap.is_finite()), || {
            "taps: found one that is not finite, expected finite numbers".to_owned()
        })?;
        require((1..=MOST).contains(&up) && (1..=MOST).contains(&down), || {
            format!("up, down: found {up} and {down}, expected positive numbers up to {MOST}")
        })?;
        let length = taps.len().div_ceil(up).next_multiple_of(LANES);
        let phases = (0..up)
            .map(|phase| {
                let mut row: Vec<f64> =
                    taps.iter().skip(phase).step_by(up).map(|tap| tap * up as f64).collect();
                row.resize(length, 0.0);
                row.reverse();
                row
            })
            .collect();
        Ok(Self { phases, up, down, half: taps.len() / 2, held: Vec::new(), given_up: 0, made: 0 })
    }

    /// Return the outputs that the next piece completes.
    ///
    /// # Errors
    /// After a request to stop; the filter must not be used after it.
    pub fn feed(&mut self, piece: &[f64], stop: &Stop) -> Result<Vec<f64>> {
        let Some(&first) = piece.first() else { return Ok(Vec::new()) };
        if self.held.is_empty() {
            self.held.resize(self.phases[0].len(), first);
        }
        reserve(&mut self.held, piece.len())?;
        self.held.extend_from_slice(piece);
        self.make(usize::MAX, stop)
    }

    /// Return the remaining outputs, `total` since the start; the input is extended by its last sample.
    ///
    /// # Errors
    /// After a request to stop, without any sample, or for outputs beyond the filter's reach after the last sample.
    pub fn finish(&mut self, total: usize, stop: &Stop) -> Result<Vec<f64>> {
        let Some(&last) = self.held.last() else {
            return Err(Error::Invalid("samples: none were fed, expected at least one".to_owned()));
        };
        // The last sample is repeated for the filter's length plus one output; further outputs would be the same.
        let row = self.phases[0].len();
        let samples = self.given_up + self.held.len() - row;
        let most = (samples + row).saturating_mul(self.up) / self.down + 1;
        require(total <= most, || {
            format!(
                "total: found {total} outputs of {samples} samples, expected up to {most}; feed all samples first"
            )
        })?;
        let end = self.end_of(total).saturating_sub(self.given_up);
        let missing = end.saturating_sub(self.held.len());
        reserve(&mut self.held, missing)?;
        self.held.resize(self.held.len() + missing, last);
        self.make(total, stop)
    }

    /// One past the index of the newest sample that an output needs, including the copies of the first sample.
    #[inline]
    fn end_of(&self, output: usize) -> usize {
        (output * self.down + self.half) / self.up + 1 + self.phases[0].len()
    }

    /// Compute all outputs of which the samples are present, up to `total`, and drop samples that no later output needs.
    fn make(&mut self, total: usize, stop: &Stop) -> Result<Vec<f64>> {
        let result = arch().dispatch(Outputs { filter: self, total, stop })?;
        self.made += result.len();
        let begin = self.end_of(self.made) - self.phases[0].len();
        // The last sample is kept, since it may have to be repeated.
        let done = (begin - self.given_up).min(self.held.len() - 1);
        self.held.drain(..done);
        self.given_up += done;
        Ok(result)
    }
}

/// The outputs that can be computed; compiled for each instruction set.
struct Outputs<'a> {
    filter: &'a Decimator,
    total: usize,
    stop: &'a Stop,
}

impl WithSimd for Outputs<'_> {
    type Output = Result<Vec<f64>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<Vec<f64>> {
        let Self { filter, total, stop } = self;
        let mut result = Vec::new();
        let mut read = 0;
        for output in filter.made..total {
            let taps = &filter.phases[(output * filter.down + filter.half) % filter.up];
            let end = filter.end_of(output) - filter.given_up;
            let Some(samples) = filter.held.get(end - taps.len()..end) else { break };
            result.push(dot(taps, samples));
            read += taps.len();
            if read >= CHECK_EVERY {
                stop.check()?;
                read = 0;
            }
        }
        Ok(result)
    }
}

/// Dot product of two slices whose length is a multiple of the lanes.
#[inline(always)]
fn dot(taps: &[f64], samples: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    for (row, column) in taps.as_chunks::<LANES>().0.iter().zip(samples.as_chunks::<LANES>().0) {
        // By index: an iterator would keep the sums in memory, three times slower.
        #[allow(clippy::needless_range_loop)]
        for lane in 0..LANES {
            sums[lane] += row[lane] * column[lane];
        }
    }
    let mut eight = [0.0; 8];
    for lane in 0..LANES / 4 {
        eight[lane] = (sums[lane] + sums[lane + 8]) + (sums[lane + 16] + sums[lane + 24]);
    }
    eight.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn filtered(taps: &[f64], up: usize, down: usize, pieces: &[&[f64]], total: usize) -> Vec<f64> {
        let mut filter = Decimator::new(taps, up, down).unwrap();
        let mut result = Vec::new();
        for piece in pieces {
            result.extend(filter.feed(piece, &Stop::new()).unwrap());
        }
        result.truncate(total);
        if result.len() < total {
            result.extend(filter.finish(total, &Stop::new()).unwrap());
        }
        result
    }

    /// Zeros inserted between samples, then a direct convolution.
    fn reference(taps: &[f64], up: usize, down: usize, samples: &[f64], total: usize) -> Vec<f64> {
        let half = (taps.len() / 2).cast_signed();
        let (up_, last) = (up.cast_signed(), samples.len().cast_signed() - 1);
        (0..total.cast_signed())
            .map(|output| {
                let centre = output * down.cast_signed();
                (-half..=half)
                    .filter(|shift| (centre + shift).rem_euclid(up_) == 0)
                    .map(|shift| {
                        let sample = samples[(centre + shift).div_euclid(up_).clamp(0, last).cast_unsigned()];
                        up as f64 * taps[(half - shift).cast_unsigned()] * sample
                    })
                    .sum()
            })
            .collect()
    }

    proptest! {
        #[test]
        fn any_pieces_give_the_same_bits_and_every_tap_counts(
            samples in prop::collection::vec(-1.0..1.0, 1..200),
            half in prop::collection::vec(-1.0..1.0, 1..30),
            up in 1..5_usize,
            down in 1..7_usize,
            cuts in prop::collection::vec(0..200_usize, 0..5),
        ) {
            let taps: Vec<f64> = half.iter().chain(half.iter().rev().skip(1)).copied().collect();
            let total = samples.len() * up / down + 1;
            let whole = filtered(&taps, up, down, &[&samples], total);
            let mut cuts: Vec<usize> = cuts.into_iter().filter(|&cut| cut < samples.len()).collect();
            cuts.extend([0, samples.len()]);
            cuts.sort_unstable();
            let pieces: Vec<&[f64]> = cuts.windows(2).map(|pair| &samples[pair[0]..pair[1]]).collect();
            prop_assert_eq!(&filtered(&taps, up, down, &pieces, total), &whole);
            for (ours, theirs) in whole.iter().zip(reference(&taps, up, down, &samples, total)) {
                prop_assert!((ours - theirs).abs() < 1e-10, "{} {}", ours, theirs);
            }
        }
    }

    #[test]
    fn filters_that_have_no_middle_are_refused() {
        assert!(Decimator::new(&[0.5, 0.5], 1, 2).unwrap_err().to_string().contains("found 2 of them"));
        assert!(Decimator::new(&[1.0], 0, 2).unwrap_err().to_string().contains("found 0 and 2"));
        assert!(Decimator::new(&[1.0], 1, 1).unwrap().finish(1, &Stop::new()).is_err());
    }
}
