//! Spikes: short excursions from the running median by Hampel's rule, which return to the previous level.

use super::running_median;
use crate::error::{Result, require};
use crate::stop::Stop;

/// Ratio of standard deviation to median absolute deviation for Gaussian noise.
const ROBUST_SIGMA: f64 = 1.4826;
/// Largest difference of the levels before and after a spike, as a share of its height.
const COMES_BACK: f64 = 0.3;
/// Share of the threshold above which samples beside a spike belong to the spike.
const SHOULDER: f64 = 0.5;
/// Share of the peak at which a spike's length is measured. At lower heights its neighbours may be suspect, too: on a
/// steep slope a long spike shifts the median.
const FOOT: f64 = 0.25;
/// Samples in a block. No median is computed in a block whose extremes are close, since it has no spike.
const BLOCK: usize = 64;

/// Definition of a spike.
#[derive(Debug, Clone, Copy)]
pub struct SpikeRule {
    /// Longest spike [samples]; the running median reaches as far on each side.
    pub longest: usize,
    /// Stride of the samples that estimate the spread about the running median.
    pub stride: usize,
    /// Number of strided samples whose median distance from the running median is the spread; odd.
    pub scale_window: usize,
    /// Height in robust standard deviations.
    pub threshold: f64,
    /// Least height, as a share of the median magnitude of the running median.
    pub least: f64,
}

/// Spikes of a signal, each as its first sample and the first after it.
///
/// A sample is suspect if its distance from the running median exceeds half of the least height of a spike at that
/// sample. Adjacent suspects are a spike under four conditions: above the foot they last no longer than the longest
/// spike; with shoulders they last no more than twice as long; the peak is high enough; and the signal returns to its
/// level.
///
/// # Errors
/// For an invalid rule, or after a request to stop.
pub fn find_spikes(samples: &[f64], rule: &SpikeRule, stop: &Stop) -> Result<Vec<(usize, usize)>> {
    require((1..1 << 30).contains(&rule.longest) && rule.stride > 0, || {
        format!("longest, stride: found {} and {}, expected positive numbers", rule.longest, rule.stride)
    })?;
    for (name, value) in [("threshold", rule.threshold), ("least", rule.least)] {
        require(value.is_finite() && value >= 0.0, || {
            format!("{name}: found {value}, expected a finite number of 0 or more")
        })?;
    }
    if !may_have_suspects(samples, rule) {
        return Ok(Vec::new());
    }
    let baseline = running_median(samples, 2 * rule.longest + 1, stop)?;
    let distance: Vec<f64> = samples.iter().zip(&baseline).map(|(x, median)| (x - median).abs()).collect();
    let strided: Vec<f64> = distance.iter().step_by(rule.stride).copied().collect();
    let spread = running_median(&strided, rule.scale_window, stop)?;
    let mut magnitude: Vec<f64> = baseline.iter().step_by(rule.stride).map(|median| median.abs()).collect();
    let least = rule.least * median(&mut magnitude);
    let limits: Vec<f64> =
        spread.iter().map(|spread| (rule.threshold * (ROBUST_SIGMA * spread)).max(least)).collect();
    let limit = |at: usize| limits[at / rule.stride];

    let mut suspects: Vec<(usize, usize)> = Vec::new();
    for (index, (group, limit)) in distance.chunks(rule.stride).zip(&limits).enumerate() {
        let shoulder = SHOULDER * limit;
        for (place, _) in group.iter().enumerate().filter(|&(_, &distance)| distance > shoulder) {
            let at = index * rule.stride + place;
            match suspects.last_mut() {
                // A spike with samples on both sides of the baseline counts as one spike.
                Some((_, end)) if at - *end <= (rule.longest / 10).max(1) => *end = at + 1,
                _ => suspects.push((at, at + 1)),
            }
        }
    }
    let nearby = (rule.longest / 2).max(1);
    suspects.retain(|&(start, end)| {
        let peak = (start..end).rev().max_by(|&a, &b| distance[a].total_cmp(&distance[b])).unwrap_or(start);
        let tall = |at: &usize| distance[*at] > FOOT * distance[peak];
        let (first, last) = (start..end).find(tall).zip((start..end).rfind(tall)).unwrap_or((start, end));
        last - first < rule.longest
            && end - start <= 2 * rule.longest
            && distance[peak] > limit(peak)
            && comes_back(
                &samples[start.saturating_sub(nearby)..start],
                samples[peak],
                &samples[end..samples.len().min(end + nearby)],
            )
    });
    Ok(suspects
        .into_iter()
        .map(|suspect| trimmed(samples, suspect, nearby, |at| SHOULDER * limit(at)))
        .collect())
}

