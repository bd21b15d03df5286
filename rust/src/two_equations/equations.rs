//! Both equations as polynomials in s on measured signals, with their derivatives by every parameter.
//!
//! Each equation is multiplied by its denominators (the engine's by integrator and lag, the load's by the flexible shaft's
//! damper), so that only polynomials and delays remain.

use crate::error::{Result, require};
use crate::places::named_places;

use super::clock;
use super::dual::Dual;

named_places! {
    /// Names of the parameters:
    /// - `T_s`: sampling period of the governor, half of which is part of `T_d`;
    /// - `u_0`: set-point offset; `x_0`: offset of rack or fuel;
    /// - `s_M`, `m_0`: scale and offset of the torque;
    /// - `T_B`, `s_B`: delay and scale of the brake's torque that is measured in addition to a gauge's;
    /// - `T_f`: time constant of the filter of the measured speed in the governor;
    /// - `tau_eng`: lag of the engine's torque behind fuel and slope (turbocharger, fuel film);
    /// - `t_1`: reference of the inertia ahead of the gauge, a constant of the fit, or 0;
    /// - `droop`: decrease of the set point over the fuel's torque.
    PARAMETERS:
    TAU_N "tau_n",
    G "g",
    VK_P "vK_p",
    VK_I "vK_i",
    VK_D "vK_d",
    P "p",
    TAU_PROP "tau_prop",
    DAMPING "damping",
    C_2 "c_2",
    K_L "k_L",
    T_D "T_d",
    T_SET "T_set",
    T_S "T_s",
    TAU_ACT "tau_act",
    T_M "T_M",
    T_N "T_n",
    TAU_TWIST "tau_twist",
    ZETA_TWIST "zeta_twist",
    V "v",
    U_0 "u_0",
    S_M "s_M",
    X_0 "x_0",
    M_0 "m_0",
    T_B "T_B",
    S_B "s_B",
    T_F "T_f",
    TAU_ENG "tau_eng",
    T_1 "t_1",
    DROOP "droop",
}
pub const COUNT: usize = PARAMETERS.len();

/// Signals of a record, as deviations from the operating point: speed, torque, rack, load, square and cube of the speed,
/// the constant 1, and the brake torque if it is measured in addition to a gauge's torque.
pub const SIGNALS: [&str; 8] = ["N", "M", "X", "load", "N2", "N3", "one", "M_b"];
/// Number of orders of the taper: the taper itself and its first derivatives.
pub const ORDERS: usize = 4;

/// Signals of the equations: those of a record, then delayed ones. A hold multiplies the `LATE` signals by cosh and the
/// `APART` signals by sinh of s times half the time between the hold's two commands.
pub mod signal {
    crate::places::places! {
        N, M, X, LOAD, N2, N3, ONE, M_B,
        LATE_N, LATE_U, LATE_M, APART_N, APART_U, APART_M, COUNT
    }
}

/// Locations of speed and torque sensors, and the input.
#[derive(Debug, Clone, Copy, Default)]
// All combinations are valid.
#[allow(clippy::struct_excessive_bools)]
pub struct Setup {
    /// Whether the torque is measured between the inertias.
    pub gauge: bool,
    /// Whether the input is a command instead of a governor's set point.
    pub open_loop: bool,
    /// Whether the speed is measured on the propeller's side of the torsionally flexible shaft.
    pub propeller: bool,
}

/// Measured outputs. The brake's torque `dM_b` is compared only in addition to a gauge's.
pub const OUTPUTS: [&str; 4] = ["dn", "dM", "dX", "dM_b"];
/// An output by its index in [`OUTPUTS`].
pub type Output = usize;

/// Most coefficients of a polynomial.
pub const DEGREES: usize = 8;

/// Half of the time between the two commands that represent a hold, over the hold's period: 1 / (2 sqrt(3)).
pub const HALF_APART: f64 = 0.288_675_134_594_812_9;

/// A polynomial in s on a signal of an equation.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    pub equation: usize,
    pub signal: usize,
    pub coefficients: [f64; DEGREES],
    /// Coefficients up to the last that is not zero.
    pub length: usize,
}

