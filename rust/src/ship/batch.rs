//! Many ships against one record.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::pool::on_threads;
use crate::stop::Stop;

use super::parameters::Parameters;
use super::products::{Record, Sums};

impl Record<'_> {
    /// The sums for many ships on so many threads, 0 for all cores; the same bits for any number. Those of a ship whose
    /// simulation diverges are infinite, and none of its samples counts.
    ///
    /// # Errors
    /// [`Error::Invalid`] for what can't be differentiated by, [`Error::Stopped`] on request, [`Error::Internal`] where the system
    /// gives no threads.
    pub fn batch(&self, ships: &[Parameters], threads: usize, stop: &Stop) -> Result<Vec<Sums>> {
        let of_one = |ship: &Parameters| match self.sums(ship, stop) {
            Err(Error::Diverged { .. }) => Ok(self.infinite()),
            outcome => outcome,
        };
        if threads == 1 || ships.len() <= 1 {
            return ships.iter().map(of_one).collect();
        }
        on_threads(threads, || ships.par_iter().map(of_one).collect())
    }

    fn infinite(&self) -> Sums {
        let columns = self.directions() + 2;
        let length = (self.outputs() * columns).pow(2);
        Sums { values: vec![f64::INFINITY; length], columns, count: 0 }
    }
}
