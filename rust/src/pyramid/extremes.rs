//! Least and greatest finite sample of blocks of equal length, for samples in chunks of any length.

use multiversion::multiversion;

use super::Gaps;
use crate::error::{Result, require};
use crate::pulse::Sample;
use crate::stop::{CHECK_EVERY, Stop};

/// Lanes that are compared in parallel; a block has several vectors of them.
const LANES: usize = 16;

/// Least and greatest of a block; both NaN if no sample is finite.
pub type Pair = [f64; 2];

const NONE: Pair = [f64::NAN, f64::NAN];

/// Extremes of a channel's blocks; infinite samples count as missing.
#[derive(Debug, Clone)]
pub struct Extremes {
    block: usize,
    /// Extremes of the incomplete block.
    begun: Pair,
    filled: usize,
    seen: u64,
    gaps: Gaps,
}

impl Extremes {
    /// Extremes of blocks of `block` samples.
    ///
    /// # Errors
    /// If the block is empty.
    pub fn new(block: usize) -> Result<Self> {
        require(block > 0, || "block: found 0, expected at least 1 sample".to_owned())?;
        Ok(Self { block, begun: NONE, filled: 0, seen: 0, gaps: Gaps::default() })
    }

    /// Add the next samples and return the completed blocks.
    ///
    /// # Errors
    /// On a stop; no more samples must be fed after it.
    pub fn feed<T: Sample>(&mut self, samples: &[T], stop: &Stop) -> Result<Vec<Pair>> {
        let mut found = Vec::with_capacity((self.filled + samples.len()) / self.block);
        let first = samples.len().min((self.block - self.filled) % self.block);
        let (head, rest) = samples.split_at(first);
        self.take(head, &mut found);
        for piece in rest.chunks(self.block * (CHECK_EVERY / self.block).max(1)) {
            stop.check()?;
            self.whole(piece, &mut found);
        }
        Ok(found)
    }

    /// The last, incomplete block, if any.
    pub fn finish(&mut self) -> Option<Pair> {
        self.gaps.close();
        let left = self.filled > 0;
        self.filled = 0;
        left.then(|| std::mem::replace(&mut self.begun, NONE))
    }

    /// Number of samples so far.
    #[must_use]
    pub const fn seen(&self) -> u64 {
        self.seen
    }

    /// Stretches of missing samples.
    #[must_use]
    pub const fn gaps(&self) -> &Gaps {
        &self.gaps
    }

    /// Process samples from the start of a block.
    fn whole<T: Sample>(&mut self, mut samples: &[T], found: &mut Vec<Pair>) {
        loop {
            let taken = self.block * finite_blocks(samples, self.block, found);
            self.seen += taken as u64;
            let rest = &samples[taken..];
            let (odd, after) = rest.split_at(self.block.min(rest.len()));
            self.take(odd, found);
            if after.is_empty() {
                break;
            }
            samples = after;
        }
    }

    /// Process samples one by one, with a check for gaps.
    fn take<T: Sample>(&mut self, samples: &[T], found: &mut Vec<Pair>) {
        for &sample in samples {
            let value: f64 = sample.into();
            if value.is_finite() {
                self.begun = [self.begun[0].min(value), self.begun[1].max(value)];
            } else {
                self.gaps.missing(self.seen);
            }
            self.seen += 1;
            self.filled += 1;
            if self.filled == self.block {
                found.push(std::mem::replace(&mut self.begun, NONE));
                self.filled = 0;
            }
        }
    }
}

/// Extremes of whole blocks up to the first one with a sample that is not finite, and their number.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn finite_blocks<T: Sample>(samples: &[T], block: usize, found: &mut Vec<Pair>) -> usize {
    let before = found.len();
    for block in samples.chunks_exact(block) {
        let Some(pair) = of_finite(block) else { break };
        found.push(pair);
    }
    found.len() - before
}

