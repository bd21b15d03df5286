//! The network delays, a leap is as many steps, and whole samples stay whole.

use nalgebra::{Complex, DMatrix, DVector};

use super::*;

const LAUNCH: [f64; 9] = [1.5, -0.583, 1.583, 4.0, 1.0, 2.0, 1.0, 0.12, 0.033];

fn parameters(vector: &[f64; 9]) -> Parameters {
    Parameters::new(vector, "parameters").expect("valid parameters")
}

/// The network alone, from z to y, at `omega T_d`: rows and columns 2 on of the matrix with `T_d` = 1 s.
fn network(omega: f64) -> Complex<f64> {
    let (zero, one) = (Number::ZERO, Number::ONE);
    let matrix = Loop { a: zero, b: zero, c: one, t_d: one }.matrix::<DELAYED>().part(None);
    let order = DELAYED - 2;
    let system = DMatrix::from_fn(order, order, |i, j| {
        let diagonal = if i == j { Complex::new(0.0, omega) } else { Complex::ZERO };
        diagonal - Complex::from(matrix[i + 2][j + 2])
    });
    let from_z = DVector::from_fn(order, |i, _| Complex::from(matrix[i + 2][1]));
    let states = system.lu().solve(&from_z).expect("the network has no pole on the axis");
    (0..order).map(|i| states[i] * matrix[0][i + 2]).sum()
}

#[test]
fn the_network_delays() {
    for (omega, tolerance) in [(0.0, 1e-14), (0.3, 1e-14), (1.0, 1e-11), (3.0, 2.4e-6), (6.0, 4.5e-3)] {
        let error = (network(omega) - Complex::new(0.0, -omega).exp()).norm();
        assert!(error <= tolerance, "error {error} at omega T_d = {omega}");
    }
}

#[test]
fn a_leap_is_as_many_steps() {
    let model = delayed(&parameters(&LAUNCH), 0.05, Hold::First, [0.1, -0.2], &[BY_A, BY_T_D, BY_T_SET], 11);
    let samples: [f64; LEAP + 2] = std::array::from_fn(|k| (k as f64).sin());
    let apply = |phi: &[[f64; DELAYED]; DELAYED], x: &[f64; DELAYED]| -> [f64; DELAYED] {
        phi.map(|row| row.iter().zip(x).map(|(factor, x)| factor * x).sum())
    };
    let fed = |taps: &[&[f64]; 2], at: usize| -> f64 {
        taps.iter().flat_map(|taps| taps.iter().zip(&samples[at..])).map(|(tap, sample)| tap * sample).sum()
    };
    let (mut x, mut by) = (model.start, model.start_by.clone());
    for k in 0..LEAP {
        for (s, step) in by.iter_mut().zip(&model.stepper.by) {
            let (from_s, from_x) = (apply(&model.stepper.step.phi, s), apply(&step.phi, &x));
            *s = std::array::from_fn(|i| {
                from_s[i] + from_x[i] + fed(&std::array::from_fn(|j| &step.taps[i][j][..]), k)
            });
        }
        let from_x = apply(&model.stepper.step.phi, &x);
        let taps = &model.stepper.step.taps;
        x = std::array::from_fn(|i| from_x[i] + fed(&std::array::from_fn(|j| &taps[i][j][..]), k));
    }
    let leap = apply(&model.leaper.step.phi, &model.start);
    for i in 0..DELAYED {
        let taps = &model.leaper.step.taps;
        let found = leap[i] + fed(&std::array::from_fn(|j| &taps[i][j][..]), 0);
        assert!((found - x[i]).abs() < 1e-12, "state {i}");
    }
    for ((step, start), expected) in model.leaper.by.iter().zip(&model.start_by).zip(&by) {
        let (from_s, from_x) = (apply(&model.leaper.step.phi, start), apply(&step.phi, &model.start));
        for i in 0..DELAYED {
            let found = from_s[i] + from_x[i] + fed(&std::array::from_fn(|j| &step.taps[i][j][..]), 0);
            assert!((found - expected[i]).abs() < 1e-11 * (1.0 + expected[i].abs()), "state {i}");
        }
    }
}

/// Constant set point: what comes in over a step must not depend on where the hold has its corner.
#[test]
fn taps_sum_to_the_response_to_a_constant() {
    let mut vector = LAUNCH;
    let mut sums = Vec::new();
    for t_set in [0.0, 0.012, 0.049, 0.05, 0.07] {
        vector[8] = t_set;
        for hold in [Hold::Zero, Hold::First] {
            let model = delayed(&parameters(&vector), 0.05, hold, [0.0; 2], &[], 1);
            sums.push(model.stepper.step.taps.map(|inputs| inputs.as_flattened().iter().sum::<f64>()));
        }
    }
    for sum in &sums {
        for (one, first) in sum.iter().zip(&sums[0]) {
            assert!((one - first).abs() < 1e-14);
        }
    }
}

#[test]
fn a_whole_number_of_samples_stays_whole_in_spite_of_rounding() {
    for (time, dt, whole) in [(0.3, 0.01, 30), (0.7, 0.1, 7), (0.0, 0.1, 0), (1e-12, 0.1, 0)] {
        let delay = Delay::new(Number::constant(time), dt);
        assert_eq!((delay.whole, delay.fraction.value()), (whole, 0.0));
    }
    let late = Delay::new(Number::constant(0.37), 0.1);
    assert_eq!(late.whole, 3);
    assert!((late.fraction.value() - 0.7).abs() < 1e-12);
}
