//! Torque-speed envelope of the engine (Fig. 3.3): the brake torque it can't exceed.

use crate::error::{Error, Result, require};

/// A torque limit, as the loop over the samples looks it up.
pub trait Limit {
    /// Largest brake torque [Nm] at an engine speed [rev/s].
    fn torque(&mut self, engine_speed: f64) -> f64;
}

/// A limit that knows how it changes with the speed.
pub trait Slope: Limit {
    /// Slope [Nm/(rev/s)] at the speed that was last looked up; at a point of the table that of the piece above it.
    fn slope(&self) -> f64;
}

/// Torque-speed envelope of an engine.
#[derive(Debug, Clone)]
pub enum Envelope {
    /// One torque at every speed, infinity for no limit.
    Constant(Constant),
    /// Linear between points, constant outside.
    Table(Table),
}

/// The same limit at every speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constant(pub f64);

/// Straight pieces by ascending speed.
#[derive(Debug, Clone)]
pub struct Table(Vec<Piece>);

/// torque = `intercept` + `slope` speed for speeds in [from, to).
///
/// A bound that is never to be reached is NaN, not infinity: it holds for an infinite speed too, which a simulation
/// that diverges comes to.
#[derive(Debug, Clone, Copy)]
struct Piece {
    from: f64,
    to: f64,
    intercept: f64,
    slope: f64,
}

impl Envelope {
    /// Build from points, engine speed [rev/s] and torque [Nm]; none means unlimited, one means constant.
    ///
    /// # Errors
    /// Where the points differ in number, are not finite, or the speeds don't ascend.
    pub fn new(speed: &[f64], torque: &[f64]) -> Result<Self> {
        require(speed.len() == torque.len(), || {
            format!("limit_torque has {} values, expected {} as in limit_speed", torque.len(), speed.len())
        })?;
        for (name, values) in [("limit_speed", speed), ("limit_torque", torque)] {
            if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
                let found = values[bad];
                return Err(Error::Invalid(format!("{name}[{bad}] is {found}, expected a finite number")));
            }
        }
        if let Some(bad) = (1..speed.len()).find(|&i| speed[i] <= speed[i - 1]) {
            let (found, before) = (speed[bad], speed[bad - 1]);
            return Err(Error::Invalid(format!(
                "limit_speed[{bad}] is {found} after {before}, expected ascending speeds"
            )));
        }
        Ok(match *torque {
            [] => Self::Constant(Constant(f64::INFINITY)),
            [only] => Self::Constant(Constant(only)),
            [first, .., last] => {
                let level = |from, to, torque| Piece { from, to, intercept: torque, slope: 0.0 };
                let between = (1..speed.len()).map(|i| {
                    let slope = (torque[i] - torque[i - 1]) / (speed[i] - speed[i - 1]);
                    Piece { from: speed[i - 1], to: speed[i], intercept: torque[i] - slope * speed[i], slope }
                });
                let mut pieces = vec![level(f64::NAN, speed[0], first)];
                pieces.extend(between);
                pieces.push(level(speed[speed.len() - 1], f64::NAN, last));
                Self::Table(Table(pieces))
            }
        })
    }
}

impl Table {
    /// A cursor on the first piece.
    #[must_use]
    pub fn cursor(&self) -> Cursor<'_> {
        Cursor { pieces: &self.0, index: 0, piece: self.0[0] }
    }
}

/// Looks a table up, starting from the piece found last.
///
/// The speed changes little between stages, so that the branches are predicted and no search is needed. A speed
/// belongs to one piece only: the result does not depend on where the search starts.
#[derive(Debug, Clone, Copy)]
pub struct Cursor<'a> {
    pieces: &'a [Piece],
    index: usize,
    piece: Piece,
}

impl Limit for Constant {
    #[inline(always)]
    fn torque(&mut self, _engine_speed: f64) -> f64 {
        self.0
    }
}

impl Limit for Cursor<'_> {
    #[inline(always)]
    fn torque(&mut self, engine_speed: f64) -> f64 {
        while engine_speed < self.piece.from {
            self.index -= 1;
            self.piece = self.pieces[self.index];
        }
        while engine_speed >= self.piece.to {
            self.index += 1;
            self.piece = self.pieces[self.index];
        }
        self.piece.intercept + self.piece.slope * engine_speed
    }
}

impl Slope for Constant {
    #[inline(always)]
    fn slope(&self) -> f64 {
        0.0
    }
}

impl Slope for Cursor<'_> {
    #[inline(always)]
    fn slope(&self) -> f64 {
        self.piece.slope
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SPEED: [f64; 4] = [10.0, 15.0, 15.5, 30.0];
    const TORQUE: [f64; 4] = [100.0, 460.0, 440.0, 300.0];

    fn table() -> Table {
        match Envelope::new(&SPEED, &TORQUE) {
            Ok(Envelope::Table(table)) => table,
            other => panic!("{other:?}"),
        }
    }

    fn interpolated(speed: f64) -> f64 {
        let speed = speed.clamp(SPEED[0], SPEED[3]);
        let i = (0..3).rev().find(|&i| speed >= SPEED[i]).unwrap_or(0);
        let part = (speed - SPEED[i]) / (SPEED[i + 1] - SPEED[i]);
        TORQUE[i] * (1.0 - part) + TORQUE[i + 1] * part
    }

    proptest! {
        #[test]
        fn every_lookup_is_the_interpolation_wherever_the_speed_was_before(speeds in prop::collection::vec(-5.0..40.0, 1..20)) {
            let table = table();
            let mut cursor = table.cursor();
            for speed in speeds {
                let (found, expected) = (cursor.torque(speed), interpolated(speed));
                prop_assert!((found - expected).abs() < 1e-12 * expected);
                prop_assert_eq!(found.to_bits(), table.cursor().torque(speed).to_bits());
            }
        }
    }

    #[test]
    fn speeds_without_end_are_survived() {
        let table = table();
        for speed in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 20.0] {
            let _ = table.cursor().torque(speed);
        }
    }

    #[test]
    fn no_point_is_no_limit_and_one_is_a_constant() {
        let constant = |speed: &[f64], torque: &[f64]| match Envelope::new(speed, torque) {
            Ok(Envelope::Constant(Constant(torque))) => Some(torque),
            _ => None,
        };
        assert_eq!(constant(&[], &[]), Some(f64::INFINITY));
        assert_eq!(constant(&[20.0], &[446.0]), Some(446.0));
    }
}
