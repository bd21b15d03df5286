//! A dead time: the history of a signal, straight between its entries.

use std::collections::VecDeque;

/// Ring buffer of a signal's past. Two entries at one time are a jump.
#[derive(Debug, Clone)]
pub struct Delay {
    dead_time: f64,
    history: VecDeque<(f64, f64)>,
    /// Times at which jumps and bends of the signal arrive.
    breaks: VecDeque<f64>,
}

impl Delay {
    /// A signal that was constant before, with room for so many steps within the dead time.
    #[must_use]
    pub fn new(dead_time: f64, value: f64, steps: usize) -> Self {
        let mut history = VecDeque::with_capacity(2 * steps + 8);
        history.push_back((f64::NEG_INFINITY, value));
        history.push_back((0.0, value));
        Self { dead_time, history, breaks: VecDeque::with_capacity(steps + 4) }
    }

    /// Whether there is a dead time.
    #[inline(always)]
    #[must_use]
    pub fn acts(&self) -> bool {
        self.dead_time > 0.0
    }

    /// Add to the history; times never descend. A constant signal needs entries only where it jumps.
    #[inline(always)]
    pub fn push(&mut self, time: f64, value: f64) {
        self.history.push_back((time, value));
    }

    /// Note that the signal jumps or bends at a time.
    #[inline(always)]
    pub fn push_break(&mut self, time: f64) {
        self.breaks.push_back(time + self.dead_time);
    }

    /// When the next break after a time arrives, infinity for none.
    #[inline(always)]
    pub fn next_break(&mut self, after: f64) -> f64 {
        while self.breaks.front().is_some_and(|&arrival| arrival <= after) {
            self.breaks.pop_front();
        }
        self.breaks.front().copied().unwrap_or(f64::INFINITY)
    }

    /// Forget what no look-up at `time` or later needs.
    #[inline(always)]
    pub fn forget(&mut self, time: f64) {
        let oldest = time - self.dead_time;
        while self.history.get(1).is_some_and(|&(next, _)| next <= oldest) {
            self.history.pop_front();
        }
    }

    /// The delayed signal at `time`. Where the signal jumps then, `nudge` tells the side: below zero the value before the jump,
    /// above zero the one after it.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, time: f64, nudge: f64) -> f64 {
        let past = time - self.dead_time;
        let mut piece = 1;
        while self.history.get(piece).is_some_and(|to| to.0 <= past + nudge) {
            piece += 1;
        }
        match (self.history.get(piece - 1), self.history.get(piece)) {
            // Most commands are held: that spares a division, and one by an infinite stretch.
            (Some(from), Some(to)) if from.1.to_bits() != to.1.to_bits() => {
                from.1 + (to.1 - from.1) * ((past - from.0) / (to.0 - from.0))
            }
            (Some(from), _) => from.1,
            (None, _) => f64::NAN,
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::Delay;

    #[test]
    fn a_jump_arrives_after_the_dead_time_and_a_slope_with_it() {
        let mut delay = Delay::new(0.5, 1.0, 4);
        delay.push(0.25, 1.0);
        delay.push(0.25, 3.0);
        delay.push_break(0.25);
        delay.push(1.25, 5.0);
        assert_eq!(delay.at(0.4, 1e-9), 1.0);
        assert_eq!(delay.next_break(0.0), 0.75);
        assert_eq!(delay.at(0.75, -1e-9), 1.0);
        assert_eq!(delay.at(0.75, 1e-9), 3.0);
        assert_eq!(delay.at(1.25, 1e-9), 4.0);
        delay.forget(1.0);
        assert_eq!(delay.at(1.25, 1e-9), 4.0);
        assert_eq!(delay.next_break(0.75), f64::INFINITY);
    }
}
