//! Parameters of the ship model by name and index: values without effect, and validation.

use crate::error::{Error, Result, require};
use crate::places::named_places;

const INF: f64 = f64::INFINITY;
const NAN: f64 = f64::NAN;

/// Parameters: index, name, and value without effect; NaN if there is no such value.
macro_rules! table {
    ($($place:ident $name:literal $off:expr,)+) => {
        named_places! {
            /// Names of the parameters, in the order of every parameter vector.
            PARAMETERS: $($place $name,)+
        }
        /// Values of the parameters without effect, NaN if there is no such value.
        pub const OFF: [f64; COUNT] = [$($off),+];
    };
}

table! {
    TAU_N "tau_n" NAN,
    G "g" NAN,
    V "v" NAN,
    K_P "K_p" NAN,
    K_I "K_i" NAN,
    K_D "K_d" 0.0,
    P "p" NAN,
    TAU_PROP "tau_prop" 0.0,
    T_D "T_d" 0.0,
    T_SET "T_set" 0.0,
    T_S "T_s" 0.0,
    T_0 "T_0" 0.0,
    TAU_ACT "tau_act" 0.0,
    M_MAX "M_max" INF,
    M_MAX_SLOPE "M_max_slope" 0.0,
    M_MIN "M_min" -INF,
    RATE_UP "rate_up" INF,
    RATE_DOWN "rate_down" INF,
    X_MAX "X_max" INF,
    X_MIN "X_min" -INF,
    ANTI_WINDUP "anti_windup" 0.0,
    DAMPING "damping" 0.0,
    LOAD_GAIN "load_gain" 0.0,
    TAU_TWIST "tau_twist" 0.0,
    ZETA_TWIST "zeta_twist" 0.0,
    T_N "T_n" 0.0,
    T_M "T_M" 0.0,
    S_U "s_u" 1.0,
    S_M "s_M" 1.0,
    INITIAL_N "initial_N" 1.0,
    INITIAL_F "initial_F" 0.0,
    UPDATE "update" 0.0,
    CURVATURE "curvature" 0.0,
    INITIAL_E "initial_E" 0.0,
    U_0 "u_0" 0.0,
    M_SOFT "M_soft" 0.0,
    HOLD "hold" 0.0,
    T_F "T_f" 0.0,
    TAU_ENG "tau_eng" 0.0,
    DROOP "droop" 0.0,
}
/// Number of parameters.
pub const COUNT: usize = PARAMETERS.len();

/// A validated parameter vector, by the indices of [`at`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters(pub [f64; COUNT]);

/// Validity test of a parameter, and its description.
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
        | at::T_F
        | at::TAU_ENG
        | at::DROOP
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
    /// Validate a vector in the order of [`PARAMETERS`]; `what` is its name in a message.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a wrong length, or an invalid value or combination.
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

    /// The value at an index of [`at`].
    #[inline(always)]
    #[must_use]
    pub const fn of(&self, place: usize) -> f64 {
        self.0[place]
    }

    /// Whether a parameter has its value without effect.
    #[must_use]
    #[allow(clippy::float_cmp)] // The value without effect is that value exactly.
    pub fn is_off(&self, place: usize) -> bool {
        self.0[place] == OFF[place]
    }

    /// Steps per sample of `dt` seconds. A step is at most 5 ms and a twentieth of the loop's smallest time constant.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn substeps(&self, dt: f64) -> usize {
        const LONGEST_S: f64 = 5e-3;
        const PART: f64 = 0.05;
        const MOST: f64 = 1000.0;
        let gain = self.of(at::V) * self.of(at::K_P);
        let fastest = (self.of(at::P) + self.of(at::DAMPING) - self.of(at::G)).abs()
            + (gain / (1.0 + self.of(at::DROOP) * gain)).abs();
        let step = LONGEST_S.min(PART * self.of(at::TAU_N) / fastest.max(1e-9));
        (dt / step * (1.0 - 1e-9)).ceil().clamp(1.0, MOST) as usize
    }
}
