//! Sample types of raw logs, and their comparison with two thresholds as bit masks.

/// Samples that are compared together: a bit of a word each.
pub(super) const BLOCK: usize = u64::BITS as usize;

/// The largest f64 that counts as measured; larger ones are saturated.
pub(super) const LARGEST: f64 = f64::MAX / 4.0;

/// A type in which loggers store samples.
pub trait Sample: Copy + PartialOrd + Into<f64> + Send + Sync {
    /// The type's name, for messages.
    const NAME: &str;
    /// Lower limit of measured values, so that their differences are finite; lower ones are saturated.
    const LEAST: Self;
    /// Upper limit of measured values.
    const MOST: Self;
    /// The least value at or above `level`, so that `x >= value` is equivalent to `x >= level`.
    fn at_or_above(level: f64) -> Option<Self>;
    /// The greatest value at or below `level`.
    fn at_or_below(level: f64) -> Option<Self>;
    /// Whether the sample is missing.
    fn is_gap(self) -> bool;
}

impl Sample for f64 {
    const NAME: &str = "float64";
    const LEAST: Self = -LARGEST;
    const MOST: Self = LARGEST;
    fn at_or_above(level: f64) -> Option<Self> {
        Some(level)
    }
    fn at_or_below(level: f64) -> Option<Self> {
        Some(level)
    }
    #[inline]
    fn is_gap(self) -> bool {
        self.is_nan()
    }
}

#[allow(clippy::cast_possible_truncation)] // rounding is corrected below
impl Sample for f32 {
    const NAME: &str = "float32";
    const LEAST: Self = Self::MIN;
    const MOST: Self = Self::MAX;
    fn at_or_above(level: f64) -> Option<Self> {
        let nearest = level as Self;
        Some(if f64::from(nearest) < level { nearest.next_up() } else { nearest })
    }
    fn at_or_below(level: f64) -> Option<Self> {
        let nearest = level as Self;
        Some(if f64::from(nearest) > level { nearest.next_down() } else { nearest })
    }
    #[inline]
    fn is_gap(self) -> bool {
        self.is_nan()
    }
}

#[allow(clippy::cast_possible_truncation)] // within the checked range
impl Sample for i16 {
    const NAME: &str = "int16";
    const LEAST: Self = Self::MIN;
    const MOST: Self = Self::MAX;
    fn at_or_above(level: f64) -> Option<Self> {
        let whole = level.ceil();
        (f64::from(Self::MIN)..=f64::from(Self::MAX)).contains(&whole).then_some(whole as Self)
    }
    fn at_or_below(level: f64) -> Option<Self> {
        let whole = level.floor();
        (f64::from(Self::MIN)..=f64::from(Self::MAX)).contains(&whole).then_some(whole as Self)
    }
    #[inline]
    fn is_gap(self) -> bool {
        false
    }
}

/// Bit k of each word belongs to sample k of a block.
#[derive(Clone, Copy)]
pub(super) struct Masks {
    /// At or below the low threshold.
    pub low: u64,
    /// At or above the high threshold.
    pub high: u64,
    /// Missing.
    pub gap: u64,
}

impl Masks {
    /// Compare a block with both thresholds.
    ///
    /// Two implementations. With mask registers (AVX-512) the compiler turns shifts of single bits into compares; without
    /// them it does not, and gathering bytes by a multiplication is twice as fast.
    #[allow(clippy::inline_always)] // compiled for the caller's instruction set
    #[inline(always)]
    pub fn of<T: Sample, const MASK_REGISTERS: bool>(block: &[T; BLOCK], low: T, high: T) -> Self {
        let low = word::<T, MASK_REGISTERS>(block, |x| x <= low);
        let high = word::<T, MASK_REGISTERS>(block, |x| x >= high);
        let gap = if any_gap(block) { word::<T, MASK_REGISTERS>(block, T::is_gap) } else { 0 };
        Self { low, high, gap }
    }

    /// The first `count` samples only.
    pub fn first(self, count: usize) -> Self {
        let valid = (1_u64 << count) - 1;
        Self { low: self.low & valid, high: self.high & valid, gap: self.gap & valid }
    }
}

/// Whether any sample is missing; one comparison tests two samples.
#[allow(clippy::inline_always)]
#[inline(always)]
fn any_gap<T: Sample>(block: &[T; BLOCK]) -> bool {
    let (front, back) = block.split_at(BLOCK / 2);
    front.iter().zip(back).fold(false, |any, (&x, &y)| any | (x.is_gap() | y.is_gap()))
}

/// Results of a test of all samples of a block, as bits of one word.
#[allow(clippy::inline_always)]
#[inline(always)]
fn word<T: Sample, const MASK_REGISTERS: bool>(block: &[T; BLOCK], test: impl Fn(T) -> bool) -> u64 {
    if MASK_REGISTERS { shifted(block, test) } else { gathered(block, test) }
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn shifted<T: Sample>(block: &[T; BLOCK], test: impl Fn(T) -> bool) -> u64 {
    let mut word = 0;
    for (k, &x) in block.iter().enumerate() {
        word |= u64::from(test(x)) << k;
    }
    word
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn gathered<T: Sample>(block: &[T; BLOCK], test: impl Fn(T) -> bool) -> u64 {
    let mut bytes = [0_u8; BLOCK];
    for (byte, &x) in bytes.iter_mut().zip(block) {
        *byte = u8::from(test(x));
    }
    let mut word = 0;
    for (k, eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
        // Each factor bit moves one byte's lowest bit to its position in the top byte, without collisions.
        word |= (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * k);
    }
    word
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_decide_in_the_sample_type_as_they_would_in_f64() {
        let level = 0.1;
        for x in [0.1_f32, 0.1_f32.next_up(), 0.1_f32.next_down()] {
            assert_eq!(x >= f32::at_or_above(level).unwrap(), f64::from(x) >= level);
            assert_eq!(x <= f32::at_or_below(level).unwrap(), f64::from(x) <= level);
        }
        assert_eq!(i16::at_or_above(0.5), Some(1));
        assert_eq!(i16::at_or_below(-0.5), Some(-1));
        assert_eq!(i16::at_or_above(32_767.5), None);
        assert_eq!(i16::at_or_below(-32_768.5), None);
    }

    #[test]
    fn both_ways_to_the_masks_agree() {
        let block: [f64; BLOCK] = std::array::from_fn(|k| match k % 7 {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::NEG_INFINITY,
            r => r as f64,
        });
        let one = Masks::of::<f64, true>(&block, 3.0, 5.0);
        let other = Masks::of::<f64, false>(&block, 3.0, 5.0);
        assert_eq!((one.low, one.high, one.gap), (other.low, other.high, other.gap));
        assert_eq!(one.gap & 0xff, 0b1000_0001);
        assert_eq!(one.high & 0x7f, 0b110_0010);
        assert_eq!(one.low & 0x7f, 0b000_1100);
    }
}