/// The equations at given parameters, as many as outputs.
#[derive(Debug)]
pub struct Equations {
    /// Values of [`PARAMETERS`].
    pub values: [f64; COUNT],
    /// Indices of the outputs in [`OUTPUTS`], in the caller's order.
    pub outputs: Vec<Output>,
    /// Their terms.
    pub terms: Vec<Term>,
    /// For each requested parameter, the terms of its derivative.
    pub slopes: Vec<(usize, Vec<Term>)>,
}

/// A polynomial whose coefficients have derivatives.
#[derive(Debug, Clone)]
struct Polynomial(Vec<Dual>);

impl Polynomial {
    fn times(&self, other: &Self) -> Self {
        let mut product = vec![Dual::new(0.0); self.0.len() + other.0.len() - 1];
        for (i, a) in self.0.iter().enumerate() {
            for (j, b) in other.0.iter().enumerate() {
                product[i + j] = product[i + j] + *a * *b;
            }
        }
        Self(product)
    }

    fn plus(mut self, other: &Self, factor: f64) -> Self {
        self.0.resize(self.0.len().max(other.0.len()), Dual::new(0.0));
        for (mine, theirs) in self.0.iter_mut().zip(&other.0) {
            *mine = *mine + *theirs * factor;
        }
        self
    }

    fn negative(&self) -> Self {
        Self(self.0.iter().map(|number| *number * -1.0).collect())
    }
}

/// An equation: a polynomial for each of its signals.
#[derive(Debug, Clone, Default)]
struct Equation(Vec<(usize, Polynomial)>);

impl Equation {
    fn add(&mut self, signal: usize, polynomial: &Polynomial) {
        if let Some((_, mine)) = self.0.iter_mut().find(|(known, _)| *known == signal) {
            *mine = mine.clone().plus(polynomial, 1.0);
        } else {
            self.0.push((signal, polynomial.clone()));
        }
    }

    fn times(&self, factor: &Polynomial) -> Self {
        Self(self.0.iter().map(|(signal, polynomial)| (*signal, polynomial.times(factor))).collect())
    }

    fn add_all(&mut self, other: &Self) {
        for (signal, polynomial) in &other.0 {
            self.add(*signal, polynomial);
        }
    }

    /// Eliminate the torque by means of another equation, in which the torque's coefficient is 1.
    fn without_torque(mut self, load: &Self) -> Self {
        let Some(place) = self.0.iter().position(|(signal, _)| *signal == signal::M) else { return self };
        let factor = self.0.remove(place).1.negative();
        for (signal, polynomial) in load.0.iter().filter(|(signal, _)| *signal != signal::M) {
            self.add(*signal, &polynomial.times(&factor));
        }
        self
    }
}

impl Equations {
    /// The equations of a ship for measured outputs, with derivatives by the parameters of index `wrt`.
    ///
    /// # Errors
    /// [`crate::error::Error::Invalid`] for outputs without the speed, or an unknown parameter or one that is not finite.
    pub fn new(values: &[f64], outputs: &[Output], setup: Setup, wrt: &[usize]) -> Result<Self> {
        require(values.len() == COUNT, || {
            format!("parameters: found {} numbers, expected {COUNT}", values.len())
        })?;
        if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
            require(false, || {
                format!("parameters: {} is {}, expected a number", PARAMETERS[bad], values[bad])
            })?;
        }
        let distinct = outputs.iter().enumerate().all(|(i, output)| !outputs[..i].contains(output));
        let known = outputs.iter().all(|&output| output < OUTPUTS.len());
        require(distinct && outputs.contains(&0) && known, || {
            format!("outputs: found {outputs:?}, expected the speed 0 and any of 1, 2 and 3, each once")
        })?;
        require(wrt.iter().all(|&by| by < COUNT), || {
            format!("wrt: found {wrt:?}, expected indices below {COUNT}")
        })?;
        let mut own = [0.0; COUNT];
        own.copy_from_slice(values);
        for scale in [at::S_M, at::S_B] {
            require(own[scale] != 0.0, || {
                format!("parameters: {} is 0, expected a scale other than 0", PARAMETERS[scale])
            })?;
        }
        let (torque, both) = (outputs.contains(&1), outputs.contains(&3));
        require(!both || (torque && setup.gauge), || {
            format!(
                "outputs: found {outputs:?}, expected the brake's torque 3 beside the torque 1 of a gauge only"
            )
        })?;
        require(torque || own[at::TAU_TWIST] == 0.0, || {
            "tau_twist: a shaft that twists needs a measured torque, expected 0".to_owned()
        })?;
        require(!setup.propeller || torque, || {
            "late: the engine's speed follows from the propeller's by the torque, expected both".to_owned()
        })?;
        let equations = written(&own, [torque, outputs.contains(&2), both], setup);
        let terms = equations
            .iter()
            .enumerate()
            .flat_map(|(equation, one)| {
                one.0
                    .iter()
                    .filter_map(move |(signal, p)| term(equation, *signal, p.0.iter().map(|c| c.value)))
            })
            .collect::<Vec<_>>();
        let slopes = wrt.iter().map(|&by| (by, slope_terms(&equations, &terms, &own, by))).collect();
        Ok(Self { values: own, outputs: outputs.to_vec(), terms, slopes })
    }

    /// All polynomials, including those of derivatives.
    pub fn every(&self) -> impl Iterator<Item = &Term> {
        self.terms.iter().chain(self.slopes.iter().flat_map(|(_, terms)| terms))
    }

    /// Half of the time between the two commands that represent a hold [s].
    #[must_use]
    pub fn apart(&self) -> f64 {
        self.values[at::T_S] * HALF_APART
    }
}

