//! What the loop was fed a dead time ago: series of past pieces, read over the piece to come.

use pulp::Simd;

use super::grid::{Piece, Time};
use super::model::{Series, for_terms, is_flexible};
use super::slopes::{Rate, get};

/// Parts of a piece closer than this are one.
const SAME: f64 = 1e-9;

/// Where a piece's past lies: within one past piece, or from one into another.
#[derive(Debug, Clone, Copy)]
pub struct Window {
    /// The past piece at its start: its place, where in it, and how long the piece is in its lengths.
    pub first: (usize, f64, f64),
    /// The past piece at its end, likewise, if it is another.
    pub last: Option<(usize, f64, f64)>,
}

impl Window {
    /// With how far back its pieces lie from a piece of that number, in place of their places, or the other way round.
    #[inline(always)]
    pub fn turned(self, count: usize, mask: usize) -> Self {
        let turn = |(place, x, scale): (usize, f64, f64)| (count.wrapping_sub(place) & mask, x, scale);
        Self { first: turn(self.first), last: self.last.map(turn) }
    }
}

/// Past pieces, in a ring that holds those of a dead time.
pub struct History {
    late: Time,
    pieces: Vec<(Time, f64)>,
    count: usize,
    /// The past piece that is being read.
    at: usize,
}

impl History {
    /// For a dead time [sample intervals] and at most so many pieces within it.
    pub fn new(dead_time: f64, pieces: usize) -> Self {
        let ring = vec![(Time { whole: 0, part: 0.0 }, 0.0); pieces.next_power_of_two()];
        Self { late: Time::new(dead_time), pieces: ring, count: 0, at: 0 }
    }

    /// Number of places.
    pub fn places(&self) -> usize {
        self.pieces.len()
    }

    /// Take in a piece, and give its place.
    #[inline(always)]
    pub fn push(&mut self, piece: &Piece) -> usize {
        let place = self.count & (self.pieces.len() - 1);
        self.pieces[place] = (piece.start, piece.length);
        self.count += 1;
        place
    }

    /// Make room for as many pieces again, where there is hardly any left: for each place its new one.
    pub fn grow(&mut self) -> Option<Vec<(usize, usize)>> {
        let places = self.pieces.len();
        if self.count - self.at + 2 < places {
            return None;
        }
        let moves: Vec<_> =
            (self.at..self.count).map(|piece| (piece & (places - 1), piece & (2 * places - 1))).collect();
        self.pieces = moved(&self.pieces, 1, &moves);
        Some(moves)
    }

    /// The past of a piece that begins a dead time or more after the first.
    #[inline(always)]
    pub fn window(&mut self, piece: &Piece) -> Window {
        let mask = self.pieces.len() - 1;
        let start = Time {
            whole: piece.start.whole.saturating_sub(self.late.whole),
            part: piece.start.part - self.late.part,
        };
        while self.at + 1 < self.count {
            let (began, length) = self.pieces[self.at & mask];
            if start.since(began) < length * (1.0 - SAME) {
                break;
            }
            self.at += 1;
        }
        let (began, length) = self.pieces[self.at & mask];
        let x = start.since(began) / length;
        let first = (self.at & mask, if x.abs() < SAME { 0.0 } else { x }, piece.length / length);
        let end = Time { part: start.part + piece.length, ..start };
        let mut last = self.at;
        while last + 1 < self.count {
            let (began, length) = self.pieces[last & mask];
            if end.since(began) <= length * (1.0 + SAME) {
                break;
            }
            last += 1;
        }
        if last == self.at {
            return Window { first, last: None };
        }
        let (began, length) = self.pieces[last & mask];
        Window { first, last: Some((last & mask, end.since(began) / length, piece.length / length)) }
    }
}

/// A ring of twice the room, of so many entries a place.
pub fn moved<E: Clone>(ring: &[E], entries: usize, moves: &[(usize, usize)]) -> Vec<E> {
    let mut room = [ring, ring].concat();
    for &(from, to) in moves {
        room[to * entries..][..entries].clone_from_slice(&ring[from * entries..][..entries]);
    }
    room
}

