//! A run with derivatives, by the shortest way that its subject allows.

use crate::drive_train::Run;
use crate::error::Result;
use crate::stop::{CHECK_EVERY, Stop};

use super::full_train::through_whole;
use super::output::{Consume, Output};
use super::parameters::Subject;
use super::two_state::through_plant;

/// March a subject through a run, and give the chosen outputs to `consume` in blocks of at most so many samples: the
/// first sample, then for each sample a number an output.
pub fn march<const N: usize>(
    subject: &Subject,
    run: &Run<'_>,
    outputs: &[Output],
    block: usize,
    stop: &Stop,
    consume: &mut Consume<'_, N>,
) -> Result<()> {
    let block = block.min((CHECK_EVERY / run.substeps).max(1));
    if !subject.is_plant() {
        return through_whole(subject, run, outputs, block, stop, consume);
    }
    through_plant(subject, run, outputs, block, stop, consume)
}
