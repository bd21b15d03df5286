//! Stability of the loop about the operating point, by the encirclements of its return difference (Nyquist 1932,
//! doi:10.1002/j.1538-7305.1932.tb02344.x). The test is needed because the closed form has a finite cost even for an
//! unstable loop.

use super::equations::{COUNT, HALF_APART, at};

/// Number of frequencies at which the return difference is evaluated: per decade, and the limit in all.
const PER_DECADE: f64 = 24.0;
const MOST: usize = 6000;
/// Largest angle by which a delay turns the return difference between two evaluated frequencies [rad].
const TURN: f64 = 0.3;
/// Loop gain below which no further encirclement is possible, and above which frequency steps are limited by the delay.
const SMALL: f64 = 0.9;
const COUNTS: f64 = 0.3;
/// Slope of load minus engine torque that replaces a slope of exactly zero.
const NEUTRAL: f64 = 1e-9;
/// Damping ratio that every shaft has at least; without damping any governor makes a shaft swing.
const LEAST_DAMPED: f64 = 0.01;
/// Iterations of Newton's method for the pole of a shaft that twists.
const NEWTON: usize = 8;
/// Least relative frequency step.
const FINEST: f64 = 1e-5;

fn times(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// Coefficients of a polynomial in s.
type Polynomial = [f64; 5];

fn product(a: Polynomial, b: Polynomial) -> Polynomial {
    let mut found = [0.0; 5];
    for i in 0..5 {
        for j in 0..5 - i {
            found[i + j] += a[i] * b[j];
        }
    }
    found
}

/// A polynomial at j w.
fn along(c: Polynomial, w: f64) -> [f64; 2] {
    [c[0] - w * w * (c[2] - c[4] * w * w), w * (c[1] - c[3] * w * w)]
}

/// Root of a polynomial near j w by Newton's method: real and imaginary part; j w where it does not converge.
fn pole_near(c: &Polynomial, w: f64) -> [f64; 2] {
    let mut s = [0.0, w];
    for _ in 0..NEWTON {
        let (mut value, mut slope) = ([0.0; 2], [0.0; 2]);
        for coefficient in c.iter().rev() {
            slope = times(slope, s);
            slope = [slope[0] + value[0], slope[1] + value[1]];
            value = times(value, s);
            value[0] += coefficient;
        }
        let size = slope[0] * slope[0] + slope[1] * slope[1];
        let step = times(value, [slope[0], -slope[1]]);
        s = [s[0] - step[0] / size, s[1] - step[1] / size];
    }
    if s[0].is_finite() && s[1].is_finite() { s } else { [0.0, w] }
}

/// Transfer function from fuel to engine speed about the operating point: `speed` / `torque`, polynomials in s.
struct Shaft {
    speed: Polynomial,
    torque: Polynomial,
    /// Of a torsionally flexible shaft: resonance without load and engine, frequency and decay rate of the pole near it
    /// [rad/s]; 0: a stiff shaft.
    resonance: [f64; 3],
}

impl Shaft {
    /// `more`: additional inertia of the engine's side by a derivative that acts immediately.
    fn new(q: &[f64; COUNT], more: f64) -> Self {
        let law = q[at::P] + q[at::DAMPING];
        let twist = q[at::TAU_TWIST];
        let (ahead, behind) = (q[at::TAU_N] - q[at::TAU_PROP] + more, q[at::TAU_PROP]);
        if twist <= 0.0 || ahead <= 0.0 || behind <= 0.0 {
            let (own, inertia, lag) = (law - q[at::G], q[at::TAU_N] + more, q[at::TAU_ENG]);
            let torque = [own, inertia + lag * law, lag * inertia, 0.0, 0.0];
            return Self { speed: [1.0, 0.0, 0.0, 0.0, 0.0], torque, resonance: [0.0; 3] };
        }
        let square = (1.0 / ahead + 1.0 / behind) / twist;
        let damped = (twist * q[at::ZETA_TWIST]).max(2.0 * LEAST_DAMPED / square.sqrt());
        let speed = [1.0, damped + twist * law, twist * behind, 0.0, 0.0];
        let ends = product([1.0, damped, 0.0, 0.0, 0.0], [law, behind, 0.0, 0.0, 0.0]);
        let mut torque = product([0.0, ahead, 0.0, 0.0, 0.0], speed);
        for (mine, more) in torque.iter_mut().zip(ends) {
            *mine += more;
        }
        torque = product([1.0, q[at::TAU_ENG], 0.0, 0.0, 0.0], torque);
        for (mine, own) in torque.iter_mut().zip(speed) {
            *mine -= q[at::G] * own;
        }
        let swings = square.sqrt();
        let [decay, near] = pole_near(&torque, swings);
        Self { speed, torque, resonance: [swings, near, decay.abs().max(1e-4 * swings)] }
    }

    /// Number of unstable poles, by Routh's criterion.
    fn poles(&self) -> i32 {
        let degree = self.torque.iter().rposition(|c| *c != 0.0).unwrap_or(0);
        let every_other =
            |from: usize| (0..=from).rev().step_by(2).map(|k| self.torque[k]).collect::<Vec<_>>();
        let (mut above, mut row) = (every_other(degree), every_other(degree.saturating_sub(1)));
        let mut changes = 0;
        for _ in 0..degree {
            if row[0] == 0.0 {
                row[0] = 1e-12 * above[0];
            }
            changes += i32::from(above[0] * row[0] < 0.0);
            let ratio = above[0] / row[0];
            let below = (1..above.len()).map(|k| above[k] - ratio * row.get(k).unwrap_or(&0.0)).collect();
            (above, row) = (row, below);
            if row.is_empty() {
                break;
            }
        }
        changes
    }
}

/// Whether a ship's loop is stable for parameters as in `PARAMETERS`; for an open loop, whether its poles are.
#[must_use]
pub fn is_stable(q: &[f64; COUNT], open_loop: bool) -> bool {
    if open_loop {
        return q[at::P] + q[at::DAMPING] - q[at::G] > 0.0 && Shaft::new(q, 0.0).poles() == 0;
    }
    // With a droop the governor's integral decays at the rate `fade`, and the gains are smaller.
    let less = 1.0 / (1.0 + q[at::DROOP] * q[at::VK_P]);
    let (kp, ki, kd) = (q[at::VK_P] * less, q[at::VK_I] * less, q[at::VK_D] * less);
    let fade = q[at::DROOP] * ki;
    // A derivative that acts immediately is additional inertia.
    let at_once = q[at::T_D] == 0.0 && q[at::TAU_ACT] == 0.0 && q[at::T_F] == 0.0 && q[at::TAU_ENG] == 0.0;
    let (kp, kd, more) = if at_once { (kp - kd * fade, 0.0, kd) } else { (kp, kd, 0.0) };
    if !(ki > 0.0 && q[at::TAU_N] + more > 0.0) {
        return false;
    }
    let mut shaft = Shaft::new(q, more);
    if shaft.torque[0] == 0.0 {
        shaft.torque[0] = NEUTRAL; // a pole at zero does not turn it
    }
    let own = shaft.torque[0];
    let apart = q[at::T_S] * HALF_APART;
    // The function s / (s + c) (1 + L(s)), with the loop's transfer function L, has no pole at 0 and tends to 1; with a
    // droop 1 + L(s) itself.
    let corner = (ki / (own.abs() + kp.abs())).max(1e-6);
    // A number with the direction of that function, computed without a division, and the loop gain.
    let at_frequency = |w: f64| -> ([f64; 2], f64) {
        let under = times([1.0, q[at::TAU_ACT] * w], along(shaft.torque, w));
        let under = times([1.0, q[at::T_F] * w], times([1.0, -fade / w], under));
        let (sin, cos) = (w * q[at::T_D]).sin_cos();
        let hold = (apart * w).cos();
        let asked = times([kp, kd * w - ki / w], along(shaft.speed, w));
        let fed = times(asked, [cos * hold, -sin * hold]);
        let size = under[0].hypot(under[1]).max(1e-300);
        let turned = times([under[0] + fed[0], under[1] + fed[1]], [under[0] / size, -under[1] / size]);
        let turned = if fade > 0.0 { turned } else { times(turned, [w, corner]) };
        (turned, asked[0].hypot(asked[1]) / size)
    };
    let [swings, near, fades] = shaft.resonance;
    let (step, delay) = (10.0_f64.powf(1.0 / PER_DECADE), q[at::T_D] + apart);
    let slowest = corner.min((own.abs() / shaft.torque[1].abs().max(1e-9)).max(1e-6));
    let slowest = if fade > 0.0 { slowest.min(fade) } else { slowest };
    // With a derivative the gain may rise again up to the corner frequencies of plant and lag.
    let quickest = (3.0 * swings)
        .max(if kd == 0.0 { 0.0 } else { own.abs() / shaft.torque[1].abs().max(1e-9) })
        .max(if kd == 0.0 || q[at::TAU_ACT] == 0.0 { 0.0 } else { 1.0 / q[at::TAU_ACT] })
        .max(if kd == 0.0 || q[at::T_F] == 0.0 { 0.0 } else { 1.0 / q[at::T_F] })
        .max(if kd == 0.0 || q[at::TAU_ENG] == 0.0 { 0.0 } else { 1.0 / q[at::TAU_ENG] });
    // Half a turn at frequency 0 counts once, since it has no counterpart at a negative frequency.
    let half = if at_frequency(1e-3 * slowest).0[1] > 0.0 { 1 } else { -1 };
    let begun = shaft.poles() + if own < 0.0 && q[at::DROOP] * own > -1.0 { half } else { 0 };
    let steps = |w: f64, gain: f64| {
        let mut next = w * step;
        if gain > COUNTS || swings == 0.0 {
            next = next.min(w + TURN / delay.max(1e-9));
        }
        if swings > 0.0 {
            next = next.min(w + TURN * (w - near).hypot(fades));
        }
        next
    };
    zeros(1e-3 * slowest, quickest, at_frequency, steps).is_some_and(|turned| begun + turned == 0)
}

/// Number of unstable zeros, from half turns about the origin above a start frequency; each counts twice, for positive
/// and negative frequencies.
fn zeros(
    mut w: f64,
    quickest: f64,
    at_frequency: impl Fn(f64) -> ([f64; 2], f64),
    next: impl Fn(f64, f64) -> f64,
) -> Option<i32> {
    let (mut before, mut gain) = at_frequency(w);
    let mut found = 0;
    for _ in 0..MOST {
        if w >= quickest && gain < SMALL {
            return Some(found);
        }
        let mut after = next(w, gain);
        let mut now;
        (now, gain) = at_frequency(after);
        // A root close to the imaginary axis turns the Nyquist curve by half a turn. Only small frequency steps show which way.
        while before[0] * now[0] + before[1] * now[1] < 0.0 && after - w > FINEST * w {
            after = 0.5 * (w + after);
            (now, gain) = at_frequency(after);
        }
        w = after;
        let (up, down) = (before[1] < 0.0 && now[1] >= 0.0, before[1] >= 0.0 && now[1] < 0.0);
        let side = before[0] * now[1] - now[0] * before[1];
        if up && side < 0.0 {
            found += 2;
        } else if down && side > 0.0 {
            found -= 2;
        }
        before = now;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn with(told: &[(usize, f64)]) -> [f64; COUNT] {
        let mut q = [0.0; COUNT];
        for (place, value) in told.iter().chain(&[(at::V, 1.0), (at::S_M, 1.0)]) {
            q[*place] = *value;
        }
        q
    }

    #[test]
    fn a_delay_and_a_derivative_gain_do_not_go_together() {
        let q = with(&[(at::TAU_N, 1.0), (at::VK_P, 2.0), (at::VK_I, 1.0), (at::VK_D, 3.0), (at::P, 2.0)]);
        assert!(is_stable(&q, false));
        let mut late = q;
        late[at::T_D] = 0.3;
        assert!(!is_stable(&late, false));
    }

    proptest! {
        /// Hurwitz's criterion for a first-order plant with a PI governor: own + `K_p` > 0, `K_i` > 0, with the plant's
        /// slope `own`.
        #[test]
        fn a_rigid_loop_goes_by_hurwitz(own in -5.0..5.0_f64, kp in 0.01..10.0_f64, ki in 0.01..10.0, tau in 0.1..10.0) {
            prop_assume!((own + kp).abs() > 0.02);
            let q = with(&[(at::TAU_N, tau), (at::VK_P, kp), (at::VK_I, ki), (at::P, own)]);
            prop_assert_eq!(is_stable(&q, false), own + kp > 0.0);
        }

        /// With a lag, or a filter of the speed: (1 + `tau_act` s) (own + tau s) s + `K_p` s + `K_i` by Routh.
        #[test]
        fn a_lag_goes_by_routh(
            own in -5.0..5.0_f64,
            kp in 0.01..10.0_f64,
            ki in 0.01..10.0_f64,
            tau in 0.1..10.0_f64,
            lag in 0.01..5.0_f64,
        ) {
            let (cubic, square, line) = (tau * lag, tau + own * lag, own + kp);
            let margin = square * line - cubic * ki;
            prop_assume!(margin.abs() > 0.03 * (square * line).abs() && line.abs() > 0.02 && square.abs() > 0.02);
            for place in [at::TAU_ACT, at::T_F] {
                let q = with(&[(at::TAU_N, tau), (at::VK_P, kp), (at::VK_I, ki), (at::P, own), (place, lag)]);
                prop_assert_eq!(is_stable(&q, false), square > 0.0 && line > 0.0 && margin > 0.0);
            }
        }
    }
}
