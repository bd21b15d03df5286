//! What an output reads of the signals' series at a part of a piece.

use pulp::Simd;

use crate::ship::output::Output;
use crate::ship::parameters::at;

use super::model::{Jets, Model, Series, for_terms, is_flexible};
use super::slopes::{Course, Pack, packs};

/// What parameters may add to an output by themselves: the speed, the rack, the rate of the speed, the level, the rate of the
/// output, how much faster a flexible shaft's engine turns, and the scale of the torque.
pub const OWN: usize = 7;

/// Places of the parameters that an engine's torque has: its slope by the speed, what the rack moves, and its level.
#[derive(Debug, Clone, Copy)]
pub struct OfTorque {
    pub slope: Option<usize>,
    pub rack: Option<usize>,
    pub level: Option<usize>,
}

impl OfTorque {
    /// That of an engine no limit holds.
    pub const FREE: Self = Self { slope: Some(at::G), rack: Some(at::V), level: None };
}

/// An output as a combination of signals, and which parameters count by themselves.
#[derive(Debug, Clone)]
pub struct Reading {
    pub output: Output,
    /// Of the speed, the rack, the rate of the speed and the integrated speed.
    pub factors: [f64; 4],
    /// Of the propeller's speed and the spring's torque of a flexible shaft.
    of_ends: [f64; 2],
    pub constant: f64,
    /// What parameters add by themselves, by the place in [`OWN`]: their lanes' marks, pack by pack.
    pub own: Vec<(usize, Vec<Pack>)>,
    /// Where in which piece it was last read, and what the terms of a signal and of its rate weigh there, and those of the speed,
    /// the rack, the integrated speed and a flexible shaft's ends in the output.
    pub part: f64,
    pub inverse: f64,
    pub powers: Series,
    pub rates: Series,
    pub speeds: Series,
    pub racks: Option<Series>,
    pub sums: Option<Series>,
    pub ends: Option<[Series; 2]>,
}

impl Reading {
    pub fn new(output: Output, model: &Model, wrt: &[usize], of: OfTorque) -> Self {
        let Model { g, v, s_m, tau, tau_prop, zeta, top, .. } = *model;
        let flexible = model.tau_twist > 0.0;
        let of_ends = match output {
            Output::PropellerSpeed if flexible => [1.0, 0.0],
            Output::GaugeTorque if flexible => [-s_m * zeta, s_m],
            _ => [0.0; 2],
        };
        let (factors, constant) = match output {
            Output::PropellerSpeed if flexible => ([0.0; 4], 0.0),
            Output::GaugeTorque if flexible => ([s_m * zeta, 0.0, 0.0, 0.0], s_m - 1.0),
            Output::Speed | Output::PropellerSpeed => ([1.0, 0.0, 0.0, 0.0], 0.0),
            Output::EngineTorque => ([s_m * g, s_m * v, 0.0, 0.0], s_m * (1.0 + top) - 1.0),
            // The load is the engine's torque less what speeds the shaft up.
            Output::GaugeTorque => {
                ([s_m * g, s_m * v, -s_m * (tau - tau_prop), 0.0], s_m * (1.0 + top) - 1.0)
            }
            Output::Rack => ([0.0, 1.0, 0.0, 0.0], 0.0),
            Output::Sum => ([0.0, 0.0, 0.0, -1.0], 0.0),
        };
        let torque = matches!(output, Output::EngineTorque | Output::GaugeTorque);
        let speed = matches!(output, Output::Speed | Output::PropellerSpeed);
        let gauge = output == Output::GaugeTorque;
        let twisted = gauge && flexible;
        let sign = |own: usize, place: usize| match (own, place) {
            (0, place) if Some(place) == of.slope && torque && !twisted => 1.0,
            (1, place) if Some(place) == of.rack && torque && !twisted => 1.0,
            (6, place) if Some(place) == of.level && torque && !twisted => 1.0,
            (2, at::TAU_N) if gauge && !twisted => -1.0,
            (2, at::TAU_PROP) if gauge && !twisted => 1.0,
            (3, at::S_M) if torque => 1.0,
            (4, at::T_M) if torque => -1.0,
            (4, at::T_N) if speed => -1.0,
            (5, at::ZETA_TWIST) if twisted => 1.0,
            _ => 0.0,
        };
        let own = (0..OWN).map(|own| (own, packs(wrt, |place| sign(own, place))));
        Self {
            output,
            factors,
            of_ends,
            constant,
            own: own.filter(|(_, packs)| packs.iter().any(|pack| *pack != Pack::ZERO)).collect(),
            part: f64::NAN,
            inverse: f64::NAN,
            powers: [0.0; 8],
            rates: [0.0; 8],
            speeds: [0.0; 8],
            racks: (factors[1] != 0.0).then_some([0.0; 8]),
            sums: (factors[3] != 0.0).then_some([0.0; 8]),
            ends: (of_ends != [0.0; 2]).then_some([[0.0; 8]; 2]),
        }
    }

