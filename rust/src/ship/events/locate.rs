//! Where a condition is first missed in a step, to the last digits.

use super::flow::State;
use super::march::Course;
use super::switches::{ALL, CONDITIONS, Condition};

/// A condition counts as missed below minus this.
pub const SLACK: f64 = 1e-12;
/// A margin above this is far from zero.
const FAR: f64 = 0.02;
/// Most evaluations of a root.
const MOST: usize = 60;
/// Share of a step over which a margin's slope is taken.
const SPAN: f64 = 1e-4;

/// A switch within a step.
#[derive(Debug, Clone, Copy)]
pub struct Switch {
    pub condition: Condition,
    /// Time since the step began [s].
    pub elapsed: f64,
    /// How fast the margin falls there.
    pub slope: f64,
}

/// The first switch in a step of some length, if any.
pub fn first(course: &Course<'_, impl Fn(f64) -> State<f64>>, length: f64) -> Option<Switch> {
    let at = |elapsed: f64| -> [f64; CONDITIONS] { course.margins(elapsed) };
    let (begin, end) = (at(0.0), at(length));
    if begin.iter().zip(&end).all(|(&begin, &end)| is_far(begin, end)) {
        return None;
    }
    let middle = at(0.5 * length);
    let mut found: Option<Switch> = None;
    for (place, &condition) in ALL.iter().enumerate() {
        let values = [begin[place], middle[place], end[place]];
        if !values.iter().all(|value| value.is_finite()) {
            continue;
        }
        let margin = |elapsed: f64| course.margin(elapsed, condition);
        let Some(missed) = missed(values, length, margin) else { continue };
        // Missed from the beginning, it switches when the step begins, whatever its margin's slope.
        let late = values[0] <= -SLACK;
        let elapsed = if late { 0.0 } else { root(margin, values[0], missed) };
        if found.is_none_or(|before| elapsed < before.elapsed) {
            let span = SPAN * length;
            let slope =
                if late { 0.0 } else { (margin(elapsed + span) - margin(elapsed - span)) / (2.0 * span) };
            found = Some(Switch { condition, elapsed, slope });
        }
    }
    found
}

/// Whether a margin that is far from zero at both ends of a step, and hardly other at one than at the other, is so in between:
/// nothing breaks within a step, which is a small part of every time constant.
fn is_far(begin: f64, end: f64) -> bool {
    let near = begin.min(end);
    !(begin.is_finite() && end.is_finite()) || (near > FAR && (end - begin).abs() < 0.25 * near)
}

/// A time at which a margin is below zero, by its values at the beginning, the middle and the end of a step.
fn missed(values: [f64; 3], length: f64, margin: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
    let [begin, middle, end] = values;
    if middle < -SLACK || begin < -SLACK {
        return Some((0.5 * length, middle));
    }
    let (bend, slope) = (2.0 * (begin - 2.0 * middle + end), 4.0 * middle - 3.0 * begin - end);
    let lowest = -slope / (2.0 * bend);
    if bend > 0.0 && lowest > 0.0 && lowest < 1.0 && begin - slope * slope / (4.0 * bend) < 0.0 {
        let value = margin(lowest * length);
        if value < -SLACK {
            return Some((lowest * length, value));
        }
    }
    (end < -SLACK).then_some((length, end))
}

/// Where a margin falls through zero between 0 and a time at which it is below: false position with halved ends
/// (Illinois), and bisection in between.
fn root(margin: impl Fn(f64) -> f64, begin: f64, (missed, value): (f64, f64)) -> f64 {
    let (mut low, mut high) = ((0.0, begin.max(0.0)), (missed, value));
    if low.1 == 0.0 {
        // It stands at zero to begin with: does it rise first?
        let probe = 1e-6 * missed;
        let value = margin(probe);
        if value <= 0.0 {
            return 0.0;
        }
        low = (probe, value);
    }
    let (mut low_weight, mut high_weight) = (low.1, high.1);
    for count in 0..MOST {
        let width = high.0 - low.0;
        if width <= 1e-15 * missed {
            break;
        }
        let guess = if count % 4 == 3 {
            low.0 + 0.5 * width
        } else {
            low.0 + width * (low_weight / (low_weight - high_weight))
        };
        if !(guess > low.0 && guess < high.0) {
            break;
        }
        let value = margin(guess);
        if value > 0.0 {
            low = (guess, value);
            low_weight = value;
            high_weight *= 0.5;
        } else {
            high = (guess, value);
            high_weight = value;
            low_weight *= 0.5;
        }
        if value == 0.0 {
            break;
        }
    }
    if low.1.abs() < high.1.abs() { low.0 } else { high.0 }
}