/// Extremes of a block of finite samples; None if a sample is not finite.
#[inline(always)]
fn of_finite<T: Sample>(block: &[T]) -> Option<Pair> {
    let &first = block.first()?;
    let (mut low, mut high, mut missing) = ([first; LANES], [first; LANES], [false; LANES]);
    let (lanes, rest) = block.as_chunks::<LANES>();
    for lane in lanes {
        for k in 0..LANES {
            low[k] = if lane[k] < low[k] { lane[k] } else { low[k] };
            high[k] = if lane[k] > high[k] { lane[k] } else { high[k] };
            missing[k] |= lane[k].is_gap();
        }
    }
    // The extremes of all lanes are combined by vector operations, each of which halves the number of lanes. A loop over
    // single lanes would take as long as the whole block.
    let mut half = LANES;
    while half > 1 {
        half /= 2;
        for k in 0..half {
            low[k] = if low[k + half] < low[k] { low[k + half] } else { low[k] };
            high[k] = if high[k + half] > high[k] { high[k + half] } else { high[k] };
            missing[k] |= missing[k + half];
        }
    }
    let (low, high) = rest.iter().fold((low[0], high[0]), |(low, high), &x| {
        (if x < low { x } else { low }, if x > high { x } else { high })
    });
    let missing = missing[0] || rest.iter().any(|x| x.is_gap());
    let (low, high): (f64, f64) = (low.into(), high.into());
    // Comparisons ignore a NaN, which is therefore tested separately; an infinity appears in the extremes.
    (!missing && low.is_finite() && high.is_finite()).then_some([low, high])
}

/// Extremes of every `factor` pairs, the last group possibly smaller.
///
/// # Errors
/// If the factor is below 2, or after a request to stop.
pub fn coarser(pairs: &[Pair], factor: usize, stop: &Stop) -> Result<Vec<Pair>> {
    require(factor > 1, || format!("factor: found {factor}, expected at least 2"))?;
    stop.check()?;
    Ok(pairs
        .chunks(factor)
        .map(|group| group.iter().fold(NONE, |[low, high], pair| [low.min(pair[0]), high.max(pair[1])]))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plain(samples: &[f32], block: usize) -> Vec<Pair> {
        samples
            .chunks(block)
            .map(|chunk| {
                chunk
                    .iter()
                    .filter(|x| x.is_finite())
                    .fold(NONE, |[low, high], &x| [low.min(f64::from(x)), high.max(f64::from(x))])
            })
            .collect()
    }

    fn bits(pairs: &[Pair]) -> Vec<[u64; 2]> {
        pairs.iter().map(|pair| pair.map(|x| if x.is_nan() { 1 } else { (x + 0.0).to_bits() })).collect()
    }

    proptest! {
        #[test]
        fn any_chunks_give_the_extremes_of_every_block(
            samples in prop::collection::vec(
                prop_oneof![4 => -5.0_f32..5.0, 1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY])],
                0..400,
            ),
            block in 1_usize..40,
            chunk in 1_usize..90,
        ) {
            let mut extremes = Extremes::new(block).unwrap();
            let mut found = Vec::new();
            for part in samples.chunks(chunk) {
                found.extend(extremes.feed(part, &Stop::new()).unwrap());
            }
            found.extend(extremes.finish());
            prop_assert_eq!(bits(&found), bits(&plain(&samples, block)));
            prop_assert_eq!(extremes.seen(), samples.len() as u64);
            let missing: Vec<u64> = extremes.gaps().spans().flat_map(|(first, stop)| first..stop).collect();
            let expected: Vec<u64> =
                (0..).zip(&samples).filter(|(_, x)| !x.is_finite()).map(|(place, _)| place).collect();
            prop_assert_eq!(missing, expected);
        }
    }

    #[test]
    fn a_coarser_level_keeps_the_extremes_and_the_gaps() {
        let pairs = [[1.0, 2.0], NONE, [-3.0, 0.0], NONE, NONE];
        let found = coarser(&pairs, 3, &Stop::new()).unwrap();
        assert_eq!(bits(&found), bits(&[[-3.0, 2.0], NONE]));
        assert!(coarser(&pairs, 1, &Stop::new()).is_err());
    }
}
