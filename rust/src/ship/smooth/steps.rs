//! The pieces with all that does not depend on the ship's state: their pasts, and the samples that lie in them.
//!
//! Once the record's start has passed through all dead times that are followed, every sample interval has the same pieces: they
//! are worked out once more, and then repeated.

use super::grid::{Grid, Piece, Time};
use super::history::{History, Window};

/// A sample that lies within rounding of a piece's end is the next one's.
const SAME: f64 = 1e-9;
/// Most delays of channels that differ.
pub const CHANNELS: usize = 3;

/// A piece, and what lies in it.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    pub piece: Piece,
    /// One over its length [1/s].
    pub inverse: f64,
    /// Its past, in pieces before this one.
    pub window: Option<Window>,
    /// For each channel the part of the piece at which a sample lies.
    pub samples: [Option<f64>; CHANNELS],
}

/// The steps of a record.
pub struct Steps {
    grid: Grid,
    history: Option<History>,
    channels: Vec<Channel>,
    dt: f64,
    mask: usize,
    /// Number of pieces up to now.
    count: usize,
    /// The last step that was worked out, and the steps of a sample interval, once they repeat themselves.
    fresh: Step,
    lap: Vec<Step>,
    at: usize,
    repeats: bool,
    records: bool,
}

/// Outputs that are late by the same time.
struct Channel {
    late: Time,
    next: usize,
}

impl Steps {
    /// For channels that are late by so many sample intervals, and have so many samples before the record; `history` where there is a dead time in the loop.
    pub fn new(grid: Grid, history: Option<History>, late: &[(f64, usize)], dt: f64) -> Self {
        let channels = late.iter().map(|&(late, next)| Channel { late: Time::new(late), next }).collect();
        let mask = history.as_ref().map_or(0, |history| history.places() - 1);
        let piece = Piece { start: Time { whole: 0, part: 0.0 }, length: 1.0, cut: None, open: false };
        let fresh = Step { piece, inverse: 1.0, window: None, samples: [None; CHANNELS] };
        let (lap, repeats, records) = (Vec::new(), false, false);
        Self { grid, history, channels, dt, mask, count: 0, fresh, lap, at: 0, repeats, records }
    }

    /// The next step, where its past lies, and the place of its piece in the history.
    #[inline(always)]
    pub fn next(&mut self) -> (&Step, Option<Window>, usize) {
        let (mask, count) = (self.mask, self.count);
        self.count += 1;
        if !self.repeats {
            self.work_out(count);
        }
        let step = if self.repeats {
            let at = self.at;
            self.at = if at + 1 == self.lap.len() { 0 } else { at + 1 };
            let step = &mut self.lap[at];
            step.piece.start.whole += 1;
            &*step
        } else {
            &self.fresh
        };
        (step, step.window.map(|window| window.turned(count, mask)), count & mask)
    }

    /// The piece to come, as far as to this part of it, and its past, by places; unless it is taken it can be asked for again.
    #[inline(always)]
    pub fn propose(&mut self, part: f64) -> (Piece, Option<Window>) {
        let piece = self.grid.peek();
        let piece = Piece { length: piece.length * part, ..piece };
        let history = self.history.as_mut().filter(|_| piece.open);
        (piece, history.map(|history| history.window(&piece)))
    }

    /// Take the piece that was proposed; and the place of it in the history.
    #[inline(always)]
    pub fn take(&mut self, part: f64, window: Option<Window>) -> (Step, usize) {
        let place = self.count & self.mask;
        self.count += 1;
        let piece = if part < 1.0 { self.grid.take_part(part) } else { self.grid.next() };
        (self.taken(piece, window), place)
    }

    /// Something breaks where the piece to come begins, and that many dead times later again.
    pub fn expect(&mut self, dead_time: f64, levels: usize) {
        for level in 1..=levels {
            self.grid.expect(level as f64 * dead_time);
        }
    }

    /// Make room for more pieces, where those of a dead time fill it; where they are from now on, of where they were.
    pub fn grow(&mut self) -> Option<Vec<(usize, usize)>> {
        let moves = self.history.as_mut()?.grow()?;
        self.mask = 2 * self.mask + 1;
        Some(moves)
    }

    /// The steps of the last sample interval, where those of the next one are the first that repeat them.
    #[inline(always)]
    pub fn lap(&self) -> Option<&[Step]> {
        (self.records && !self.repeats && self.grid.repeats()).then_some(&self.lap)
    }

    /// Work out the step of that number, unless it turns out to repeat an earlier one.
    #[inline(never)]
    fn work_out(&mut self, count: usize) {
        let begins = self.grid.repeats();
        if begins && self.records {
            self.repeats = true;
            return;
        }
        let piece = self.grid.next();
        let window = match &mut self.history {
            Some(history) if piece.open => Some(history.window(&piece).turned(count, self.mask)),
            _ => None,
        };
        self.fresh = self.taken(piece, window);
        self.records |= begins;
        if self.records {
            self.lap.push(self.fresh);
        }
    }

    /// A piece with what lies in it.
    #[inline(always)]
    fn taken(&mut self, piece: Piece, window: Option<Window>) -> Step {
        if let Some(history) = &mut self.history {
            history.push(&piece);
        }
        let mut samples = [None; CHANNELS];
        for (sample, Channel { late, next }) in samples.iter_mut().zip(&mut self.channels) {
            #[allow(clippy::cast_possible_wrap)] // a record's length
            let time = Time { whole: (*next as isize).saturating_sub(late.whole), part: -late.part };
            let passed = time.since(piece.start);
            if passed < piece.length * (1.0 - SAME) {
                *sample = Some((passed / piece.length).max(0.0));
                *next += 1;
            }
        }
        Step { piece, inverse: 1.0 / (piece.length * self.dt), window, samples }
    }
}