/// Remove the samples near the level from both ends of a spike: they are suspect only because a long spike shifts the
/// median. The level is a straight line from the median before the spike to the median after it.
fn trimmed(
    samples: &[f64],
    (start, end): (usize, usize),
    nearby: usize,
    shoulder: impl Fn(usize) -> f64,
) -> (usize, usize) {
    let before = &samples[start.saturating_sub(nearby)..start];
    let after = &samples[end..samples.len().min(end + nearby)];
    let (left, right) = match (before.is_empty(), after.is_empty()) {
        (true, true) => return (start, end),
        (true, false) => (median(&mut after.to_vec()), median(&mut after.to_vec())),
        (false, true) => (median(&mut before.to_vec()), median(&mut before.to_vec())),
        (false, false) => (median(&mut before.to_vec()), median(&mut after.to_vec())),
    };
    let span = (end - start) as f64 + 0.5 * (before.len() + after.len()) as f64;
    let level = |at: usize| left + (right - left) * ((at - start) as f64 + 0.5 * before.len() as f64) / span;
    let beyond = |at: &usize| (samples[*at] - level(*at)).abs() > shoulder(*at);
    (start..end)
        .find(beyond)
        .zip((start..end).rfind(beyond))
        .map_or((start, end), |(first, last)| (first, last + 1))
}

/// False if the samples within the median's reach differ by less than the distance of a suspect from the median.
///
/// The median is within its window's range, and its magnitude is at least that of the signal's least sample.
fn may_have_suspects(samples: &[f64], rule: &SpikeRule) -> bool {
    let extremes: Vec<(f64, f64)> = samples.chunks(BLOCK).map(extremes).collect();
    let (lowest, highest) = join(&extremes);
    // NaN and infinity are not valid bounds.
    let nearest_zero = if lowest > 0.0 { lowest } else { (-highest).max(0.0) };
    let shoulder = SHOULDER * (rule.least * nearest_zero);
    let reach = rule.longest.div_ceil(BLOCK);
    (0..extremes.len()).any(|block| {
        let (low, high) = join(&extremes[block.saturating_sub(reach)..extremes.len().min(block + reach + 1)]);
        high - low > shoulder
    })
}

fn extremes(samples: &[f64]) -> (f64, f64) {
    samples.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| {
        (if x < low { x } else { low }, if x > high { x } else { high })
    })
}

fn join(extremes: &[(f64, f64)]) -> (f64, f64) {
    extremes
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), pair| (low.min(pair.0), high.max(pair.1)))
}

/// Whether the signal returns to its level before the spike; true at the record's ends, where this is unknown.
fn comes_back(before: &[f64], peak: f64, after: &[f64]) -> bool {
    if before.is_empty() || after.is_empty() {
        return true;
    }
    let (before, after) = (median(&mut before.to_vec()), median(&mut after.to_vec()));
    (after - before).abs() < COMES_BACK * (peak - before).abs()
}

/// Median; the mean of the middle two for an even count, NaN for none.
fn median(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    if values.is_empty() {
        return f64::NAN;
    }
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    if even {
        let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        f64::midpoint(lower, upper)
    } else {
        upper
    }
}
