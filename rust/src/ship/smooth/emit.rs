//! Outputs at the samples, out of the pieces they lie in, and their way into blocks.

use multiversion::multiversion;
use pulp::Simd;

use crate::error::Result;
use crate::ship::march::{BLOCK, Block, Consume, Task};
use crate::ship::output::Output;
use crate::ship::parameters::at;
use crate::ship::run::Run;

use super::feed::Feed;
use super::grid::{Piece, Time};
use super::model::{Jets, Model};
use super::power::Power;
use super::reading::{OWN, OfTorque, Reading, weighed};
use super::slopes::{Course, LANES, Pack, get, put};
use super::steps::Step;

/// Outputs that are late by the same time.
struct Channel {
    /// [s].
    late: f64,
    /// Places among the outputs.
    outputs: Vec<usize>,
    /// The sample that is to come.
    next: usize,
}

/// An output's sample that lies in the piece, its slot, and what parameters add to its derivatives by themselves.
#[derive(Debug, Clone, Copy)]
struct Point {
    output: usize,
    sample: usize,
    slot: usize,
    own: [f64; OWN],
}

/// Outputs on their way: for each, a row of lanes a sample, and its values.
pub struct Emit<'a> {
    model: Model,
    run: Run<'a>,
    wrt: &'a [usize],
    channels: Vec<Channel>,
    pub readings: Vec<Reading>,
    /// Of the engine's torque before the record.
    torque: OfTorque,
    points: Vec<Point>,
    /// Samples of room.
    room: usize,
    packs: usize,
    pub slopes: Vec<Pack>,
    pub values: Vec<f64>,
    sum: Option<Feed<'a>>,
    /// Of the command's constant part.
    base: Vec<f64>,
    block: Block,
}

impl<'a> Emit<'a> {
    /// For a record that begins with an engine whose torque is that of a model, and has these parameters.
    pub fn new(model: &Model, torque: (&Model, OfTorque), task: &Task<'a>, run: &Run<'a>) -> Self {
        let samples = run.samples();
        let late = |output: Output| match output {
            Output::Speed | Output::PropellerSpeed => task.parameters.of(at::T_N),
            Output::EngineTorque | Output::GaugeTorque => task.parameters.of(at::T_M),
            Output::Rack | Output::Sum => 0.0,
        };
        let mut channels: Vec<Channel> = Vec::new();
        for (place, &output) in task.outputs.iter().enumerate() {
            let late = late(output);
            match channels.iter_mut().find(|channel| channel.late.total_cmp(&late).is_eq()) {
                Some(channel) => channel.outputs.push(place),
                None => channels.push(Channel { late, outputs: vec![place], next: 0 }),
            }
        }
        // Those from before the record, as far as it goes.
        let before = |late: f64| (0..samples).take_while(|&k| (k as f64) < late / run.dt - 1e-9).count();
        let ahead = channels.iter().map(|channel| before(channel.late)).max().unwrap_or(0);
        let room = BLOCK + ahead + 2 + LANES;
        let set0 = run.set[0];
        let load0 = run.load.first().copied().unwrap_or(0.0);
        let (outputs, packs) = (task.outputs.len(), task.wrt.len().div_ceil(LANES));
        let mut emit = Self {
            model: *model,
            run: *run,
            wrt: task.wrt,
            channels,
            readings: readings(torque.0, task, torque.1),
            torque: torque.1,
            points: Vec::with_capacity(outputs),
            room,
            packs,
            slopes: vec![Pack::ZERO; outputs * room * packs],
            values: vec![0.0; outputs * room],
            sum: task
                .outputs
                .contains(&Output::Sum)
                .then(|| Feed::new(run.set, run.hold, run.dt, model.t_set / run.dt)),
            base: task.wrt.iter().map(|&place| model.base_by(place, set0, load0)).collect(),
            block: Block::new(outputs, task.wrt.len()),
        };
        for channel in 0..emit.channels.len() {
            for sample in 0..before(emit.channels[channel].late) {
                for at in 0..emit.channels[channel].outputs.len() {
                    emit.hold(emit.channels[channel].outputs[at], sample);
                }
                emit.channels[channel].next += 1;
            }
        }
        emit
    }

    /// How late each channel is [sample intervals], and how many of its samples lie before the record.
    pub fn channels(&self) -> Vec<(f64, usize)> {
        self.channels.iter().map(|channel| (channel.late / self.run.dt, channel.next)).collect()
    }

    /// Places of the outputs of each channel.
    pub fn outputs(&self) -> impl Iterator<Item = &[usize]> {
        self.channels.iter().map(|channel| channel.outputs.as_slice())
    }

