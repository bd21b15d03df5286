//! How long steps may be.

use crate::error::{Result, require_slow};
use crate::ship::run::Run;

use super::flow::Equations;

/// Steps are at most this share of the fastest time constant, unless they are asked for: RK4's error is then near 2e-8.
const SHARE: f64 = 0.04;
/// The same where a millionth of a step does not count.
const ROUGH_SHARE: f64 = 0.2;
/// Most steps, and most samples of the governor, in a sample of the record.
const MOST_STEPS: f64 = 65_536.0;

/// The longest step that is accurate enough [s].
pub fn longest_step(equations: &Equations<f64>, run: &Run<'_>) -> Result<f64> {
    let (t, elements, dt) = (&equations.terms, &equations.elements, run.dt);
    let speed = t.initial_speed.abs().max(1.0);
    let load = t.p.abs() * speed.powf(t.p - 1.0) + t.damping.abs();
    let (engine, propeller) =
        if elements.flexible { (t.tau_n - t.tau_prop, t.tau_prop) } else { (t.tau_n, t.tau_n) };
    let mut fastest = (t.g.abs() + t.m_max_slope.abs()) / engine + load / propeller;
    if elements.flexible {
        let both = 1.0 / engine + 1.0 / propeller;
        fastest += (both / t.tau_twist).sqrt() + t.zeta_twist * both;
    }
    if elements.lag {
        fastest += 1.0 / t.tau_act;
    }
    if !elements.sampled {
        fastest += (t.v * t.k_p).abs() / engine;
    }
    let share = if run.sharp { SHARE } else { ROUGH_SHARE };
    let longest = if run.substeps > 0 { dt / run.substeps as f64 } else { share / fastest };
    for (what, each) in [("steps of the fastest time constant", longest), ("samples of the governor", t.t_s)]
    {
        let found = if each > 0.0 { dt / each } else { 0.0 };
        require_slow(found <= MOST_STEPS && longest > 0.0, || {
            format!(
                "found {found:.0} {what} in a sample of the record, expected at most {MOST_STEPS}; check the parameters"
            )
        })?;
    }
    Ok(longest)
}
