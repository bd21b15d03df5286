//! What comes from outside a piece: the inputs, and what went back into the governor a dead time ago.

use crate::ship::run::Run;

use super::feed::{Feed, Input};
use super::grid::{Piece, Time};
use super::history::{Window, past_value};
use super::model::{Jets, Model, Series};

/// The inputs, and the past of the loop.
pub struct Outside<'a> {
    pub set: Feed<'a>,
    pub load: Option<Feed<'a>>,
    pub set0: f64,
    /// What went back into the governor, of all pieces up to this one, in a ring.
    pub backs: Vec<Series>,
    opening: Time,
    dt: f64,
}

/// What a piece is given from outside.
pub struct Over {
    pub open: bool,
    pub set: Input,
    pub set0: f64,
    /// The integral of the set point since the record's start, at the piece's start [s].
    pub integral: f64,
    /// What is fed of the set point: the speed error's part, and its integral.
    pub error: Series,
    pub summed: Series,
    /// What came back a dead time ago.
    pub back: Series,
    pub load: [f64; 2],
    /// What the rack is fed of all that.
    pub feed: Series,
}

impl<'a> Outside<'a> {
    /// At a record's start, with so many places for the past.
    pub fn new(run: &Run<'a>, model: &Model, places: usize) -> Self {
        let dead_time = model.t_d / run.dt;
        let load = || Feed::new(run.load, run.hold, run.dt, 0.0);
        Self {
            set: Feed::new(run.set, run.hold, run.dt, dead_time + model.t_set / run.dt),
            load: (!run.load.is_empty()).then(load),
            set0: run.set[0],
            backs: vec![[0.0; 8]; places.max(1)],
            opening: Time::new(dead_time),
            dt: run.dt,
        }
    }

    /// Over a piece, whose length [s] is given by its inverse.
    #[inline(always)]
    pub fn over<const T: usize>(
        &mut self,
        model: &Model,
        piece: &Piece,
        window: Option<&Window>,
        inverse: f64,
    ) -> Over {
        let length = piece.length * self.dt;
        let set = self.set.over(piece);
        let load = self.load.as_mut().map_or([0.0; 2], |feed| {
            let load = feed.over(piece);
            [load.value, load.slope]
        });
        let back = window.map_or([0.0; 8], |window| past_value::<T>(window, &self.backs));
        let since = piece.start.since(self.opening) * self.dt;
        let integral = set.integral + model.t_set * (self.set0 - 1.0) + since;
        let (error, summed) = errors(model, &set, length, integral, since);
        let mut feed: Series = [0.0; 8];
        if piece.open {
            for k in 3..T {
                feed[k] = -back[k];
            }
            feed[2] = model.k_i * summed[2] - back[2];
            feed[1] = model.k_p * error[1] + model.k_i * summed[1] - back[1];
            feed[0] = model.k_p * error[0] + model.k_i * summed[0] - back[0];
            feed[0] += model.base - model.ahead * (model.k_p * error[1] * inverse + model.k_i * error[0]);
            feed[1] -= model.ahead * model.k_i * error[1];
        } else {
            feed[0] = model.before;
        }
        Over { open: piece.open, set, set0: self.set0, integral, error, summed, back, load, feed }
    }

    /// Take up what goes back into the governor over a piece, for a dead time later; gives what came back over this one.
    #[inline(always)]
    pub fn returned<const T: usize>(
        &mut self,
        model: &Model,
        jets: &Jets,
        place: usize,
        over: &Over,
    ) -> Series {
        let returned = model.fed_back::<T>(jets);
        if model.t_d > 0.0 {
            self.backs[place] = returned;
            over.back
        } else {
            returned
        }
    }
}

/// The set point's part of the speed error, and its integral, as series.
#[inline(always)]
fn errors(model: &Model, set: &Input, length: f64, integral: f64, since: f64) -> (Series, Series) {
    let mut error = [0.0; 8];
    error[0] = model.s_u * set.value - 1.0;
    error[1] = model.s_u * set.slope;
    let mut summed = [0.0; 8];
    summed[0] = model.s_u * (integral - since) + (model.s_u - 1.0) * since;
    summed[1] = length * error[0];
    summed[2] = 0.5 * length * error[1];
    (error, summed)
}