    /// The slot of an output for the sample that comes so many after the next, if the record reaches as far.
    #[inline(always)]
    pub fn slot(&self, output: usize, channel: usize, after: usize) -> Option<usize> {
        let sample = self.channels[channel].next + after;
        (sample < self.run.set.len()).then(|| output * self.room + sample - self.block.from)
    }

    /// So many samples of each output are laid.
    #[inline(always)]
    pub fn passed(&mut self, samples: usize) {
        for channel in &mut self.channels {
            channel.next = self.run.set.len().min(channel.next + samples);
        }
    }

    /// Whether all outputs have all samples.
    #[inline(always)]
    pub fn is_done(&self) -> bool {
        let samples = self.run.set.len();
        let mut done = true;
        for channel in &self.channels {
            done &= channel.next >= samples;
        }
        done
    }

    /// Read the values of all samples that lie in a piece, and note what of the derivatives makes theirs.
    #[inline(always)]
    pub fn aim<const T: usize>(&mut self, step: &Step, jets: &Jets) {
        self.points.clear();
        for channel in 0..self.channels.len() {
            let next = self.channels[channel].next;
            let Some(part) = step.samples[channel].filter(|_| next < self.run.set.len()) else { continue };
            self.channels[channel].next += 1;
            for at in 0..self.channels[channel].outputs.len() {
                let output = self.channels[channel].outputs[at];
                let reading = &mut self.readings[output];
                if (reading.part, reading.inverse) != (part, jets.inverse) {
                    reading.aim::<T>(part, jets.inverse);
                }
                let slot = output * self.room + next - self.block.from;
                let simulated = reading.simulated::<T>(jets);
                let own = if reading.own.is_empty() {
                    [0.0; OWN]
                } else {
                    reading.sizes::<T>(&self.model, jets, simulated)
                };
                self.values[slot] = simulated;
                self.points.push(Point { output, sample: next, slot, own });
            }
        }
    }

    /// The derivatives of these samples, of one register: `signals` are the speed, the rack and the integrated speed, `ends` a
    /// flexible shaft's propeller and spring.
    #[inline(always)]
    pub fn lay<S: Simd, const T: usize>(
        &mut self,
        simd: S,
        [n, rack, q]: [&Course<S>; 3],
        ends: Option<[&Course<S>; 2]>,
        pack: usize,
        part: usize,
    ) {
        // By numbers: an iterator that is not inlined would not be compiled for the machine's vectors.
        for point in 0..self.points.len() {
            let Point { output, slot, own, .. } = &self.points[point];
            let reading = &self.readings[*output];
            let mut total = weighed::<S, T>(simd, &reading.speeds, n);
            if let Some(racks) = &reading.racks {
                total = simd.add_f64s(total, weighed::<S, T>(simd, racks, rack));
            }
            if let Some(sums) = &reading.sums {
                total = simd.add_f64s(total, weighed::<S, T>(simd, sums, q));
            }
            if let (Some([propellers, springs]), Some([propeller, spring])) = (&reading.ends, ends) {
                total = simd.add_f64s(total, weighed::<S, T>(simd, propellers, propeller));
                total = simd.add_f64s(total, weighed::<S, T>(simd, springs, spring));
            }
            for mark in 0..reading.own.len() {
                let (size, packs) = &reading.own[mark];
                total = simd.mul_add_e_f64s(get::<S>(&packs[pack], part), simd.splat_f64s(own[*size]), total);
            }
            put::<S>(&mut self.slopes[slot * self.packs + pack], part, total);
        }
    }

    /// What the set point adds to the governor's sum at these samples.
    #[inline(always)]
    pub fn add_sums(&mut self) {
        if self.sum.is_some() {
            for point in 0..self.points.len() {
                let Point { output, sample, slot, .. } = self.points[point];
                if self.readings[output].output == Output::Sum {
                    self.add_sum(slot, sample);
                }
            }
        }
    }

    /// What the set point adds to the governor's sum.
    fn add_sum(&mut self, slot: usize, sample: usize) {
        let Model { k_i, s_u, t_set, base, .. } = self.model;
        let (set0, dt) = (self.run.set[0], self.run.dt);
        let Some(feed) = &mut self.sum else { return };
        #[allow(clippy::cast_possible_wrap)] // a record's length
        let start = Time { whole: sample as isize, part: 0.0 };
        let set = feed.over(&Piece { start, length: 1.0, cut: None, open: true });
        let time = sample as f64 * dt;
        let summed = set.integral + t_set * (set0 - 1.0) + time;
        let acts = k_i != 0.0;
        self.values[slot] += s_u * summed - time + if acts { base / k_i } else { 0.0 };
        for (lane, &place) in self.wrt.iter().enumerate() {
            let mut own = if acts { self.base[lane] / k_i } else { 0.0 };
            own += match place {
                at::S_U => summed,
                at::T_SET => -s_u * (set.value - set0),
                at::K_I if acts => -base / (k_i * k_i),
                _ => 0.0,
            };
            self.slopes[slot * self.packs + lane / LANES].0[lane % LANES] += own;
        }
    }