/// A series about another start, and over another length.
#[inline(always)]
fn shifted<S: Simd, const T: usize>(simd: S, mut series: [S::f64s; T], x: f64, scale: f64) -> [S::f64s; T] {
    if x != 0.0 {
        let by = simd.splat_f64s(x);
        for_terms!(LOW of T => {
            for k in (LOW..T - 1).rev() {
                series[k] = simd.mul_add_e_f64s(by, series[k + 1], series[k]);
            }
        });
    }
    let mut factor = 1.0;
    for k in 1..T {
        factor *= scale;
        series[k] = simd.mul_f64s(series[k], simd.splat_f64s(factor));
    }
    series
}

/// A past signal over the piece to come; `read` gives a past piece's series.
#[inline(always)]
pub fn past<'a, S: Simd, const T: usize>(
    simd: S,
    window: &Window,
    read: impl Fn(usize) -> &'a Rate<T>,
    part: usize,
) -> [S::f64s; T] {
    let load = |place: usize| {
        let rows = read(place);
        let mut terms = [simd.splat_f64s(0.0); T];
        for k in 0..T {
            terms[k] = get::<S>(&rows[k], part);
        }
        terms
    };
    let (place, x, scale) = window.first;
    let series = shifted(simd, load(place), x, scale);
    match window.last {
        None => series,
        Some((place, x, scale)) => joined(simd, series, shifted(simd, load(place), x, scale)),
    }
}

/// The same of one number.
#[inline(always)]
pub fn past_value<const T: usize>(window: &Window, backs: &[Series]) -> Series {
    let simd = pulp::Scalar::new();
    let (place, x, scale) = window.first;
    let mut terms = shifted(simd, first::<T>(&backs[place]), x, scale);
    if let Some((place, x, scale)) = window.last {
        terms = joined(simd, terms, shifted(simd, first::<T>(&backs[place]), x, scale));
    }
    let mut series = [0.0; 8];
    series[..T].copy_from_slice(&terms);
    series
}

/// The first terms of a series.
#[inline(always)]
fn first<const T: usize>(series: &Series) -> [f64; T] {
    let mut terms = [0.0; T];
    terms.copy_from_slice(&series[..T]);
    terms
}

/// Where the window reaches from one past piece into another, whose series differ by a break that is too weak for a cut, it is
/// the polynomial that has both ends' value and slope, and the curvature of the start; with more terms, of both ends.
#[inline(always)]
fn joined<S: Simd, const T: usize>(simd: S, mut series: [S::f64s; T], end: [S::f64s; T]) -> [S::f64s; T] {
    let (p0, p1, p2) = (series[0], series[1], series[2]);
    let value = simd.sub_f64s(end[0], simd.add_f64s(simd.add_f64s(p0, p1), p2));
    let slope = simd.sub_f64s(end[1], simd.add_f64s(p1, times(simd, 2.0, p2)));
    if const { is_flexible(T) } {
        let bend = simd.sub_f64s(end[2], p2);
        let (a, b, c) = ([10.0, -15.0, 6.0], [-4.0, 7.0, -3.0], [1.0, -2.0, 1.0]);
        for k in 0..3 {
            let more = simd.add_f64s(times(simd, b[k], slope), times(simd, c[k], bend));
            series[3 + k] = simd.add_f64s(times(simd, a[k], value), more);
        }
        series[T - 1] = simd.splat_f64s(0.0);
    } else {
        series[3] = simd.sub_f64s(times(simd, 4.0, value), slope);
        series[4] = simd.sub_f64s(slope, times(simd, 3.0, value));
    }
    series
}

#[inline(always)]
fn times<S: Simd>(simd: S, factor: f64, of: S::f64s) -> S::f64s {
    simd.mul_f64s(simd.splat_f64s(factor), of)
}
