//! Detection of repeated stretches in a channel by fingerprints: hashes of successive samples, which recur in the same order
//! in a copy.

use std::collections::HashMap;

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::instruction_set::arch;
use crate::stop::Stop;

/// Samples per fingerprint ("print").
const TAPS: usize = 8;
/// Number of leading bits that are zero in each kept fingerprint. One fingerprint in 16 is kept, about 7 in 128 samples.
/// Both copies of a repeated stretch keep equal fingerprints.
const KEPT_BITS: u32 = 4;
/// Successive fingerprints that must recur at the same distance before the samples are compared.
const PRINTS: usize = 2;
/// Longest stretch that a logger may repeat [samples]: the size of its buffer.
const LONGEST: u64 = 1 << 20;
/// Samples whose fingerprints are computed together.
const BATCH: usize = 1024;
/// Samples after which fingerprints are compared with each other and those of the previous `LONGEST` samples, then dropped.
const COMPARED: u64 = 4 * LONGEST;
/// Odd factors without a pattern. If factors were multiples of each other, fingerprints of rounded signals would collide.
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

/// Fingerprints of a channel, fed in chunks of any length with the same result. Only the list of results grows with the
/// number of samples.
#[derive(Debug, Clone, Default)]
pub struct RepeatScan {
    /// Bits of the last samples; the fingerprints of these samples cannot be computed before later samples arrive.
    held: Vec<u32>,
    /// Index of the first sample in `held`.
    at: u64,
    /// Kept fingerprints, each with the index of its first sample.
    prints: Vec<(u64, u64)>,
    /// Index from which fingerprints have not been compared with earlier ones.
    compared_to: u64,
    /// Open runs by distance.
    open: HashMap<u64, Run>,
    /// Distance and start index of complete runs that are long enough.
    found: Vec<(u64, u64)>,
}

/// Run of fingerprints that recur at the same distance: indices of the first and last, and their number.
#[derive(Debug, Clone, Copy)]
struct Run {
    first: u64,
    last: u64,
    prints: usize,
}

impl RepeatScan {
    /// A scan before its first sample.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Add the next samples.
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
                // In a constant stretch all fingerprints are equal and indicate no repetition.
                if print >> (u64::BITS - KEPT_BITS) == 0 && pair[0] != pair[1] {
                    self.prints.push((print, place));
                }
            }
            self.held.drain(..count);
            self.at += count as u64;
            if self.at - self.compared_to >= COMPARED {
                self.compare();
            }
        }
        Ok(())
    }

    /// Start index of the first copy, and distance from it to the second copy, for each run of recurring fingerprints.
    #[must_use]
    pub fn candidates(&self) -> Vec<(u64, u64)> {
        let mut whole = self.clone();
        whole.compare();
        whole.found.extend(
            whole.open.iter().filter(|run| run.1.prints >= PRINTS).map(|(&lag, run)| (lag, run.first)),
        );
        whole.found.sort_unstable();
        whole.found.into_iter().map(|(lag, place)| (place, lag)).collect()
    }

    /// Add the pairs of the newest fingerprints to the runs, and drop fingerprints that no later one can match.
    fn compare(&mut self) {
        self.prints.sort_unstable();
        let mut pairs: Vec<(u64, u64)> = self
            .prints
            .windows(2)
            .filter(|pair| {
                pair[0].0 == pair[1].0 && pair[1].1 - pair[0].1 <= LONGEST && pair[1].1 >= self.compared_to
            })
            .map(|pair| (pair[1].1 - pair[0].1, pair[0].1))
            .collect();
        pairs.sort_unstable();
        for (lag, place) in pairs {
            let run = self.open.entry(lag).or_insert(Run { first: place, last: place, prints: 0 });
            // Hashes of one repetition are at most `lag` apart, since a repetition has at most that length.
            if place - run.last > lag {
                self.found.extend((run.prints >= PRINTS).then_some((lag, run.first)));
                *run = Run { first: place, last: place, prints: 0 };
            }
            run.last = place;
            run.prints += 1;
        }
        let at = self.at;
        let found = &mut self.found;
        self.open.retain(|&lag, run| {
            let goes_on = run.last + 2 * lag >= at;
            found.extend((!goes_on && run.prints >= PRINTS).then_some((lag, run.first)));
            goes_on
        });
        self.prints.retain(|print| print.1 + LONGEST >= at);
        self.compared_to = at;
    }
}

/// Sums of products of the bits of each sample and the following ones; compiled for each instruction set.
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

    fn noise(count: usize) -> Vec<f32> {
        let mixed = |k: u64| (k.wrapping_mul(MIX[0]) ^ (k.wrapping_mul(MIX[0]) >> 29)).wrapping_mul(MIX[2]);
        (0..count as u64).map(|k| (mixed(k) >> 48) as f32).collect()
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
    fn prints_are_given_up_and_what_recurs_is_found_wherever_it_is() {
        let near = usize::try_from(COMPARED).unwrap();
        let once = noise(near + 5000);
        for begin in [near - 1000, near + 100] {
            let mut scan = RepeatScan::new();
            let twice = [&once[..begin + 3000], &once[begin + 1000..]].concat();
            for chunk in twice.chunks(100_003) {
                scan.feed(chunk, &Stop::new()).unwrap();
            }
            let found = scan.candidates();
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(
                found[0].1 == 2000 && (begin as u64 + 1000..begin as u64 + 1200).contains(&found[0].0),
                "{found:?}"
            );
            assert!(scan.prints.len() as u64 <= (COMPARED + 2 * LONGEST) / 8, "{}", scan.prints.len());
        }
    }

    #[test]
    fn what_never_recurs_and_what_never_changes_tell_nothing() {
        assert!(scanned(&[&noise(5000)]).is_empty());
        assert!(scanned(&[&vec![2.5; 5000]]).is_empty());
        assert!(scanned(&[]).is_empty());
    }
}
