//! The past over a piece, where a break that is too weak for a cut leads from one past piece into the next.
//!
//! Behind the break the past is the later piece's series. By what it differs there from the earlier one is no polynomial of the
//! whole piece. The polynomial that takes its place drives the state to the same values: it has the same moments over the
//! piece, and where a sample lies in it, the same value there and the same integral up to there.

use pulp::Simd;

use super::model::for_terms;

/// What each term of the difference behind a break, about the piece's end, makes of the terms of the whole piece.
pub type Join<const T: usize> = [[f64; T]; T];

/// Samples closer to an end of the piece, or to another sample, than this part of it say nothing of their own.
const APART: f64 = 0.05;

/// For a break with so much of the piece behind it, and samples at these parts of it.
pub fn join<const T: usize>(behind: f64, samples: &[Option<f64>]) -> Join<T> {
    // Of every term `z^k` of what is left of the piece: what a condition says of it over the piece, and behind the break alone.
    let moment = |order: usize| {
        let of = |reach: f64| std::array::from_fn(|k| powered(reach, k + order + 1) / (k + order + 1) as f64);
        [of(1.0), of(behind)]
    };
    let mut conditions: Vec<[[f64; T]; 2]> = vec![moment(0), moment(1)];
    let mut known: Vec<f64> = Vec::new();
    for sample in samples.iter().flatten() {
        if known.iter().any(|other| (other - sample).abs() < APART) {
            continue;
        }
        known.push(*sample);
        let left = 1.0 - sample;
        let value: [f64; T] = std::array::from_fn(|k| powered(left, k));
        conditions.push([value, if left < behind { value } else { [0.0; T] }]);
        if (APART..1.0 - APART).contains(sample) {
            let integral = |to: f64| {
                let from = left.min(to);
                std::array::from_fn(|k| (powered(to, k + 1) - powered(from, k + 1)) / (k + 1) as f64)
            };
            conditions.push([integral(1.0), integral(behind)]);
        }
    }
    conditions.extend((2..T).map(moment));
    // The last term stays the earlier piece's: its integral is beyond the terms that are kept of the past.
    conditions.truncate(T - 1);
    conditions.push([std::array::from_fn(|k| if k == T - 1 { 1.0 } else { 0.0 }), [0.0; T]]);
    let replaced = solved(&mut conditions);
    // Both in terms of what has passed instead of what is left.
    let sign = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
    std::array::from_fn(|to| {
        std::array::from_fn(|from| {
            let sum: f64 = (to..T).map(|k| binomial(k, to) * replaced[k][from]).sum();
            sign(to) * sign(from) * sum
        })
    })
}

fn powered(base: f64, exponent: usize) -> f64 {
    (0..exponent).map(|_| base).product()
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product()
}

/// Solve for the terms that meet the conditions, by elimination.
fn solved<const T: usize>(rows: &mut [[[f64; T]; 2]]) -> Join<T> {
    for column in 0..T {
        let size = |row: &usize| rows[*row][0][column].abs();
        let largest = (column..T).max_by(|a, b| size(a).total_cmp(&size(b))).unwrap_or(column);
        rows.swap(column, largest);
        let [mut left, mut right] = rows[column];
        let by = 1.0 / left[column];
        for k in 0..T {
            (left[k], right[k]) = (left[k] * by, right[k] * by);
        }
        rows[column] = [left, right];
        for row in (0..T).filter(|row| *row != column) {
            let by = rows[row][0][column];
            for k in 0..T {
                rows[row][0][k] -= by * left[k];
                rows[row][1][k] -= by * right[k];
            }
        }
    }
    std::array::from_fn(|row| rows[row][1])
}

/// The earlier piece's series over the whole piece, with what the later one's, about the end, adds.
#[inline(always)]
pub fn joined<S: Simd, const T: usize>(
    simd: S,
    join: &Join<T>,
    mut series: [S::f64s; T],
    later: [S::f64s; T],
) -> [S::f64s; T] {
    let mut difference = series;
    for_terms!(LOW of T => {
        for k in (LOW..T - 1).rev() {
            difference[k] = simd.add_f64s(difference[k + 1], difference[k]);
        }
    });
    for_terms!(K of T => {
        difference[K] = simd.sub_f64s(later[K], difference[K]);
    });
    for_terms!(K of T => {
        for from in 0..T {
            series[K] = simd.mul_add_e_f64s(simd.splat_f64s(join[K][from]), difference[from], series[K]);
        }
    });
    series
}
