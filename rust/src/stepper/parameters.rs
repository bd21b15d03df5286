//! Parameters of the ship model by name and by place: their values without effect, the checks on them.

use crate::error::{Error, Result, require};

/// Number of parameters.
pub const COUNT: usize = 37;

const INF: f64 = f64::INFINITY;
const NAN: f64 = f64::NAN;

/// A parameter: its name, and the value at which it has no effect; not a number where there is none.
const TABLE: [(&str, f64); COUNT] = [
    ("tau_n", NAN),
    ("g", NAN),
    ("v", NAN),
    ("K_p", NAN),
    ("K_i", NAN),
    ("K_d", 0.0),
    ("p", NAN),
    ("tau_prop", 0.0),
    ("T_d", 0.0),
    ("T_set", 0.0),
    ("T_s", 0.0),
    ("T_0", 0.0),
    ("tau_act", 0.0),
    ("M_max", INF),
    ("M_max_slope", 0.0),
    ("M_min", -INF),
    ("rate_up", INF),
    ("rate_down", INF),
    ("X_max", INF),
    ("X_min", -INF),
    ("anti_windup", 0.0),
    ("damping", 0.0),
    ("load_gain", 0.0),
    ("tau_twist", 0.0),
    ("zeta_twist", 0.0),
    ("T_n", 0.0),
    ("T_M", 0.0),
    ("s_u", 1.0),
    ("s_M", 1.0),
    ("initial_N", 1.0),
    ("initial_F", 0.0),
    ("update", 0.0),
    ("curvature", 0.0),
    ("initial_E", 0.0),
    ("u_0", 0.0),
    ("M_soft", 0.0),
    ("hold", 0.0),
];

/// Names of the parameters, in the order of every parameter vector.
pub const PARAMETERS: [&str; COUNT] = {
    let mut names = [""; COUNT];
    let mut i = 0;
    while i < COUNT {
        names[i] = TABLE[i].0;
        i += 1;
    }
    names
};

/// Values at which the parameters have no effect, not a number where there is none.
pub const OFF: [f64; COUNT] = {
    let mut values = [0.0; COUNT];
    let mut i = 0;
    while i < COUNT {
        values[i] = TABLE[i].1;
        i += 1;
    }
    values
};

/// Places in a parameter vector.
#[allow(missing_docs)]
pub mod at {
    pub const TAU_N: usize = 0;
    pub const G: usize = 1;
    pub const V: usize = 2;
    pub const K_P: usize = 3;
    pub const K_I: usize = 4;
    pub const K_D: usize = 5;
    pub const P: usize = 6;
    pub const TAU_PROP: usize = 7;
    pub const T_D: usize = 8;
    pub const T_SET: usize = 9;
    pub const T_S: usize = 10;
    pub const T_0: usize = 11;
    pub const TAU_ACT: usize = 12;
    pub const M_MAX: usize = 13;
    pub const M_MAX_SLOPE: usize = 14;
    pub const M_MIN: usize = 15;
    pub const RATE_UP: usize = 16;
    pub const RATE_DOWN: usize = 17;
    pub const X_MAX: usize = 18;
    pub const X_MIN: usize = 19;
    pub const ANTI_WINDUP: usize = 20;
    pub const DAMPING: usize = 21;
    pub const LOAD_GAIN: usize = 22;
    pub const TAU_TWIST: usize = 23;
    pub const ZETA_TWIST: usize = 24;
    pub const T_N: usize = 25;
    pub const T_M: usize = 26;
    pub const S_U: usize = 27;
    pub const S_M: usize = 28;
    pub const INITIAL_N: usize = 29;
    pub const INITIAL_F: usize = 30;
    pub const UPDATE: usize = 31;
    pub const CURVATURE: usize = 32;
    pub const INITIAL_E: usize = 33;
    pub const U_0: usize = 34;
    pub const M_SOFT: usize = 35;
    pub const HOLD: usize = 36;
}