/// A term, unless all its coefficients are zero.
fn term(equation: usize, signal: usize, from: impl Iterator<Item = f64>) -> Option<Term> {
    let mut coefficients = [0.0; DEGREES];
    for (mine, value) in coefficients.iter_mut().zip(from) {
        *mine = value;
    }
    let length = DEGREES - coefficients.iter().rev().take_while(|value| **value == 0.0).count();
    (length > 0).then_some(Term { equation, signal, coefficients, length })
}

/// The equations of the load (if a torque is measured), of the engine, of the governor (if the rack is measured), and of
/// the engine's inertia (if both torques are measured).
fn written(values: &[f64; COUNT], [torque, rack, both]: [bool; 3], setup: Setup) -> Vec<Equation> {
    // long: the equations in sequence, as on paper
    let q = |place: usize| Dual::parameter(values, place);
    let poly = |numbers: &[Dual]| Polynomial(numbers.to_vec());
    let (zero, one) = (Dual::new(0.0), Dual::new(1.0));
    let Setup { gauge, open_loop, propeller, .. } = setup;

    let (p, ahead) = (q(at::P), q(at::TAU_N) - q(at::TAU_PROP));
    let second = p * (p + -1.0) * 0.5 + q(at::C_2);
    let third = p * (p + -1.0) * (p + -2.0) * (1.0 / 6.0);
    let law = poly(&[p + q(at::DAMPING), q(at::TAU_PROP)]);
    let inertia = poly(&[zero, ahead]);
    let damped = poly(&[one, q(at::ZETA_TWIST) * q(at::TAU_TWIST)]);
    let twist = poly(&[zero, q(at::TAU_TWIST)]);

    // The shaft's twist turns its engine end ahead of its propeller end: `damped` (n_e - n_s) = `twist` M_g. If the
    // propeller's speed n_s is measured, the engine's speed n_e is replaced: `on_engine` n_e = `damped` n_s + `wound` M.
    let turned = if gauge { damped.clone() } else { damped.clone().plus(&inertia.times(&twist), 1.0) };
    let (on_engine, wound) =
        if propeller { (turned.clone(), twist.clone()) } else { (poly(&[one]), poly(&[zero])) };

    // The gauge's torque is the brake's minus the acceleration torque of the engine's side.
    let mut load = Equation::default();
    let flexible = damped.clone().plus(&law.times(&twist), 1.0);
    let (by_torque, by_speed, on_load) = match (propeller, gauge) {
        (false, true) => (flexible, damped.times(&law), damped.clone()),
        (false, false) => {
            (flexible.clone(), damped.times(&law).plus(&inertia.times(&flexible), 1.0), damped.clone())
        }
        (true, true) => (poly(&[one]), law, poly(&[one])),
        (true, false) => (damped.clone(), turned.times(&law).plus(&inertia.times(&damped), 1.0), turned),
    };
    load.add(signal::M, &by_torque);
    load.add(signal::N, &by_speed.negative());
    load.add(signal::N2, &on_load.times(&poly(&[second])).negative());
    load.add(signal::N3, &on_load.times(&poly(&[third])).negative());
    load.add(signal::LOAD, &on_load.times(&poly(&[q(at::K_L)])).negative());

    let mut engine = Equation::default();
    let seen = if propeller { damped } else { poly(&[one]) };
    let mut between = Equation::default();
    between.add(signal::M_B, &on_engine);
    between.add(signal::M, &on_engine.clone().plus(&inertia.times(&wound), 1.0).negative());
    between.add(signal::N, &inertia.times(&seen).negative());
    // The lag of a turbocharger or a fuel film acts on the torques of fuel and slope alike.
    let charged = poly(&[one, q(at::TAU_ENG)]);
    let slowed = if gauge { inertia.times(&charged) } else { poly(&[zero]) }.plus(&poly(&[q(at::G)]), -1.0);
    engine.add(signal::M, &on_engine.times(&charged).plus(&slowed.times(&wound), 1.0));
    engine.add(signal::N, &seen.times(&slowed));
    if !torque {
        engine = engine.without_torque(&load);
    }

    let (lag, filter) = (poly(&[one, q(at::TAU_ACT)]), poly(&[one, q(at::T_F)]));
    let mut fed = Equation::default();
    let cleared = if open_loop {
        fed.add(signal::LATE_U, &on_engine.times(&poly(&[q(at::V)])).negative());
        lag
    } else {
        let period = q(at::T_S);
        let asked = poly(&[q(at::VK_I), q(at::VK_P), clock::summed(q(at::VK_I), period * 0.5)]);
        // The filter is on the speed alone: all other terms are multiplied by its denominator.
        fed.add(signal::LATE_U, &on_engine.times(&asked).times(&filter).negative());
        let asked = asked.plus(&poly(&[zero, zero, q(at::VK_D)]), 1.0);
        let samples = period.value > 0.0 && !propeller;
        let seen = if samples { seen.plus(&rippled(values), 1.0) } else { seen };
        fed.add(signal::LATE_N, &asked.times(&seen));
        if propeller {
            fed.add(signal::LATE_M, &wound.times(&asked));
        }
        // The droop lowers the set point in proportion to the governor's own command.
        let droop = q(at::DROOP);
        poly(&[droop * q(at::VK_I), droop * q(at::VK_P) + 1.0]).times(&lag).times(&filter)
    };
    let mut equations = if torque { vec![load] } else { vec![] };
    if rack {
        engine.add(signal::X, &on_engine.times(&poly(&[q(at::V)])).negative());
        engine.add(signal::ONE, &poly(&[q(at::X_0)]).negative());
        fed.add(signal::X, &cleared.times(&on_engine.times(&poly(&[q(at::V)]))));
        equations.extend([engine, fed]);
    } else {
        // In moving water the engine's residual is far smaller than the load's, since the wake moves speed and torque
        // together. The taper does not commute with operators, so adding a multiple of the load's equation, times `cleared`,
        // to the engine's equation also adds the load's noise. The set point gives no information on this multiple, and its
        // noise must not determine it either. The multiple is therefore that of the inertia `t_1`, for all parameters.
        if let Some(load) = equations.first().filter(|_| gauge && values[at::T_1] > 0.0) {
            let known = Dual::new(values[at::T_1]);
            let multiple = (ahead + known * -1.0) * (q(at::TAU_PROP) + known).inverse();
            engine.add_all(&load.times(&poly(&[multiple])).times(&charged));
        }
        if open_loop {
            engine.add(signal::ONE, &poly(&[q(at::X_0)]).negative());
        }
        fed.add_all(&engine.times(&cleared));
        equations.push(fed);
    }
    if both {
        equations.push(between);
    }
    equations
}

