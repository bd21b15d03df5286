//! How outputs and their sensitivities are made of a few signals of the loop and the derivatives of these.
//!
//! Every output is a combination of n, E, n' and u1, with parameters as coefficients, and the loop depends on the parameters
//! through its rates, dead times and initial state only. So a pass over the samples carries the signals and their derivatives
//! in these few directions; the chain rule is applied to the finished rows.

use super::discrete::{BY_A, BY_B, BY_C, BY_START_E, BY_START_N, BY_T_D, BY_T_SET, DIRECTIONS, rates};
use super::parameters::{By, Output, Parameters};

/// Signals that outputs are made of: n, E, n', u1.
pub const SIGNALS: usize = 4;
pub const N: usize = 0;
pub const E: usize = 1;
pub const SLOPE: usize = 2;
pub const SET: usize = 3;

/// The rows that a pass must carry: for the value and each direction in turn, every signal wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Basis {
    pub signals: Vec<usize>,
    pub directions: Vec<usize>,
}

impl Basis {
    /// What `outputs` and their derivatives by `wrt` need.
    pub fn new(outputs: &[Output], wrt: &[By]) -> Self {
        let signals = (0..SIGNALS)
            .filter(|&signal| outputs.iter().any(|&output| uses(output).contains(&signal)))
            .collect();
        let directions =
            (0..DIRECTIONS).filter(|direction| wrt.iter().any(|&by| moves(by).contains(direction))).collect();
        Self { signals, directions }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.signals.len() * (1 + self.directions.len())
    }

    /// Whether the delay network is needed even for a dead time of 0: its derivative starts there.
    pub fn needs_network(&self) -> bool {
        self.directions.contains(&BY_T_D)
    }

    /// An output as a combination of the rows.
    pub fn output(&self, output: Output, parameters: &Parameters) -> Vec<f64> {
        let mut combination = vec![0.0; self.rows()];
        self.add(&mut combination, None, 1.0, &coefficients(output, parameters));
        combination
    }

    /// The derivative of an output by `by` as a combination of the rows.
    pub fn sensitivity(&self, output: Output, by: By, parameters: &Parameters) -> Vec<f64> {
        let mut combination = vec![0.0; self.rows()];
        self.add(&mut combination, None, 1.0, &coefficients_by(output, by));
        let along = along(by, parameters);
        for &direction in moves(by) {
            self.add(&mut combination, Some(direction), along[direction], &coefficients(output, parameters));
        }
        combination
    }

    fn add(
        &self,
        combination: &mut [f64],
        direction: Option<usize>,
        factor: f64,
        coefficients: &[f64; SIGNALS],
    ) {
        let group = direction.map_or(Some(0), |direction| {
            self.directions.iter().position(|&known| known == direction).map(|position| position + 1)
        });
        if let Some(group) = group {
            for (position, &signal) in self.signals.iter().enumerate() {
                combination[group * self.signals.len() + position] += factor * coefficients[signal];
            }
        }
    }
}

fn uses(output: Output) -> &'static [usize] {
    match output {
        Output::Speed => &[N],
        Output::IntegratedError => &[E],
        Output::EngineTorque | Output::GaugeTorque => &[N, SLOPE],
        Output::Rack => &[N, E, SET],
    }
}

pub fn coefficients(output: Output, parameters: &Parameters) -> [f64; SIGNALS] {
    let Parameters { tau_n, k_p, k_i, p, tau_prop, .. } = *parameters;
    match output {
        Output::Speed => [1.0, 0.0, 0.0, 0.0],
        Output::IntegratedError => [0.0, 1.0, 0.0, 0.0],
        Output::EngineTorque => [p, 0.0, tau_n, 0.0],
        Output::GaugeTorque => [p, 0.0, tau_prop, 0.0],
        Output::Rack => [-k_p, k_i, 0.0, k_p],
    }
}

/// Derivative of the coefficients.
fn coefficients_by(output: Output, by: By) -> [f64; SIGNALS] {
    match (output, by) {
        (Output::EngineTorque, By::TauN) | (Output::GaugeTorque, By::TauProp) => [0.0, 0.0, 1.0, 0.0],
        (Output::EngineTorque | Output::GaugeTorque, By::P) => [1.0, 0.0, 0.0, 0.0],
        (Output::Rack, By::KP) => [-1.0, 0.0, 0.0, 1.0],
        (Output::Rack, By::KI) => [0.0, 1.0, 0.0, 0.0],
        _ => [0.0; SIGNALS],
    }
}

/// The directions in which the loop moves.
fn moves(by: By) -> &'static [usize] {
    match by {
        By::TauN => &[BY_A, BY_B, BY_C],
        By::G | By::P => &[BY_A],
        By::V => &[BY_B, BY_C],
        By::KP => &[BY_B],
        By::KI => &[BY_C],
        By::TauProp => &[],
        By::TD => &[BY_T_D],
        By::TSet => &[BY_T_SET],
        By::InitialN => &[BY_START_N],
        By::InitialE => &[BY_START_E],
    }
}

/// How far it moves in each direction.
fn along(by: By, parameters: &Parameters) -> [f64; DIRECTIONS] {
    let Parameters { tau_n, v, k_p, k_i, .. } = *parameters;
    let mut along = [0.0; DIRECTIONS];
    match by {
        By::TauN => along[..3].copy_from_slice(&rates(parameters).map(|rate| -rate / tau_n)),
        By::G => along[BY_A] = -1.0 / tau_n,
        By::P => along[BY_A] = 1.0 / tau_n,
        By::V => (along[BY_B], along[BY_C]) = (k_p / tau_n, k_i / tau_n),
        By::KP => along[BY_B] = v / tau_n,
        By::KI => along[BY_C] = v / tau_n,
        By::TauProp => {}
        By::TD => along[BY_T_D] = 1.0,
        By::TSet => along[BY_T_SET] = 1.0,
        By::InitialN => along[BY_START_N] = 1.0,
        By::InitialE => along[BY_START_E] = 1.0,
    }
    along
}