/// A checked parameter vector, by the places of [`at`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters(pub [f64; COUNT]);

/// Which numbers a parameter may be.
fn expected(place: usize) -> (fn(f64) -> bool, &'static str) {
    match place {
        at::TAU_N => (|value| value > 0.0 && value.is_finite(), "a positive number"),
        at::V => (|value| value != 0.0 && value.is_finite(), "a finite number other than 0"),
        at::T_D
        | at::T_SET
        | at::T_S
        | at::T_0
        | at::TAU_ACT
        | at::TAU_TWIST
        | at::ZETA_TWIST
        | at::T_N
        | at::T_M
        | at::M_SOFT => (|value| value >= 0.0 && value.is_finite(), "zero or more"),
        at::RATE_UP | at::RATE_DOWN => (|value| value > 0.0, "a positive number, infinity for none"),
        at::M_MAX | at::X_MAX => (|value| value > -INF, "a number, infinity for none"),
        at::M_MIN | at::X_MIN => (|value| value < INF, "a number, minus infinity for none"),
        at::HOLD => (|value| (0.0..=1.0).contains(&value), "0 to 1"),
        at::ANTI_WINDUP | at::UPDATE => (|value| [0.0, 1.0].contains(&value), "0 or 1"),
        _ => (f64::is_finite, "a finite number"),
    }
}

impl Parameters {
    /// Check a vector in the order of [`PARAMETERS`]; `what` is its name in a message.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a wrong length, or a value that makes no sense by itself or beside another.
    pub fn new(vector: &[f64], what: &str) -> Result<Self> {
        let values: [f64; COUNT] = vector.try_into().map_err(|_| {
            Error::Invalid(format!(
                "{what}: found {} values, expected {COUNT}, see SHIP_PARAMETERS",
                vector.len()
            ))
        })?;
        for (place, &value) in values.iter().enumerate() {
            let (fits, expected) = expected(place);
            require(fits(value), || {
                format!("{what}: found {} = {value}, expected {expected}", PARAMETERS[place])
            })?;
        }
        let found = Self(values);
        for [least, most] in [[at::M_MIN, at::M_MAX], [at::X_MIN, at::X_MAX]] {
            require(values[least] < values[most], || {
                format!(
                    "{what}: found {} = {}, expected less than {} = {}",
                    PARAMETERS[least], values[least], PARAMETERS[most], values[most]
                )
            })?;
        }
        let (tau_n, tau_prop) = (found.of(at::TAU_N), found.of(at::TAU_PROP));
        require(found.of(at::TAU_TWIST) == 0.0 || (tau_prop > 0.0 && tau_prop < tau_n), || {
            format!(
                "{what}: found tau_prop = {tau_prop} s beside a flexible shaft, expected more than 0 and less than tau_n = {tau_n} s"
            )
        })?;
        Ok(found)
    }

    /// The value at a place of [`at`].
    #[inline(always)]
    #[must_use]
    pub const fn of(&self, place: usize) -> f64 {
        self.0[place]
    }

    /// Whether a parameter stands where it has no effect.
    #[must_use]
    #[allow(clippy::float_cmp)] // The value without effect is that value exactly.
    pub fn is_off(&self, place: usize) -> bool {
        self.0[place] == OFF[place]
    }

    /// Steps a sample of `dt` seconds: none above 5 ms, nor above a twentieth of the loop's quickest time constant.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn substeps(&self, dt: f64) -> usize {
        const LONGEST_S: f64 = 5e-3;
        const PART: f64 = 0.05;
        const MOST: f64 = 1000.0;
        let fastest = (self.of(at::P) + self.of(at::DAMPING) - self.of(at::G)).abs()
            + (self.of(at::V) * self.of(at::K_P)).abs();
        let step = LONGEST_S.min(PART * self.of(at::TAU_N) / fastest.max(1e-9));
        (dt / step * (1.0 - 1e-9)).ceil().clamp(1.0, MOST) as usize
    }
}