    /// An output before the record.
    fn hold(&mut self, output: usize, sample: usize) {
        let slot = output * self.room + sample - self.block.from;
        let Model { n0, s_m, before, .. } = self.model;
        let [g, v, ..] = self.readings[output].factors;
        let load0 = self.run.load.first().copied().unwrap_or(0.0);
        let power = Power::at(1.0 + n0, self.model.p);
        let (damping, gain) = (self.model.damping, self.model.load_gain);
        let drag = power.value + damping * n0 + gain * load0;
        let (level, gauge) = match self.readings[output].output {
            Output::EngineTorque => {
                ((self.readings[output].constant + g * n0 + v * before + 1.0) / s_m, false)
            }
            Output::GaugeTorque => (drag, true),
            _ => (0.0, false),
        };
        let speed = matches!(self.readings[output].output, Output::Speed | Output::PropellerSpeed);
        self.values[slot] = if speed { n0 } else { s_m * level - 1.0 };
        for lane in 0..self.wrt.len() {
            let own = match (self.wrt.get(lane), speed, gauge) {
                (Some(&at::INITIAL_N), true, _) => 1.0,
                (None, ..) | (_, true, _) => 0.0,
                (Some(&at::S_M), ..) => level,
                (Some(&at::INITIAL_N), _, true) => s_m * (power.slope(self.model.p) + damping),
                (Some(&at::P), _, true) => s_m * power.by_exponent(),
                (Some(&at::DAMPING), _, true) => s_m * n0,
                (Some(&at::LOAD_GAIN), _, true) => s_m * load0,
                (Some(&at::INITIAL_N), _, false) => g,
                (Some(&at::INITIAL_F), _, false) => v / self.model.v,
                (place, _, false) if place == self.torque.slope.as_ref() => s_m * n0,
                (place, _, false) if place == self.torque.level.as_ref() => s_m,
                _ => 0.0,
            };
            self.slopes[slot * self.packs + lane / LANES].0[lane % LANES] = own;
        }
    }

    /// Hand over every block that is complete.
    #[inline(always)]
    pub fn flush(&mut self, consume: &mut Consume<'_>) -> Result<()> {
        let samples = self.run.samples();
        let complete = self.channels.iter().map(|channel| channel.next).min().unwrap_or(samples);
        while self.block.from < samples && complete >= samples.min(self.block.from + BLOCK) {
            self.hand_over(consume)?;
        }
        Ok(())
    }

    fn hand_over(&mut self, consume: &mut Consume<'_>) -> Result<()> {
        let (packs, directions) = (self.packs, self.wrt.len());
        let count = BLOCK.min(self.run.samples() - self.block.from);
        self.block.samples = count;
        for output in 0..self.readings.len() {
            let first = output * self.room;
            self.block.row_mut(output, directions)[..count]
                .copy_from_slice(&self.values[first..first + count]);
            for pack in 0..packs {
                let lanes = LANES.min(directions - pack * LANES);
                let rows = self.block.rows_of(output, pack * LANES, lanes);
                lay_out(&self.slopes[first * packs + pack..], packs, count, rows);
            }
            self.values.copy_within(first + count..first + self.room, first);
            self.slopes.copy_within((first + count) * packs..(first + self.room) * packs, first * packs);
        }
        consume(&self.block)?;
        self.block.from += count;
        Ok(())
    }
}

/// How each output is read.
pub fn readings(model: &Model, task: &Task<'_>, of: OfTorque) -> Vec<Reading> {
    task.outputs.iter().map(|&output| Reading::new(output, model, task.wrt, of)).collect()
}

/// Lay packs, so many apart, into a row of a block for each lane.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq", "x86_64+avx2"))]
fn lay_out(packs: &[Pack], apart: usize, count: usize, rows: &mut [f64]) {
    for first in (0..count).step_by(LANES) {
        let mut tile = [[0.0; LANES]; LANES];
        for (k, pack) in
            packs[first * apart..].iter().step_by(apart).take(LANES.min(count - first)).enumerate()
        {
            for lane in 0..LANES {
                tile[lane][k] = pack.0[lane];
            }
        }
        for (row, lane) in rows.chunks_exact_mut(BLOCK).zip(&tile) {
            row[first..first + LANES].copy_from_slice(lane);
        }
    }
}
