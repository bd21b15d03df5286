//! Whether the loop about the operating point is stable, by the turns of its return difference (Nyquist 1932,
//! doi:10.1002/j.1538-7305.1932.tb02344.x): a closed form has a finite cost for a loop that runs away.

use super::equations::{COUNT, at};

/// Frequencies at which the return difference is looked at, per decade and in all at most.
const PER_DECADE: f64 = 24.0;
const MOST: usize = 4000;
/// Part of a turn by which a delay may turn it between two of them [rad].
const TURN: f64 = 0.3;
/// Bound of the loop gain below which nothing turns about the origin any more.
const SMALL: f64 = 0.9;

fn times(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// Whether a rigid ship's loop is stable for parameters as in `PARAMETERS`; an open loop by its own pole.
#[must_use]
pub fn is_stable(q: &[f64; COUNT], open_loop: bool) -> bool {
    let own = q[at::P] + q[at::DAMPING] - q[at::G];
    if open_loop {
        return own > 0.0;
    }
    let (kp, ki) = (q[at::VK_P], q[at::VK_I]);
    // A derivative that acts at once is one more inertia.
    let at_once = q[at::T_D] == 0.0 && q[at::TAU_ACT] == 0.0;
    let (kd, tau) = if at_once { (0.0, q[at::TAU_N] + q[at::VK_D]) } else { (q[at::VK_D], q[at::TAU_N]) };
    if !(ki > 0.0 && tau > 0.0) {
        return false;
    }
    let apart = q[at::HOLD] * q[at::T_D] / 3.0_f64.sqrt();
    // s / (s + c) (1 + L(s)) has no pole at 0 and goes to 1.
    let corner = (ki / (own.abs() + kp.abs())).max(1e-6);
    // In its direction, without a division.
    let at_frequency = |w: f64| -> [f64; 2] {
        let (lag, plant) = ([1.0, q[at::TAU_ACT] * w], [own, tau * w]);
        let under = times(lag, plant);
        let (sin, cos) = (w * q[at::T_D]).sin_cos();
        let hold = (apart * w).cos();
        let fed = times([kp, kd * w - ki / w], [cos * hold, -sin * hold]);
        let turned = times([under[0] + fed[0], under[1] + fed[1]], [under[0], -under[1]]);
        times(turned, [w, corner])
    };
    let (step, delay) = (10.0_f64.powf(1.0 / PER_DECADE), q[at::T_D] + apart);
    let mut w = 1e-3 * corner.min((own.abs() / tau).max(1e-6));
    let mut before = at_frequency(w);
    // Each turn about the origin is two zeros on the right. At 0 the return difference has the sign of the plant's own slope.
    let mut zeros = if own < 0.0 && before[1] > 0.0 { 2 } else { 0 };
    for _ in 0..MOST {
        let least = own.hypot(tau * w) * 1.0_f64.hypot(q[at::TAU_ACT] * w);
        // With a derivative the gain may rise again up to the corners of plant and lag.
        let falls =
            kd == 0.0 || (tau * w > own.abs() && q[at::TAU_ACT] * w >= f64::from(q[at::TAU_ACT] > 0.0));
        if falls && kp.abs() + (kd * w).abs() + ki / w < SMALL * least {
            return zeros == 0;
        }
        w = (w * step).min(w + TURN / delay.max(1e-9));
        let now = at_frequency(w);
        let (up, down) = (before[1] < 0.0 && now[1] >= 0.0, before[1] >= 0.0 && now[1] < 0.0);
        let side = before[0] * now[1] - now[0] * before[1];
        if up && side < 0.0 {
            zeros += 2;
        } else if down && side > 0.0 {
            zeros -= 2;
        }
        before = now;
    }
    false
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
        /// Hurwitz's rule for a plant of one pole under PI: own + `K_p` > 0, `K_i` > 0.
        #[test]
        fn a_rigid_loop_goes_by_hurwitz(own in -5.0..5.0_f64, kp in 0.01..10.0_f64, ki in 0.01..10.0, tau in 0.1..10.0) {
            prop_assume!((own + kp).abs() > 0.02);
            let q = with(&[(at::TAU_N, tau), (at::VK_P, kp), (at::VK_I, ki), (at::P, own)]);
            prop_assert_eq!(is_stable(&q, false), own + kp > 0.0);
        }

        /// With a lag: (1 + `tau_act` s) (own + tau s) s + `K_p` s + `K_i` by Routh.
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
            let q = with(&[(at::TAU_N, tau), (at::VK_P, kp), (at::VK_I, ki), (at::P, own), (at::TAU_ACT, lag)]);
            prop_assert_eq!(is_stable(&q, false), square > 0.0 && line > 0.0 && margin > 0.0);
        }
    }
}
