//! A torsionally flexible shaft between two inertias: the exact step of its linear equations.
//!
//! ```text
//! tau_1 dN/dt = M_b - Q        tau_prop dP/dt = Q - L        tau_twist dS/dt = N - P        Q = S + zeta (N - P)
//! ```
//! with torques `M_b` and `L` that are linear over the step. The limit of a stiff shaft is a single inertia.

use nalgebra::SMatrix;

use crate::subnormal::cut;

use super::parameters::{Parameters, at};

/// States and constants of a torsionally flexible shaft.
#[derive(Debug)]
pub struct Twist {
    shaft: Shaft,
    zeta: f64,
    /// Inverse of the engine's and of the propeller's inertia [1/s].
    pub inverse: f64,
    pub inverse_prop: f64,
    /// Speed of the propeller, and torque of the shaft's spring.
    pub propeller: f64,
    spring: f64,
    /// Changes of the propeller's acceleration and of the shaft's torque over the last step.
    pub propeller_growth: f64,
    pub torque_growth: f64,
}

impl Twist {
    /// A shaft with an initial speed and spring torque; None if it is stiff.
    pub fn new(parameters: &Parameters, h: f64, [speed, spring]: [f64; 2]) -> Option<Self> {
        (parameters.of(at::TAU_TWIST) > 0.0).then(|| {
            let [tau, prop, twist, zeta] =
                [at::TAU_N, at::TAU_PROP, at::TAU_TWIST, at::ZETA_TWIST].map(|place| parameters.of(place));
            Self {
                shaft: Shaft::new([tau, prop, twist, zeta], h),
                zeta,
                inverse: 1.0 / (tau - prop),
                inverse_prop: 1.0 / prop,
                propeller: speed,
                spring,
                propeller_growth: 0.0,
                torque_growth: 0.0,
            }
        })
    }

    /// Torque of the shaft at an engine speed.
    #[inline(always)]
    pub fn torque(&self, speed: f64) -> f64 {
        self.spring + (speed - self.propeller) * self.zeta
    }

    /// Advance a step with linear torques of engine and load; return the engine's speed at its end.
    #[inline(always)]
    pub fn go(&mut self, speed: f64, brake: [f64; 2], load: [f64; 2]) -> f64 {
        let [speed, propeller, spring] = self.shaft.after([speed, self.propeller, self.spring], brake, load);
        (self.propeller, self.spring) = (propeller, spring);
        speed
    }

    /// Set decayed values to zero.
    pub fn cut(&mut self) {
        for number in
            [&mut self.propeller, &mut self.spring, &mut self.propeller_growth, &mut self.torque_growth]
        {
            *number = cut(*number);
        }
    }
}

/// Coefficients of a step: rows N, P, S; columns N, P, S, `M_b` at both ends, `L` at both ends.
#[derive(Debug)]
struct Shaft {
    rows: [[f64; 7]; 3],
}

impl Shaft {
    /// From `tau_n`, `tau_prop`, `tau_twist`, `zeta_twist` and the step [s].
    fn new(parameters: [f64; 4], h: f64) -> Self {
        let found = coefficients(parameters, h);
        Self { rows: std::array::from_fn(|row| std::array::from_fn(|column| found[(row, column)])) }
    }

    /// Speeds and spring torque at the end of a step.
    #[inline(always)]
    fn after(&self, state: [f64; 3], brake: [f64; 2], load: [f64; 2]) -> [f64; 3] {
        let inputs = [state[0], state[1], state[2], brake[0], brake[1], load[0], load[1]];
        self.rows.map(|row| row.iter().zip(inputs).map(|(factor, input)| factor * input).sum())
    }
}

fn coefficients([tau_n, tau_prop, tau_twist, zeta]: [f64; 4], h: f64) -> SMatrix<f64, 3, 7> {
    let tau_1 = tau_n - tau_prop;
    // States N, P, S; inputs M_b and L; their slopes over the step.
    let mut a = SMatrix::<f64, 7, 7>::zeros();
    for (row, tau, sign) in [(0, tau_1, -1.0), (1, tau_prop, 1.0)] {
        a[(row, 0)] = sign * zeta / tau;
        a[(row, 1)] = -sign * zeta / tau;
        a[(row, 2)] = sign / tau;
    }
    (a[(2, 0)], a[(2, 1)]) = (1.0 / tau_twist, -1.0 / tau_twist);
    (a[(0, 3)], a[(1, 4)]) = (1.0 / tau_1, -1.0 / tau_prop);
    (a[(3, 5)], a[(4, 6)]) = (1.0 / h, 1.0 / h);
    let e = (a * h).exp();
    SMatrix::from_fn(|row, column| match column {
        0..=2 => e[(row, column)],
        3 => e[(row, 3)] - e[(row, 5)],
        4 => e[(row, 5)],
        5 => e[(row, 4)] - e[(row, 6)],
        _ => e[(row, 6)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stiff_shaft_is_one_inertia_and_a_soft_one_swings_at_its_frequency() {
        // The shaft transmits the load and the propeller side's share of the excess torque.
        let begun = [1.0, 1.0, 1.08];
        let stiff = Shaft::new([1.0, 0.4, 1e-9, 1.0], 0.01).after(begun, [1.2, 1.2], [1.0, 1.0]);
        assert!((stiff[0] - 1.002).abs() < 1e-6 && (stiff[1] - 1.002).abs() < 1e-6, "{stiff:?}");
        // Inertias 0.6 and 0.4 s on tau_twist: w^2 = (1 / 0.6 + 1 / 0.4) / tau_twist.
        let twist: f64 = 4e-3;
        let period = std::f64::consts::TAU / ((1.0 / 0.6 + 1.0 / 0.4) / twist).sqrt();
        let after = Shaft::new([1.0, 0.4, twist, 0.0], period).after([1.01, 1.0, 1.0], [1.0; 2], [1.0; 2]);
        assert!((after[0] - after[1] - 0.01).abs() < 1e-9, "{after:?}");
    }
}
