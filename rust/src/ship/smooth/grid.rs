//! The pieces of time between which nothing breaks: every kink or jump of an input, as it arrives, begins one.
//!
//! Times are whole sample intervals and a part of one, so that a piece late in a long record is as sharp as the first.

/// Breaks closer than this part of a sample interval are one.
const SAME: f64 = 1e-10;

/// A time in sample intervals: whole ones and the part of one beyond them, which may be a little more than one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Time {
    pub whole: isize,
    pub part: f64,
}

impl Time {
    /// That many sample intervals.
    #[allow(clippy::cast_possible_truncation)] // saturates
    pub fn new(intervals: f64) -> Self {
        let whole = intervals.floor();
        Self { whole: whole as isize, part: intervals - whole }
    }

    /// How much later than another, in sample intervals.
    #[inline(always)]
    pub fn since(self, other: Self) -> f64 {
        self.whole.saturating_sub(other.whole) as f64 + (self.part - other.part)
    }
}

/// A break that comes once in every sample interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    /// The part of the interval at which it comes.
    part: f64,
    /// How its time moves with the dead time in the loop and with that of the set point.
    pub moves: [f64; 2],
}

/// A piece of time, in sample intervals.
#[derive(Debug, Clone, Copy)]
pub struct Piece {
    pub start: Time,
    pub length: f64,
    /// Whether it begins with a break, and how that moves.
    pub cut: Option<[f64; 2]>,
    /// Whether the dead time since the start of the record is over.
    pub open: bool,
}

/// All pieces, one after the other, from the start of the record on.
pub struct Grid {
    cuts: Vec<Cut>,
    /// Breaks of the record's start, which come once: the last first.
    once: Vec<Time>,
    longest: f64,
    now: Time,
    next: usize,
    lap: isize,
    left: usize,
    length: f64,
    cut: Option<[f64; 2]>,
    open: bool,
    /// The sample interval from which on nothing of the record's start is left in the past that is read.
    settled: isize,
}

impl Grid {
    /// Cuts for a dead time in the loop and one of the set point [sample intervals], and for a load; through so many dead times
    /// in the loop a break is followed.
    pub fn new(dead_time: f64, set_dead_time: f64, load: bool, levels: usize, longest: f64) -> Self {
        let mut cuts: Vec<Cut> = Vec::new();
        let mut add = |late: f64, moves: [f64; 2]| {
            let part = Time::new(late).part;
            let near = |cut: &Cut| {
                let gap = (cut.part - part).abs();
                gap.min(1.0 - gap) < SAME
            };
            if !cuts.iter().any(near) {
                cuts.push(Cut { part, moves });
            }
        };
        let delayed = dead_time > 0.0;
        for level in if delayed { 1..=levels } else { 0..=0 } {
            // Without a dead time in the loop, one that begins would still move what arrives.
            add(set_dead_time + level as f64 * dead_time, [level.max(1) as f64, 1.0]);
        }
        for level in 0..if load && delayed { levels } else { usize::from(load) } {
            add(level as f64 * dead_time, [level as f64, 0.0]);
        }
        cuts.sort_by(|a, b| a.part.total_cmp(&b.part));
        let once = if delayed {
            (1..=levels).rev().map(|level| Time::new(level as f64 * dead_time)).collect()
        } else {
            Vec::new()
        };
        // The record's start is a break already.
        let first = usize::from(cuts[0].part < SAME);
        let (next, lap) = (first % cuts.len(), isize::from(first == cuts.len()));
        Self {
            cuts,
            once,
            longest,
            now: Time { whole: 0, part: 0.0 },
            next,
            lap,
            left: 0,
            length: 0.0,
            cut: Some([0.0, 0.0]),
            open: !delayed,
            settled: Time::new((levels + 1) as f64 * dead_time).whole.saturating_add(3),
        }
    }

    /// Whether the next piece begins a sample interval whose pieces every later one repeats.
    pub fn repeats(&self) -> bool {
        self.once.is_empty()
            && self.left == 0
            && self.cut.is_some()
            && self.next == 1 % self.cuts.len()
            && self.now.part == self.cuts[0].part
            && self.now.whole >= self.settled
    }

    /// The next piece.
    #[inline(always)]
    pub fn next(&mut self) -> Piece {
        if self.left == 0 {
            self.aim();
        }
        self.left -= 1;
        let piece = Piece { start: self.now, length: self.length, cut: self.cut.take(), open: self.open };
        if self.left == 0 {
            self.arrive();
        } else {
            self.now.part += self.length;
            if self.now.part >= 1.0 {
                self.now = Time { whole: self.now.whole + 1, part: self.now.part - 1.0 };
            }
        }
        piece
    }

    /// The piece that is to come, if it is not shortened.
    #[inline(always)]
    pub fn peek(&mut self) -> Piece {
        if self.left == 0 {
            self.aim();
        }
        Piece { start: self.now, length: self.length, cut: self.cut, open: self.open }
    }

    /// Take the piece to come no further than to this part of it.
    pub fn take_part(&mut self, part: f64) -> Piece {
        let piece = Piece { length: self.length * part, ..self.peek() };
        self.now.part += piece.length;
        if self.now.part >= 1.0 {
            self.now = Time { whole: self.now.whole + 1, part: self.now.part - 1.0 };
        }
        (self.left, self.cut) = (0, None);
        piece
    }

    /// A break that comes once, that many sample intervals from now.
    pub fn expect(&mut self, after: f64) {
        let late = Time::new(after);
        let mut time =
            Time { whole: self.now.whole.saturating_add(late.whole), part: self.now.part + late.part };
        if time.part >= 1.0 {
            time = Time { whole: time.whole + 1, part: time.part - 1.0 };
        }
        let place = self.once.partition_point(|once| once.since(time) > 0.0);
        self.once.insert(place, time);
        self.left = 0;
    }

    fn coming(&self) -> Time {
        Time { whole: self.lap, part: self.cuts[self.next].part }
    }

    /// Divide what is left until the next break.
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // positive; saturates
    fn aim(&mut self) {
        let mut gap = self.coming().since(self.now);
        if let Some(once) = self.once.last() {
            gap = gap.min(once.since(self.now));
        }
        let count = (gap / self.longest - SAME).ceil().max(1.0);
        (self.left, self.length) = (count as usize, gap / count);
    }

    /// Take up all breaks that come at the end of the pieces.
    #[inline(always)]
    fn arrive(&mut self) {
        let end = Time { part: self.now.part + self.length, ..self.now };
        let mut at = None;
        let coming = self.coming();
        if coming.since(end) < SAME {
            at = Some(coming);
            self.cut = Some(self.cuts[self.next].moves);
            self.next += 1;
            if self.next == self.cuts.len() {
                (self.next, self.lap) = (0, self.lap + 1);
            }
        }
        while let Some(once) = self.once.last().filter(|once| once.since(end) < SAME) {
            at = at.or(Some(*once));
            self.cut = self.cut.or(Some([0.0, 0.0]));
            self.once.pop();
            self.open = true;
        }
        self.now = at.unwrap_or(end);
        // What comes within rounding is no piece of its own.
        if self.coming().since(self.now) < SAME && self.cuts.len() > 1 {
            self.next += 1;
            if self.next == self.cuts.len() {
                (self.next, self.lap) = (0, self.lap + 1);
            }
        }
    }
}
