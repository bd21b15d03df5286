//! A pulse train with constant levels: they are verified in each window instead of being estimated again.

use std::ops::RangeInclusive;

use multiversion::multiversion;
use multiversion::target::match_target;

use super::sample::{BLOCK, Masks, Sample};
use super::scan::{BATCH, Fires, armed_after, armed_by};
use super::swings;
use super::swings::Level;
use super::thresholds::{Edge, Levels};
use crate::error::Result;
use crate::stop::Stop;

/// Number of samples in a part of a window, and least number of parts in a window. Each part must have at least two
/// pulses.
const PART: usize = 1024;
const LEAST_PARTS: usize = 8;
const LANES: usize = 16;
/// Largest difference of a part's extremes from the usual extremes, in standard deviations of the noise and as a share of
/// the train's height. Extremes of a thousand normal numbers scatter by a third of the numbers' standard deviation.
const PART_LIKE: (f64, f64) = (3.0, 0.05);
/// Largest difference of a window's medians from the usual ones; levels closer than half the noise count as equal.
const WINDOW_LIKE: (f64, f64) = (0.5, 0.002);
/// Largest ratio of the longest period (less one sample) to the shortest in a train without lost or extra pulses.
const EVEN: f64 = 1.5;

/// A pulse train whose levels are constant so far; the next window of samples is compared with them.
#[derive(Debug, Clone, Copy)]
pub struct Steady {
    pub level: Level,
    pub levels: Levels,
    /// Medians of the parts' least and greatest samples.
    pub usual: (f64, f64),
    /// Whether the detector is armed at the start of the next window.
    pub armed: bool,
}

/// Crossings of a window with unchanged levels.
#[derive(Debug, Clone)]
pub struct Held {
    /// Sample at which the detector first fires. Its crossing may be before the window.
    pub first: usize,
    /// The later crossings; for each, the window contains the low sample that armed the detector.
    pub edges: Vec<Edge>,
    /// Whether the detector is armed after the window.
    pub armed: bool,
}

impl Steady {
    /// Start after a window with these levels and block extremes; None if a part's extremes are out of range.
    pub fn after<T: Sample>(
        window: &[T],
        extremes: &[(f64, f64)],
        level: Level,
        levels: Levels,
    ) -> Option<Self> {
        let (low, high) = levels.thresholds::<T>().ok()?;
        let armed = armed_after(window, low, high)?;
        let parts: Vec<(f64, f64)> = extremes
            .chunks_exact(PART / swings::BLOCK)
            .map(|part| {
                part.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), block| {
                    (low.min(block.0), high.max(block.1))
                })
            })
            .collect();
        let mut steady = Self { level, levels, usual: (f64::NAN, f64::NAN), armed };
        steady.usual = medians(&parts)?;
        let (bottoms, tops) = steady.allowed(PART_LIKE);
        parts.iter().all(|(low, high)| bottoms.contains(low) && tops.contains(high)).then_some(steady)
    }

    /// Crossings of the next window, which starts at sample `origin` of the record; None if the window differs from the
    /// previous ones; its levels must then be estimated.
    ///
    /// # Errors
    /// On a stop.
    pub fn holds<T: Sample>(&self, window: &[T], origin: u64, stop: &Stop) -> Result<Option<Held>> {
        stop.check()?;
        let Ok(thresholds) = self.levels.thresholds::<T>() else { return Ok(None) };
        let mut held = Held { first: 0, edges: Vec::new(), armed: self.armed };
        let mut parts = Vec::with_capacity(window.len() / PART);
        let mut even = Even::new();
        let holds = window.len() >= LEAST_PARTS * PART
            && pass(self, window, origin, thresholds, (&mut held, &mut parts, &mut even));
        if !holds || !even.to(window.len()) {
            return Ok(None);
        }
        held.first = even.first as usize;
        let (bottoms, tops) = self.allowed(WINDOW_LIKE);
        let like = medians(&parts).is_some_and(|(low, high)| bottoms.contains(&low) && tops.contains(&high));
        Ok(like.then_some(held))
    }

    fn allowed(&self, (of_noise, of_height): (f64, f64)) -> (RangeInclusive<f64>, RangeInclusive<f64>) {
        let most = of_noise * self.level.noise + of_height * self.level.height();
        let about = |usual: f64| usual - most..=usual + most;
        (about(self.usual.0), about(self.usual.1))
    }
}

fn medians(parts: &[(f64, f64)]) -> Option<(f64, f64)> {
    if parts.len() < LEAST_PARTS {
        return None;
    }
    let (mut lows, mut highs): (Vec<f64>, Vec<f64>) = parts.iter().copied().unzip();
    let half = parts.len() / 2;
    let low = *lows.select_nth_unstable_by(half, f64::total_cmp).1;
    let high = *highs.select_nth_unstable_by(half, f64::total_cmp).1;
    Some((low, high))
}

