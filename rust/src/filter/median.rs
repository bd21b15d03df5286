//! Running median by sorting blocks.
//!
//! J. Suomela, "Median filtering is equivalent to sorting", arXiv:1406.1717. The signal is cut into blocks of a window's
//! length, and each block is sorted once. A window over two blocks is the end of the first and the beginning of the second.
//! Both blocks are linked lists in order of size. All samples of the second are removed in reverse order of time beforehand.
//! As the window moves, the next sample of the first block is removed from its list, and the next sample of the second
//! block is reinserted, which undoes its removal. Only sorting takes more than a constant number of steps per sample, and
//! a block fits into the cache.
//!

use crate::error::{Result, require};
use crate::memory::reserve;
use crate::stop::{CHECK_EVERY, Stop};

/// Longest window [samples] that is allowed for any signal; for a longer signal, up to four times its length.
const LONGEST: usize = 1 << 20;
/// Number of samples that are sorted between two checks for a request to stop.
const PIECE: usize = 1 << 18;

/// Median of the `window` samples around each one, the signal reflected at its ends (d c b a | a b c d | d c b a).
///
/// NaN counts as greater than every number.
///
/// # Errors
/// If `window` is even, longer than 2^31 or much longer than the signal; if memory is insufficient; or after a request to
/// stop.
pub fn running_median(samples: &[f64], window: usize, stop: &Stop) -> Result<Vec<f64>> {
    require(window % 2 == 1 && u32::try_from(window).is_ok_and(|window| window < 1 << 31), || {
        format!("window: found {window}, expected an odd number of samples")
    })?;
    let most = LONGEST.max(4 * samples.len());
    require(window <= most, || {
        format!("window: found {window} for {} samples, expected up to {most}", samples.len())
    })?;
    if samples.is_empty() || window == 1 {
        return Ok(samples.to_vec());
    }
    let (count, half) = (samples.len(), window / 2);
    // Reflected sample, `index` samples after the beginning of the first window.
    let at = |index: usize| {
        let place = (index + 2 * count * half.div_ceil(2 * count) - half) % (2 * count);
        samples[if place < count { place } else { 2 * count - 1 - place }]
    };
    let mut result = Vec::new();
    reserve(&mut result, count + window)?;
    // The leaving and the entering block swap roles at each block.
    let mut blocks = [Block::new(window)?, Block::new(window)?];
    blocks[0].sort((0..window).map(at), stop)?;
    result.push(number(blocks[0].least_large()));
    let mut start = window;
    while result.len() < count {
        stop.check()?;
        if start >= half && start + window <= half + count {
            blocks[1].sort(samples[start - half..][..window].iter().copied(), stop)?;
        } else {
            blocks[1].sort((start..start + window).map(at), stop)?;
        }
        stop.check()?;
        blocks[1].take_all_out();
        let [leaving, entering] = &mut blocks;
        for index in 0..window {
            if index % CHECK_EVERY == 0 {
                stop.check()?;
            }
            leaving.take_out(index);
            entering.put_back(index);
            if leaving.small + entering.small < half {
                // Which list advances is random, so a branch would be mispredicted: both are updated, one of them to its
                // present value.
                let from_leaving = leaving.least_large() <= entering.least_large();
                leaving.advance_if(from_leaving);
                entering.advance_if(!from_leaving);
            }
            result.push(number(leaving.least_large().min(entering.least_large())));
        }
        blocks.swap(0, 1);
        start += window;
    }
    result.truncate(count);
    Ok(result)
}

/// Samples of a block as a linked list in order of size, divided into small and large ones.
struct Block {
    /// Keys in order, with the index in their last bits: one word sorts much faster than two.
    order: Vec<u64>,
    /// Key of each index; the largest key past the last.
    keys: Vec<u64>,
    /// Links of each index; the links past the last index are both ends of the list.
    links: Vec<Link>,
    /// Index of the smallest of the large samples.
    middle: u32,
    /// Number of small samples.
    small: usize,
}

/// Position of a sample in the list.
#[derive(Clone, Copy, Default)]
struct Link {
    next: u32,
    previous: u32,
    /// Rank in the whole block.
    rank: u32,
}

#[allow(clippy::cast_possible_truncation)] // the window was checked
impl Block {
    fn new(window: usize) -> Result<Self> {
        let end = Link { rank: window as u32, ..Link::default() };
        let (mut order, mut keys, mut links) = (Vec::new(), Vec::new(), Vec::new());
        reserve(&mut order, window)?;
        reserve(&mut keys, window + 1)?;
        reserve(&mut links, window + 1)?;
        keys.resize(window + 1, u64::MAX);
        links.resize(window + 1, end);
        Ok(Self { order, keys, links, middle: 0, small: 0 })
    }

