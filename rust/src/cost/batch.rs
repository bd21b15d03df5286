//! Costs of many parameter vectors: which are computed together in one pass, and which alone.

use rayon::prelude::*;

use super::many_vectors::{Course, LANES, Member, Stretch, scatter};
use super::{Cost, Objective, Products};
use crate::error::{Error, Result};
use crate::linear::delta_form::Increments;
use crate::linear::{Output, Parameters};
use crate::pool::on_threads;
use crate::stop::Stop;

/// Vectors that are computed together, by their places in the batch.
enum Group {
    Abreast { places: Vec<usize>, between: bool },
    Alone(usize),
}

impl Objective<'_> {
    /// The costs of many parameter vectors on so many threads, 0 for all cores; the same bits for any number.
    ///
    /// Without derivatives, and without a dead time in the loop, vectors go through the record abreast. That rounds otherwise
    /// than [`Objective::evaluate`] does. A vector whose simulation diverges costs infinity, and its derivatives are not numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] where no sample has every output, [`Error::Stopped`] on request, [`Error::Internal`] where the system
    /// gives no threads.
    pub fn evaluate_batch(
        &self,
        parameters: &[Parameters],
        threads: usize,
        stop: &Stop,
    ) -> Result<Vec<Cost>> {
        let batch = Batch::new(self, parameters);
        let costs: Vec<_> = if threads == 1 {
            batch.groups.iter().map(|group| batch.evaluate(group, stop)).collect::<Result<_>>()?
        } else {
            on_threads(threads.min(batch.groups.len().max(1)), || {
                batch.groups.par_iter().map(|group| batch.evaluate(group, stop)).collect()
            })?
        };
        let mut ordered = vec![self.infinite(); parameters.len()];
        for (place, cost) in costs.into_iter().flatten() {
            ordered[place] = cost;
        }
        Ok(ordered)
    }
}

struct Batch<'a> {
    objective: &'a Objective<'a>,
    parameters: &'a [Parameters],
    /// As recursions, where they are to go abreast.
    members: Vec<Option<Member>>,
    groups: Vec<Group>,
    stretches: Vec<Stretch>,
}

impl<'a> Batch<'a> {
    fn new(objective: &'a Objective<'a>, parameters: &'a [Parameters]) -> Self {
        let record = &objective.record;
        let (_, hold, _) = record.drive.parts();
        let dt = record.drive.dt();
        let fits = record.wrt.is_empty()
            && record.outputs.len() <= 2
            && record.outputs.iter().all(|output| !matches!(output, Output::IntegratedError | Output::Rack));
        let member = |parameters: &Parameters| {
            let increments = if fits { Increments::new(parameters, dt, hold) } else { None };
            increments.map(|increments| Member { parameters: *parameters, increments })
        };
        let members: Vec<_> = parameters.iter().map(member).collect();
        let mut groups = Vec::new();
        for between in [false, true] {
            let places: Vec<_> = (0..members.len())
                .filter(|&place| {
                    members[place].as_ref().is_some_and(|member| member.increments.is_late() == between)
                })
                .collect();
            groups.extend(
                places.chunks(LANES).map(|places| Group::Abreast { places: places.to_vec(), between }),
            );
        }
        groups.extend((0..members.len()).filter(|&place| members[place].is_none()).map(Group::Alone));
        let stretches = if fits { Stretch::of(record.measured, record.drive.samples()) } else { Vec::new() };
        Self { objective, parameters, members, groups, stretches }
    }

    fn evaluate(&self, group: &Group, stop: &Stop) -> Result<Vec<(usize, Cost)>> {
        match group {
            Group::Alone(place) => Ok(vec![(*place, self.alone(*place, stop)?)]),
            Group::Abreast { places, between } => {
                let products = match (self.objective.record.outputs.as_slice(), between) {
                    (&[one], false) => self.scatter::<1, false>(places, [one], stop)?,
                    (&[one], true) => self.scatter::<1, true>(places, [one], stop)?,
                    (&[one, other], false) => self.scatter::<2, false>(places, [one, other], stop)?,
                    (&[one, other], true) => self.scatter::<2, true>(places, [one, other], stop)?,
                    _ => Vec::new(),
                };
                let cost = |(&place, products): (&usize, Products)| {
                    // A vector whose costs are not finite is computed again alone, which gives the reason.
                    let finite = products.count > 0 && products.values.iter().all(|value| value.is_finite());
                    let cost =
                        if finite { self.objective.weigh(&products) } else { self.alone(place, stop)? };
                    Ok((place, cost))
                };
                places.iter().zip(products).map(cost).collect()
            }
        }
    }

    fn alone(&self, place: usize, stop: &Stop) -> Result<Cost> {
        match self.objective.evaluate(&self.parameters[place], stop) {
            Err(Error::Diverged { .. }) => Ok(self.objective.infinite()),
            outcome => outcome,
        }
    }

    /// The products of each vector's residuals.
    fn scatter<const O: usize, const BETWEEN: bool>(
        &self,
        places: &[usize],
        outputs: [Output; O],
        stop: &Stop,
    ) -> Result<Vec<Products>> {
        let record = &self.objective.record;
        let (set, _, initial) = record.drive.parts();
        // The speed's residual is the cheaper one where it comes first.
        let last = O - 1;
        let swap = outputs[0] != Output::Speed && outputs[last] == Output::Speed;
        let order: [usize; O] = std::array::from_fn(|i| if swap { last - i } else { i });
        let outputs = order.map(|i| outputs[i]);
        let measured = order.map(|i| &record.measured[i * set.len()..][..set.len()]);
        let course = Course { set, initial, measured, stretches: &self.stretches };
        let known: Vec<&Member> = places.iter().filter_map(|&place| self.members[place].as_ref()).collect();
        let members = std::array::from_fn(|lane| known[lane.min(known.len() - 1)]);
        let sums = if outputs[0] == Output::Speed {
            scatter::<O, true, BETWEEN>(members, outputs, &course, stop)?
        } else {
            scatter::<O, false, BETWEEN>(members, outputs, &course, stop)?
        };
        let count = Stretch::count(&self.stretches);
        let products = |lane: usize| {
            let value = |i: usize, j: usize| sums[order[i].min(order[j])][order[i].max(order[j])][lane];
            let values = (0..O * O).map(|at| value(at / O, at % O)).collect();
            Products { values, columns: 1, count }
        };
        Ok((0..places.len()).map(products).collect())
    }
}