/// Test whether pulses are evenly spaced.
struct Even {
    first: u32,
    last: u32,
    least: u32,
    most: u32,
}

impl Even {
    const fn new() -> Self {
        Self { first: u32::MAX, last: u32::MAX, least: u32::MAX, most: 0 }
    }

    /// Add the next pulses; return all of them except the first pulse of the window.
    fn take<'a>(&mut self, fires: &'a [u32], start: u32) -> &'a [u32] {
        let [first, others @ ..] = fires else { return fires };
        let (begins, others) = if self.last == u32::MAX {
            self.first = start + first;
            (*first, others)
        } else {
            (self.last.wrapping_sub(start), fires)
        };
        let mut last = begins;
        for &at in others {
            let period = at.wrapping_sub(last);
            (self.least, self.most) = (self.least.min(period), self.most.max(period));
            last = at;
        }
        self.last = start.wrapping_add(last);
        others
    }

    /// Whether pulses are evenly spaced over a whole window, with at least two in each of its parts.
    fn to(&self, length: usize) -> bool {
        let longest = (EVEN * f64::from(self.least) + 1.0).min((PART / 2) as f64);
        let ends = f64::from(self.first).max(length as f64 - f64::from(self.last));
        self.least < u32::MAX && f64::from(self.most) <= longest && ends <= longest
    }
}

/// Pass over a window; false as soon as a sample is missing or a part's extremes are out of range.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+bmi1+bmi2+fma+lzcnt+popcnt",
    "x86_64+avx2+bmi1+bmi2+fma+lzcnt+popcnt"
))]
fn pass<T: Sample>(
    steady: &Steady,
    window: &[T],
    origin: u64,
    (low, high): (T, T),
    (held, parts, even): (&mut Held, &mut Vec<(f64, f64)>, &mut Even),
) -> bool {
    const MASK_REGISTERS: bool = match_target! { "x86_64+avx512bw" => true, _ => false };
    let allowed = steady.allowed(PART_LIKE);
    let middle = steady.levels.middle;
    let mut fires = Fires::new();
    for (start, batch) in (0_u32..).step_by(BATCH).zip(window.chunks(BATCH)) {
        for (offset, part) in (0..).step_by(PART).zip(batch.chunks(PART)) {
            let mut lows = [T::MOST; LANES];
            let mut highs = [T::LEAST; LANES];
            let (blocks, rest) = part.as_chunks::<BLOCK>();
            let mut padded = [low; BLOCK];
            padded[..rest.len()].copy_from_slice(rest);
            let mut missing = 0;
            for (index, block) in blocks.iter().enumerate() {
                let masks = Masks::of::<T, MASK_REGISTERS>(block, low, high);
                missing |= masks.gap;
                fires.push(offset + index * BLOCK, armed_by(masks, &mut held.armed));
                for row in block.as_chunks::<LANES>().0 {
                    // By index, since an iterator would keep the lanes in memory.
                    #[allow(clippy::needless_range_loop)]
                    for lane in 0..LANES {
                        let x = row[lane];
                        lows[lane] = if x < lows[lane] { x } else { lows[lane] };
                        highs[lane] = if x > highs[lane] { x } else { highs[lane] };
                    }
                }
            }
            if !rest.is_empty() {
                let masks = Masks::of::<T, MASK_REGISTERS>(&padded, low, high).first(rest.len());
                missing |= masks.gap;
                fires.push(offset + blocks.len() * BLOCK, armed_by(masks, &mut held.armed));
            }
            let whole = part.len() == PART;
            let least: f64 = swings::reduced(&lows, swings::least).into();
            let most: f64 = swings::reduced(&highs, swings::most).into();
            if missing != 0 || whole && !(allowed.0.contains(&least) && allowed.1.contains(&most)) {
                return false;
            }
            if whole {
                parts.push((least, most));
            }
        }
        let others = even.take(fires.taken(), start);
        held.edges.reserve(others.len());
        for &at in others {
            held.edges.push(crossing(window, (start + at) as usize, origin, middle));
        }
        fires.clear();
    }
    true
}

/// Last upward crossing of the middle at or before sample `index`; an earlier sample of the window is below the middle.
#[allow(clippy::inline_always)]
#[inline(always)]
fn crossing<T: Sample>(window: &[T], index: usize, origin: u64, middle: f64) -> Edge {
    let mut upper = index;
    while upper > 1 && window[upper - 1].into() >= middle {
        upper -= 1;
    }
    let (before, after): (f64, f64) = (window[upper - 1].into(), window[upper].into());
    let rise = after - before;
    Edge { time: (origin + upper as u64) as f64 - (after - middle) / rise, rise }
}
