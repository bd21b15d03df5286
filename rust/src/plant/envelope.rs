//! Torque-speed envelope of the engine (Fig. 3.3): the brake torque it can't exceed.

use crate::error::{Error, Result, require};

/// The envelope as a loop looks it up.
pub trait Limit {
    /// Largest brake torque [Nm] at an engine speed [rev/s].
    fn torque(&mut self, engine_speed: f64) -> f64;
}

/// The same limit at every speed; infinity where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constant(pub f64);

impl Limit for Constant {
    #[inline(always)]
    fn torque(&mut self, _engine_speed: f64) -> f64 {
        self.0
    }
}

/// A straight piece of the envelope, valid for speeds in [from, to).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    from: f64,
    to: f64,
    anchor: f64,
    torque: f64,
    slope: f64,
}

/// A piecewise linear limit, constant outside its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Table(Vec<Piece>);

/// Looks a [`Table`] up, starting from the piece of the time before.
///
/// The speed moves little between stages, so the branches are predicted and the lookup costs no search. A speed belongs
/// to one piece only: the result does not depend on where the search starts.
#[derive(Debug, Clone, Copy)]
pub struct Cursor<'a> {
    table: &'a Table,
    index: usize,
    piece: Piece,
}

impl Table {
    /// A cursor on the first piece.
    #[must_use]
    pub fn cursor(&self) -> Cursor<'_> {
        Cursor { table: self, index: 0, piece: self.0[0] }
    }
}

impl Limit for Cursor<'_> {
    #[inline(always)]
    fn torque(&mut self, engine_speed: f64) -> f64 {
        while engine_speed < self.piece.from {
            self.index -= 1;
            self.piece = self.table.0[self.index];
        }
        while engine_speed >= self.piece.to {
            self.index += 1;
            self.piece = self.table.0[self.index];
        }
        self.piece.torque + self.piece.slope * (engine_speed - self.piece.anchor)
    }
}

/// Torque-speed envelope of an engine.
#[derive(Debug, Clone, PartialEq)]
pub enum Envelope {
    /// One torque at every speed, infinity for no limit.
    Constant(Constant),
    /// Linear between points.
    Table(Table),
}

impl Envelope {
    /// Build from points; none means unlimited, one means constant.
    ///
    /// # Errors
    /// Where the points differ in number, are not finite, or the speeds don't ascend.
    pub fn new(speed: &[f64], torque: &[f64]) -> Result<Self> {
        require(speed.len() == torque.len(), || {
            format!("limit_torque has {} values, expected {} as in limit_speed", torque.len(), speed.len())
        })?;
        for (name, values) in [("limit_speed", speed), ("limit_torque", torque)] {
            if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
                let value = values[bad];
                return Err(Error::Invalid(format!("{name}[{bad}] is {value}, expected a finite number")));
            }
        }
        if let Some(bad) = (1..speed.len()).find(|&i| speed[i] <= speed[i - 1]) {
            return Err(Error::Invalid(format!(
                "limit_speed[{bad}] is {} after {}, expected ascending speeds",
                speed[bad],
                speed[bad - 1]
            )));
        }
        Ok(match *torque {
            [] => Self::Constant(Constant(f64::INFINITY)),
            [only] => Self::Constant(Constant(only)),
            _ => Self::Table(Table(pieces(speed, torque))),
        })
    }
}

/// The straight pieces between the points, with a level one before the first and after the last.
fn pieces(speed: &[f64], torque: &[f64]) -> Vec<Piece> {
    let last = speed.len() - 1;
    let before =
        Piece { from: f64::NEG_INFINITY, to: speed[0], anchor: speed[0], torque: torque[0], slope: 0.0 };
    let after =
        Piece { from: speed[last], to: f64::INFINITY, anchor: speed[last], torque: torque[last], slope: 0.0 };
    let between = (0..last).map(|i| Piece {
        from: speed[i],
        to: speed[i + 1],
        anchor: speed[i],
        torque: torque[i],
        slope: (torque[i + 1] - torque[i]) / (speed[i + 1] - speed[i]),
    });
    std::iter::once(before).chain(between).chain(std::iter::once(after)).collect()
}
