//! Heights of a train at its crossings, interpolated between its levels.

use super::swings::{BLOCK, Level};
use super::thresholds::Edge;

/// Time for which a level applies before and after its nine pulses, as a share of their span. It covers the end of a
/// train, where up to three turning points do not form a group.
const REACH: f64 = 0.375;
/// Ratio of the heights of successive levels below which the height is interpolated between them.
pub const STEADY: f64 = 2.0;

/// Heights of the train at crossings, interpolated between levels; 0 without turning points nearby.
///
/// Before the first and after the last level the line is extrapolated if it falls, since fading pulses are lower. A level
/// applies from about three pulses before its turning points to three after them.
pub fn heights_along(edges: &[Edge], known: &[Level]) -> Vec<f64> {
    let mut at = 0;
    edges
        .iter()
        .map(|edge| {
            while at + 1 < known.len() && edge.time >= known[at + 1].centre as f64 {
                at += 1;
            }
            let told = |level: &Level| {
                let beside = REACH * (level.span.1 - level.span.0) as f64 + BLOCK as f64;
                edge.time >= level.span.0 as f64 - beside && edge.time <= level.span.1 as f64 + beside
            };
            // The edge is at or past the centre of level `at`, or before the first level.
            let near = &known[at.saturating_sub(1)..(at + 2).min(known.len())];
            if near.iter().any(told) { height_at(edge.time, known, at) } else { 0.0 }
        })
        .collect()
}

/// Height at a time at or past the centre of level `at`, or before the first level.
fn height_at(time: f64, known: &[Level], at: usize) -> f64 {
    let here = &known[at];
    let between = time >= here.centre as f64 && at + 1 < known.len();
    let other = if at == 0 || between { at + 1 } else { at - 1 };
    let Some(other) = known.get(other) else { return here.height() };
    if ratio(here, other) > STEADY {
        let parted = u64::midpoint(here.span.1, other.span.0) as f64;
        return if between && time >= parted { other.height() } else { here.height() };
    }
    let way = (time - here.centre as f64) / (other.centre as f64 - here.centre as f64);
    let height = here.height() + way * (other.height() - here.height());
    if between { height } else { height.clamp(0.0, here.height()) }
}

/// Ratio of the larger to the smaller height.
pub fn ratio(one: &Level, other: &Level) -> f64 {
    (other.height() / one.height()).max(one.height() / other.height())
}
