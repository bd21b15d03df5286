//! Exact frequency response of the linear structure, dead times included, with its derivatives.

use std::f64::consts::TAU;

use nalgebra::Complex;

use super::parameters::{By, OUTPUTS, Output, PARAMETERS, Parameters};
use crate::error::{Error, Result, require};
use crate::stop::{CHECK_EVERY, Stop};

type C = Complex<f64>;

/// Frequency responses from the set point, and their derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// `[output, frequency]`, row after row.
    pub values: Vec<C>,
    /// `[wrt, output, frequency]`, row after row.
    pub derivatives: Vec<C>,
}

/// Value and derivatives by all parameters.
#[derive(Clone, Copy)]
struct Jet {
    value: C,
    by: [C; PARAMETERS.len()],
}

impl Jet {
    const fn constant(value: C) -> Self {
        Self { value, by: [C::ZERO; PARAMETERS.len()] }
    }

    /// The parameter of that index.
    fn parameter(index: usize, value: f64) -> Self {
        let mut jet = Self::constant(C::new(value, 0.0));
        jet.by[index] = C::ONE;
        jet
    }

    fn combine(self, other: Self, value: C, slope: C, other_slope: C) -> Self {
        Self { value, by: std::array::from_fn(|i| slope * self.by[i] + other_slope * other.by[i]) }
    }

    fn exp(self) -> Self {
        let value = self.value.exp();
        Self { value, by: self.by.map(|slope| value * slope) }
    }
}

impl std::ops::Add for Jet {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.combine(other, self.value + other.value, C::ONE, C::ONE)
    }
}

impl std::ops::Sub for Jet {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.combine(other, self.value - other.value, C::ONE, -C::ONE)
    }
}

impl std::ops::Mul for Jet {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.combine(other, self.value * other.value, other.value, self.value)
    }
}

impl std::ops::Div for Jet {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        self.combine(other, value, other.value.inv(), -value / other.value)
    }
}

/// All outputs at one complex frequency `s`.
///
/// Every transfer function is written over `s (tau_n s + p - g) + v (K_p s + K_i) exp(-s T_d)`, without a division by `s`,
/// so that `s = 0` gives the static gains 1, (p-g)/(v `K_i`), p, p, (p-g)/v.
fn transfer(parameters: &Parameters, s: C) -> [Jet; OUTPUTS.len()] {
    let Parameters { tau_n, g, v, k_p, k_i, p, tau_prop, t_d, t_set } = *parameters;
    let [tau_n, g, v, k_p, k_i, p, tau_prop, t_d, t_set] = {
        let vector = [tau_n, g, v, k_p, k_i, p, tau_prop, t_d, t_set];
        std::array::from_fn(|i| Jet::parameter(i, vector[i]))
    };
    let s = Jet::constant(s);
    let minus_s = Jet::constant(-s.value);
    let plant = tau_n * s + p - g;
    let governor = k_p * s + k_i;
    let forward = v * governor * (minus_s * t_d).exp();
    let common = (minus_s * t_set).exp() / (s * plant + forward);
    let speed = forward * common;
    let error = plant * common;
    [speed, error, (p + tau_n * s) * speed, (p + tau_prop * s) * speed, governor * error]
}

/// Frequency responses from the set point to `outputs`, and their derivatives by the parameters `wrt`.
///
/// # Errors
/// [`Error::Invalid`] for a frequency that is negative or not finite, one at which the response is infinite
/// (0 Hz without integral action), and on a stop.
///
/// # Panics
/// Where `wrt` names an initial value.
pub fn response(
    parameters: &Parameters,
    frequency_hz: &[f64],
    outputs: &[Output],
    wrt: &[By],
    stop: &Stop,
) -> Result<Response> {
    let (count, rows) = (frequency_hz.len(), outputs.len());
    let mut values = vec![C::ZERO; rows * count];
    let mut derivatives = vec![C::ZERO; wrt.len() * rows * count];
    for (column, &frequency) in frequency_hz.iter().enumerate() {
        if column % CHECK_EVERY == 0 {
            stop.check()?;
        }
        require(frequency.is_finite() && frequency >= 0.0, || {
            format!("frequency_hz[{column}]: found {frequency}, expected a finite frequency of 0 Hz or more")
        })?;
        let all = transfer(parameters, C::new(0.0, TAU * frequency));
        for (row, &output) in outputs.iter().enumerate() {
            let jet = &all[output as usize];
            if !jet.value.is_finite() {
                return Err(Error::Invalid(format!(
                    "frequency_hz[{column}]: the response of {} is infinite at {frequency} Hz; at 0 Hz the structure needs v K_i other than 0",
                    OUTPUTS[output as usize]
                )));
            }
            values[row * count + column] = jet.value;
            for (index, &by) in wrt.iter().enumerate() {
                derivatives[(index * rows + row) * count + column] = jet.by[by as usize];
            }
        }
    }
    Ok(Response { values, derivatives })
}
