//! Stretches that a channel holds twice. A print is a hash of successive samples; prints that recur in the same order show
//! a copy.

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::instruction_set::arch;
use crate::stop::Stop;

/// Samples in a print.
const TAPS: usize = 8;
/// Only prints that begin with so many zero bits are kept, one in 16, about 7 in 128 samples. Both copies keep the same.
const KEPT_BITS: u32 = 4;
/// Prints in a row that must recur at one distance before the samples themselves are compared.
const PRINTS: usize = 2;
/// Longest stretch that a logger may write twice [samples]; its buffer.
const LONGEST: u64 = 1 << 20;
/// Samples whose prints are made at once.
const BATCH: usize = 1024;
/// Odd factors without a pattern. Factors that are multiples of each other would make prints of rounded signals collide.
const MIX: [u64; TAPS] = [
    0x9e37_79b9_7f4a_7c15,
    0xbf58_476d_1ce4_e5b9,
    0x94d0_49bb_1331_11eb,
    0xd6e8_feb8_6659_fd93,
    0xa076_1d64_78bd_642f,
    0xe703_7ed1_a0b4_28db,
    0x8ebc_6af0_9c88_c6e3,
    0x5899_65cc_7537_4cc3,
];

/// Prints of a channel's samples, fed in chunks of any length with the same answer.
#[derive(Debug, Clone, Default)]
pub struct RepeatScan {
    /// Bits of the last samples, which the next ones complete to prints.
    held: Vec<u32>,
    /// Place of the first sample held.
    at: u64,
    /// The prints kept, each with the place of its first sample.
    prints: Vec<(u64, u64)>,
}

impl RepeatScan {
    /// A scan that has seen nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Take the next samples.
    ///
    /// # Errors
    /// On a stop; the scan must not be used after it.
    pub fn feed(&mut self, samples: &[f32], stop: &Stop) -> Result<()> {
        for batch in samples.chunks(BATCH) {
            stop.check()?;
            self.held.extend(batch.iter().map(|sample| sample.to_bits()));
            let Some(count) = self.held.len().checked_sub(TAPS) else { continue };
            let mut prints = [0; BATCH + TAPS];
            arch().dispatch(Print { bits: &self.held, prints: &mut prints[..count] });
            for ((place, &print), pair) in (self.at..).zip(&prints[..count]).zip(self.held.windows(2)) {
                // Where nothing changes every print is the same and tells nothing.
                if print >> (u64::BITS - KEPT_BITS) == 0 && pair[0] != pair[1] {
                    self.prints.push((print, place));
                }
            }
            self.held.drain(..count);
            self.at += count as u64;
        }
        Ok(())
    }

    /// Places and distances at which prints recur in a row: the first copy's sample, and how much later the second is.
    #[must_use]
    pub fn candidates(&self) -> Vec<(u64, u64)> {
        let mut sorted = self.prints.clone();
        sorted.sort_unstable();
        let mut pairs: Vec<(u64, u64)> = sorted
            .windows(2)
            .filter(|pair| pair[0].0 == pair[1].0 && pair[1].1 - pair[0].1 <= LONGEST)
            .map(|pair| (pair[1].1 - pair[0].1, pair[0].1))
            .collect();
        pairs.sort_unstable();
        pairs
            // Prints of one repetition stand a lag or less apart: it is no longer than that.
            .chunk_by(|one, next| one.0 == next.0 && next.1 - one.1 <= one.0)
            .filter(|run| run.len() >= PRINTS)
            .map(|run| (run[0].1, run[0].0))
            .collect()
    }
}

/// Sums of products of the bits of each sample and those after it; compiled once for each instruction set.
struct Print<'a> {
    bits: &'a [u32],
    prints: &'a mut [u64],
}

impl WithSimd for Print<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { bits, prints } = self;
        let count = prints.len();
        for (k, mix) in MIX.iter().enumerate() {
            for (print, &bits) in prints.iter_mut().zip(&bits[k..][..count]) {
                *print = print.wrapping_add(mix.wrapping_mul(u64::from(bits)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(count: u32) -> Vec<f32> {
        (0..count).map(|k| (k.wrapping_mul(2_654_435_761) >> 16) as f32).collect()
    }

    fn scanned(chunks: &[&[f32]]) -> Vec<(u64, u64)> {
        let mut scan = RepeatScan::new();
        for chunk in chunks {
            scan.feed(chunk, &Stop::new()).unwrap();
        }
        scan.candidates()
    }

    #[test]
    fn a_stretch_written_twice_is_found_at_its_distance_however_it_is_fed() {
        let once = noise(5000);
        let twice = [&once[..3000], &once[1000..]].concat();
        let found = scanned(&[&twice]);
        assert_eq!(found.len(), 1);
        assert!(found[0].1 == 2000 && (1000..1200).contains(&found[0].0), "{found:?}");
        assert_eq!(scanned(&[&twice[..7], &twice[7..7], &twice[7..2999], &twice[2999..]]), found);
    }

    #[test]
    fn what_never_recurs_and_what_never_changes_tell_nothing() {
        assert!(scanned(&[&noise(5000)]).is_empty());
        assert!(scanned(&[&vec![2.5; 5000]]).is_empty());
        assert!(scanned(&[]).is_empty());
    }
}
