//! What the equations are made of: the parameters as numbers that may carry derivatives, and which elements act.

use crate::scalar::Scalar;

/// Parameters of the ship in normalised terms; times in seconds.
#[derive(Debug, Clone, Copy)]
#[allow(missing_docs)]
pub struct Terms<T> {
    pub tau_n: T,
    pub g: T,
    pub v: T,
    pub k_p: T,
    pub k_i: T,
    pub k_d: T,
    pub p: T,
    pub tau_prop: T,
    pub t_d: T,
    pub t_set: T,
    pub t_s: T,
    pub t_0: T,
    pub tau_act: T,
    pub m_max: T,
    pub m_max_slope: T,
    pub m_min: T,
    pub rate_up: T,
    pub rate_down: T,
    pub x_max: T,
    pub x_min: T,
    pub damping: T,
    pub load_gain: T,
    pub tau_twist: T,
    pub zeta_twist: T,
    pub t_n: T,
    pub t_m: T,
    pub s_u: T,
    pub s_m: T,
    pub initial_speed: T,
    pub initial_fuel: T,
}

impl<T: Scalar> Terms<T> {
    /// From a parameter's place in the vector to its number.
    #[inline(always)]
    pub fn new(of: impl Fn(usize) -> T) -> Self {
        let all: [T; 31] = std::array::from_fn(of);
        Self {
            tau_n: all[0],
            g: all[1],
            v: all[2],
            k_p: all[3],
            k_i: all[4],
            k_d: all[5],
            p: all[6],
            tau_prop: all[7],
            t_d: all[8],
            t_set: all[9],
            t_s: all[10],
            t_0: all[11],
            tau_act: all[12],
            m_max: all[13],
            m_max_slope: all[14],
            m_min: all[15],
            rate_up: all[16],
            rate_down: all[17],
            x_max: all[18],
            x_min: all[19],
            damping: all[21],
            load_gain: all[22],
            tau_twist: all[23],
            zeta_twist: all[24],
            t_n: all[25],
            t_m: all[26],
            s_u: all[27],
            s_m: all[28],
            initial_speed: all[29],
            initial_fuel: all[30],
        }
    }
}

/// Which elements act.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // Each element is on or off.
pub struct Elements {
    /// The governor samples.
    pub sampled: bool,
    /// Its sum is updated before it is used.
    pub before_use: bool,
    /// A continuous command goes through a dead time.
    pub delayed: bool,
    pub derivative: bool,
    pub lag: bool,
    pub rate_limit: bool,
    pub rack_limit: bool,
    pub torque_limit: bool,
    pub anti_windup: bool,
    pub flexible: bool,
    pub loaded: bool,
}

/// A lag shorter than this share of the record's sample time acts as a dead time of that length: the two are the same to first
/// order, and steps as fine as such a lag asks for would take longer than anyone waits.
const SHORTEST_LAG: f64 = 1e-3;
/// The same where a millionth of a step does not count.
const SHORTEST_ROUGH_LAG: f64 = 0.125;

impl Elements {
    /// By the parameters' values, the switches, whether there are a load and a derivative gain, the record's sample time [s], and
    /// whether a millionth of a step counts.
    pub fn of(
        terms: &Terms<f64>,
        [anti_windup, before_use, loaded, derivative]: [bool; 4],
        dt: f64,
        sharp: bool,
    ) -> Self {
        let sampled = terms.t_s > 0.0;
        let shortest = if sharp { SHORTEST_LAG } else { SHORTEST_ROUGH_LAG };
        let lag = terms.tau_act > shortest * dt;
        Self {
            sampled,
            before_use,
            delayed: !sampled && (terms.t_d > 0.0 || (!lag && terms.tau_act > 0.0)),
            derivative,
            lag,
            rate_limit: terms.rate_up.min(terms.rate_down) < f64::INFINITY,
            rack_limit: terms.x_max < f64::INFINITY || terms.x_min > f64::NEG_INFINITY,
            torque_limit: terms.m_max < f64::INFINITY || terms.m_min > f64::NEG_INFINITY,
            anti_windup: anti_windup
                && (terms.x_max.min(terms.m_max) < f64::INFINITY
                    || terms.x_min.max(terms.m_min) > f64::NEG_INFINITY),
            flexible: terms.tau_twist > 0.0,
            loaded,
        }
    }

    /// The command reaches the actuator as it is computed.
    #[inline(always)]
    pub const fn direct(&self) -> bool {
        !self.sampled && !self.delayed
    }

    /// Whether anything may switch between known times.
    #[inline(always)]
    pub const fn watched(&self) -> bool {
        self.torque_limit || self.rate_limit || (!self.sampled && (self.rack_limit || self.anti_windup))
    }
}

/// Which limits hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// None.
    Free,
    /// The upper one.
    High,
    /// The lower one.
    Low,
}

/// What the governor's integral does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Integral {
    /// It adds up the error.
    Runs,
    /// It stands still, since a limit above or below holds the command.
    Stands(Side),
    /// It keeps the command on a limit: past it the integral would stand and the command fall back, short of it the
    /// integral would run and the command pass it (a sliding mode in Filippov's sense).
    Slides(Side),
}

/// What the switches stand at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mode {
    /// Limits of the rack's position.
    pub rack: Side,
    /// Limits of the rack's speed.
    pub rate: Side,
    /// Limits of the torque.
    pub torque: Side,
    /// Anti-windup.
    pub integral: Integral,
}

impl Mode {
    /// Nothing holds.
    pub const FREE: Self =
        Self { rack: Side::Free, rate: Side::Free, torque: Side::Free, integral: Integral::Runs };
}