    /// Weigh the terms for a part of a piece.
    pub fn aim<const T: usize>(&mut self, part: f64, inverse: f64) {
        let [of_speed, of_rack, of_rate, of_sum] = self.factors;
        let [of_propeller, of_spring] = self.of_ends;
        (self.part, self.inverse) = (part, inverse);
        let (mut power, mut before) = (1.0, 0.0);
        for k in 0..=T {
            (self.powers[k], self.rates[k]) = (power, inverse * k as f64 * before);
            self.speeds[k] = of_speed * power + of_rate * self.rates[k];
            if let Some(racks) = &mut self.racks {
                racks[k] = of_rack * power;
            }
            if let Some(sums) = &mut self.sums {
                sums[k] = of_sum * power;
            }
            if let Some([propellers, springs]) = &mut self.ends {
                (propellers[k], springs[k]) = (of_propeller * power, of_spring * power);
            }
            (before, power) = (power, power * part);
        }
    }

    /// The output where it was last aimed at.
    #[inline(always)]
    pub fn simulated<const T: usize>(&self, jets: &Jets) -> f64 {
        let mut simulated = self.constant + value::<T>(&self.speeds, &jets.n);
        if let Some(racks) = &self.racks {
            simulated += value::<T>(racks, &jets.rack);
        }
        if let Some(sums) = &self.sums {
            simulated += value::<T>(sums, &jets.q);
        }
        if let Some([propellers, springs]) = &self.ends {
            simulated += value::<T>(propellers, &jets.propeller) + value::<T>(springs, &jets.spring);
        }
        simulated
    }

    /// What parameters add by themselves, by the places of [`OWN`]; `simulated` is the output.
    #[inline(always)]
    pub fn sizes<const T: usize>(&self, model: &Model, jets: &Jets, simulated: f64) -> [f64; OWN] {
        let mut own = [0.0; OWN];
        let late = self.own.iter().any(|(own, _)| *own == 4);
        let [of_speed, of_rack, of_rate, _] = self.factors;
        let s_m = model.s_m;
        let rate = value::<T>(&self.rates, &jets.n);
        own[3] = (simulated + 1.0) / s_m;
        own[6] = s_m;
        match self.output {
            Output::PropellerSpeed if const { is_flexible(T) } => {
                own[4] = value::<T>(&self.rates, &jets.propeller);
            }
            Output::Speed | Output::PropellerSpeed => own[4] = rate,
            Output::GaugeTorque if const { is_flexible(T) } => {
                let slips = rate - value::<T>(&self.rates, &jets.propeller);
                own[4] = s_m * (value::<T>(&self.rates, &jets.spring) + model.zeta * slips);
                own[5] =
                    s_m * (value::<T>(&self.powers, &jets.n) - value::<T>(&self.powers, &jets.propeller));
            }
            Output::EngineTorque | Output::GaugeTorque => {
                own[0] = s_m * value::<T>(&self.powers, &jets.n);
                own[1] = s_m * value::<T>(&self.powers, &jets.rack);
                own[2] = s_m * rate;
                if late {
                    let second = jets.inverse * jets.inverse * second::<T>(&jets.n, self.part);
                    let faster = jets.inverse * self::rate::<T>(&jets.rack, self.part);
                    own[4] = of_speed * rate + of_rack * faster + of_rate * second;
                }
            }
            Output::Rack | Output::Sum => {}
        }
        own
    }
}

/// The terms of derivatives by their weights, of one register.
#[inline(always)]
pub fn weighed<S: Simd, const T: usize>(simd: S, weights: &Series, terms: &Course<S>) -> S::f64s {
    let mut sums = [simd.mul_f64s(simd.splat_f64s(weights[0]), terms[0]), simd.splat_f64s(0.0)];
    for_terms!(K of T => {
        sums[(K + 1) % 2] = simd.mul_add_e_f64s(simd.splat_f64s(weights[K + 1]), terms[K + 1], sums[(K + 1) % 2]);
    });
    simd.add_f64s(sums[0], sums[1])
}

/// The terms of a signal by their weights.
#[inline(always)]
pub fn value<const T: usize>(weights: &Series, series: &Series) -> f64 {
    let mut sum = 0.0;
    for k in 0..=T {
        sum += weights[k] * series[k];
    }
    sum
}

/// The rate of a signal at a part of a piece, a piece.
#[inline(always)]
pub fn rate<const T: usize>(series: &Series, part: f64) -> f64 {
    let mut sum = 0.0;
    for k in (0..T).rev() {
        sum = sum * part + (k + 1) as f64 * series[k + 1];
    }
    sum
}

/// The rate of that.
#[inline(always)]
pub fn second<const T: usize>(series: &Series, part: f64) -> f64 {
    let mut sum = 0.0;
    for k in (0..T - 1).rev() {
        sum = sum * part + ((k + 1) * (k + 2)) as f64 * series[k + 2];
    }
    sum
}