/// Ripple of the speed at the governor's samples due to the held fuel, as a polynomial that acts on the speed. A shaft that
/// is flexible at the sample rate decouples the propeller's inertia.
fn rippled(values: &[f64; COUNT]) -> Polynomial {
    let q = |place: usize| Dual::parameter(values, place);
    // Two lags in series leave even less ripple than one lag of their sum, which already leaves almost none.
    let (lag, zero) = (q(at::TAU_ACT) + q(at::TAU_ENG), Dual::new(0.0));
    let rate = q(at::T_S).inverse() * std::f64::consts::TAU;
    let flexible = q(at::TAU_TWIST) * q(at::TAU_PROP) * rate * rate;
    let apart = flexible * (flexible + 1.0).inverse();
    let near = (q(at::TAU_N) - q(at::TAU_PROP) * apart).inverse();
    let sees = clock::ripple(q(at::T_S), q(at::T_D), lag) * near;
    let own = q(at::P) + q(at::DAMPING) - q(at::G);
    let fuel = Polynomial(vec![zero, own, q(at::TAU_N)]);
    fuel.times(&Polynomial(vec![sees, sees * lag]))
}

/// Terms of the derivative by a parameter, which acts on coefficients and on delays and scales of signals.
fn slope_terms(equations: &[Equation], terms: &[Term], values: &[f64; COUNT], by: usize) -> Vec<Term> {
    let mut found: Vec<Term> = Vec::new();
    let mut add = |equation: usize, signal: usize, coefficients: [f64; DEGREES]| {
        if let Some(mine) = found.iter_mut().find(|mine| mine.equation == equation && mine.signal == signal) {
            for (mine, more) in mine.coefficients.iter_mut().zip(coefficients) {
                *mine += more;
            }
            mine.length = DEGREES;
        } else if let Some(new) = term(equation, signal, coefficients.into_iter()) {
            found.push(new);
        }
    };
    for (equation, one) in equations.iter().enumerate() {
        for (signal, polynomial) in &one.0 {
            let mut coefficients = [0.0; DEGREES];
            for (mine, number) in coefficients.iter_mut().zip(&polynomial.0) {
                *mine = number.slopes[by];
            }
            add(equation, *signal, coefficients);
        }
    }
    for one in terms {
        let mut risen = [0.0; DEGREES];
        risen[1..].copy_from_slice(&one.coefficients[..DEGREES - 1]);
        let apart = match one.signal {
            signal::LATE_N => signal::APART_N,
            signal::LATE_M => signal::APART_M,
            _ => signal::APART_U,
        };
        let delayed = matches!(one.signal, signal::LATE_N | signal::LATE_U | signal::LATE_M);
        let parted = delayed && values[at::T_S] != 0.0;
        let (set, torque) = (one.signal == signal::LATE_U, matches!(one.signal, signal::M | signal::LATE_M));
        let speed = matches!(one.signal, signal::N | signal::N2 | signal::N3 | signal::LATE_N);
        let brake = one.signal == signal::M_B;
        match by {
            at::T_D if delayed => add(one.equation, one.signal, risen.map(|c| -c)),
            at::T_S if parted => add(one.equation, apart, risen.map(|c| c * HALF_APART)),
            at::T_SET if set => add(one.equation, one.signal, risen.map(|c| -c)),
            at::T_M if torque => add(one.equation, one.signal, risen),
            at::T_N if speed => add(one.equation, one.signal, risen),
            at::T_B if brake => add(one.equation, one.signal, risen),
            at::M_0 if torque => add(one.equation, signal::ONE, one.coefficients),
            at::U_0 if set => add(one.equation, signal::ONE, one.coefficients),
            at::S_M | at::S_B if if by == at::S_M { torque } else { brake } => {
                let offset = if by == at::S_M { values[at::M_0] } else { 0.0 };
                let scaled = one.coefficients.map(|c| -c / values[by]);
                add(one.equation, one.signal, scaled);
                add(one.equation, signal::ONE, scaled.map(|c| c * (1.0 - offset)));
            }
            _ => {}
        }
    }
    trimmed(found)
}

/// Terms without zero coefficients at their ends.
fn trimmed(mut terms: Vec<Term>) -> Vec<Term> {
    for one in &mut terms {
        one.length = DEGREES - one.coefficients.iter().rev().take_while(|value| **value == 0.0).count();
    }
    terms.retain(|one| one.length > 0);
    terms
}