    /// Sort the samples into the list. The samples below the median, `window / 2` of them, count as small.
    fn sort(&mut self, samples: impl ExactSizeIterator<Item = f64>, stop: &Stop) -> Result<()> {
        let window = samples.len();
        let places = window.next_power_of_two() as u64 - 1;
        self.order.clear();
        for (place, (key, value)) in self.keys.iter_mut().zip(samples).enumerate() {
            *key = ordered(value);
            self.order.push(*key & !places | place as u64);
        }
        for piece in self.order.chunks_mut(PIECE) {
            stop.check()?;
            piece.sort_unstable();
        }
        stop.check()?;
        if window > PIECE {
            #[allow(clippy::stable_sort_primitive)] // it merges sorted runs
            self.order.sort();
        }
        let keys = &self.keys;
        for alike in self.order.chunk_by_mut(|a, b| a & !places == b & !places) {
            if alike.len() > 1 {
                alike.sort_unstable_by_key(|word| keys[(word & places) as usize]);
            }
        }
        stop.check()?;
        let end = window as u32;
        let mut last = end;
        for (word, rank) in self.order.iter().zip(0..) {
            let place = (word & places) as u32;
            self.links[last as usize].next = place;
            self.links[place as usize].previous = last;
            self.links[place as usize].rank = rank;
            last = place;
        }
        self.links[last as usize].next = end;
        self.links[end as usize].previous = last;
        self.small = window / 2;
        self.middle = (self.order[self.small] & places) as u32;
        Ok(())
    }

    /// Empty the list in reverse order of time, so that `put_back` in order of time undoes it.
    fn take_all_out(&mut self) {
        let end = self.links.len() - 1;
        for place in (0..end).rev() {
            self.unlink(place);
        }
        self.middle = end as u32;
        self.small = 0;
    }

    #[inline]
    fn unlink(&mut self, place: usize) {
        let Link { next, previous, .. } = self.links[place];
        self.links[previous as usize].next = next;
        self.links[next as usize].previous = previous;
    }

    #[inline]
    fn is_small(&self, place: usize) -> bool {
        self.links[place].rank < self.links[self.middle as usize].rank
    }

    /// Remove a sample from the list; if it counted as small, the least large sample becomes small.
    #[inline]
    fn take_out(&mut self, place: usize) {
        let is_small = self.is_small(place);
        self.unlink(place);
        if self.small > 0 {
            // The links of the removed sample still show its predecessor.
            let before = self.links[self.middle as usize].previous;
            self.middle = if is_small { self.middle } else { before };
            self.small -= 1;
        } else if self.middle as usize == place {
            self.middle = self.links[place].next;
        }
    }

    /// Reinsert a sample; the number of small samples is constant, so if the new one is small, the greatest small one
    /// becomes large.
    #[inline]
    fn put_back(&mut self, place: usize) {
        let Link { next, previous, .. } = self.links[place];
        self.links[previous as usize].next = place as u32;
        self.links[next as usize].previous = place as u32;
        let before = self.links[self.middle as usize].previous;
        self.middle = if self.is_small(place) { before } else { self.middle };
    }

    #[inline]
    fn advance_if(&mut self, wanted: bool) {
        let next = self.links[self.middle as usize].next;
        self.middle = if wanted { next } else { self.middle };
        self.small += usize::from(wanted);
    }

    #[inline]
    fn least_large(&self) -> u64 {
        self.keys[self.middle as usize]
    }
}

/// Map a number to an integer of the same order, NaN above infinity; the greatest integer is unused.
#[inline]
const fn ordered(value: f64) -> u64 {
    let bits = value.to_bits();
    if value.is_nan() {
        u64::MAX - 1
    } else if bits >> 63 == 1 {
        !bits
    } else {
        bits | 1 << 63
    }
}

/// Inverse of this map.
#[inline]
const fn number(key: u64) -> f64 {
    if key == u64::MAX - 1 {
        f64::NAN
    } else if key >> 63 == 1 {
        f64::from_bits(key & !(1 << 63))
    } else {
        f64::from_bits(!key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sort every window.
    fn reference(samples: &[f64], window: usize) -> Vec<f64> {
        let (count, half) = (samples.len().cast_signed(), (window / 2).cast_signed());
        (0..count)
            .map(|middle| {
                let mut values: Vec<f64> = (middle - half..=middle + half)
                    .map(|index| {
                        let place = index.rem_euclid(2 * count);
                        samples[place.min(2 * count - 1 - place).cast_unsigned()]
                    })
                    .collect();
                values.sort_by(f64::total_cmp);
                values[half.cast_unsigned()]
            })
            .collect()
    }

    proptest! {
        #[test]
        fn every_window_has_its_median(
            samples in prop::collection::vec(prop_oneof![-3.0..3.0, Just(0.0), Just(1.0), Just(f64::INFINITY), Just(f64::NAN)], 1..400),
            half in 0..60_usize,
        ) {
            let window = 2 * half + 1;
            let ours = running_median(&samples, window, &Stop::new()).unwrap();
            let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&ours), bits(&reference(&samples, window)));
        }
    }

    #[test]
    fn windows_are_odd_and_signals_may_be_empty() {
        assert!(running_median(&[1.0], 2, &Stop::new()).unwrap_err().to_string().contains("found 2"));
        assert!(running_median(&[], 3, &Stop::new()).unwrap().is_empty());
    }
}
