//! Speed governor: proportional, integral, and derivative of the filtered speed, between the limits of the rack.

use crate::plant::limited;
use crate::scalar::{Scalar, smaller};

/// When the governor computes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Timing {
    /// Always.
    Continuous,
    /// Computes once in so many seconds, and holds its command between.
    Every(f64),
    /// Computes at each firing, and holds its command between.
    AtFiring,
}

/// Turns engine speed and its set point into the commanded fuel rack.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub struct Governor<T = f64> {
    /// Rack position without any error, `X_0` [mm].
    pub base_rack: T,
    /// [mm/(rev/s)].
    pub proportional: T,
    /// [mm/rev].
    pub integral: T,
    /// Derivative gain, on the speed alone, so that a step of the set point gives no peak [mm s/(rev/s)].
    pub derivative: T,
    /// Time constant of the derivative's filter [s].
    pub filter: T,
    pub minimum_rack: T,
    pub maximum_rack: T,
    /// Whether the integral is held while a limit acts on the command.
    pub anti_windup: bool,
    pub timing: Timing,
}

/// Limits of the command at a time: of the rack, and of the engine's torque.
#[derive(Debug, Clone, Copy)]
pub struct Ceiling<T = f64> {
    /// Limit of the rack [mm]: its stop and the smoke limit.
    pub rack: T,
    /// The rack at which the engine's torque meets its envelope [mm].
    pub torque: T,
}

/// A command and how the governor's memory changes.
#[derive(Debug, Clone, Copy)]
pub struct Command<T = f64> {
    /// [mm].
    pub rack: T,
    /// Rate of the integrated error [rev/s].
    pub error_rate: T,
    /// Rate of the filtered speed [rev/s2].
    pub filter_rate: T,
}

/// What decides whether anti-windup holds the integral.
#[derive(Debug, Clone, Copy)]
pub struct Wait<T = f64> {
    /// Speed error [rev/s].
    miss: T,
    /// Excess of the command over the limit in the direction of the error [mm]; the integral is held where it is positive.
    excess: T,
}

impl<T: Scalar> Governor<T> {
    /// Whether the integral is held, for a governor that computes continuously.
    #[inline(always)]
    #[must_use]
    pub fn wait(&self, set_speed: T, speed: T, integrated: T, filtered: T, ceiling: &Ceiling<T>) -> Wait<T> {
        let (miss, lead) = (set_speed - speed, speed - filtered);
        let wanted = self.wanted(miss, integrated, lead, self.filter);
        let excess = if miss.value() > 0.0 {
            wanted - smaller(ceiling.rack, ceiling.torque)
        } else {
            self.minimum_rack - wanted
        };
        Wait { miss, excess }
    }

    /// A correction of the integral after a step from `begin` to `end`; its value is zero, it has derivatives only.
    ///
    /// Where the integral begins or ceases to be held its rate jumps. So the integral depends on the time of the jump, which a
    /// step does not know. The derivative of this time is that of the excess over the excess' rate (di Bernardo et al. 2008,
    /// *Piecewise-smooth Dynamical Systems*, section 2.5, the saltation matrix). Where the excess comes straight back, the
    /// command slides along its limit, and the excess depends on nothing: so it does where the integral waited in some
    /// stages of the step, `torn`, and yet not more at its end than at its begin.
    #[inline(always)]
    #[must_use]
    pub fn switched(&self, begin: &Wait<T>, end: &Wait<T>, step: T, torn: bool) -> T {
        let (from, to) = (begin.excess.value(), end.excess.value());
        let switches = (from > 0.0) != (to > 0.0);
        let turned = begin.miss.value() * end.miss.value() <= 0.0;
        if turned || !(switches || torn) || !(from - to).is_finite() {
            return step.constant(0.0);
        }
        let slides = |excess: T, by_integral: f64| (excess + -excess.value()) * (-1.0 / by_integral);
        if !switches {
            return slides(end.excess, self.integral.value() * end.miss.value().signum());
        }
        let part = from / (from - to);
        let excess = begin.excess * (1.0 - part) + end.excess * part;
        let miss = begin.miss.value() * (1.0 - part) + end.miss.value() * part;
        let jump = if to > 0.0 { -miss } else { miss };
        let by_integral = self.integral.value() * if miss > 0.0 { 1.0 } else { -1.0 };
        let rate = (to - from) / step.value();
        let after = rate + by_integral * jump;
        if after * rate > 0.0 {
            (excess + -excess.value()) * (jump / rate)
        } else {
            slides(excess, by_integral)
        }
    }

    #[inline(always)]
    fn wanted(&self, miss: T, integrated: T, lead: T, filter: T) -> T {
        let wanted = self.base_rack + self.proportional * miss + self.integral * integrated;
        if self.derivative.is_zero() { wanted } else { wanted - self.derivative * lead / filter }
    }

    /// What is ordered at a speed error [rev/s], its integral [rev] and a lead of the speed over the filtered one [rev/s],
    /// over so long a filter time [s]; and whether the integral may go on.
    #[inline(always)]
    fn order(&self, miss: T, integrated: T, lead: T, filter: T, ceiling: &Ceiling<T>) -> (T, bool) {
        let wanted = self.wanted(miss, integrated, lead, filter);
        let held = (wanted.value() > smaller(ceiling.rack, ceiling.torque).value() && miss.value() > 0.0)
            || (wanted.value() < self.minimum_rack.value() && miss.value() < 0.0);
        (limited(wanted, self.minimum_rack, ceiling.rack), !(self.anti_windup && held))
    }

    /// The command of a governor that always computes.
    #[inline(always)]
    #[must_use]
    pub fn command(
        &self,
        set_speed: T,
        speed: T,
        integrated: T,
        filtered: T,
        ceiling: &Ceiling<T>,
    ) -> Command<T> {
        let (miss, lead) = (set_speed - speed, speed - filtered);
        let (rack, free) = self.order(miss, integrated, lead, self.filter, ceiling);
        Command {
            rack,
            error_rate: if free { miss } else { miss.constant(0.0) },
            filter_rate: if self.derivative.is_zero() { miss.constant(0.0) } else { lead / self.filter },
        }
    }

    /// The command at a sample `elapsed` [s] after the one before, whose error was `miss_before`.
    ///
    /// The trapezoidal rule integrates, so that sampling delays by the hold alone, half a period.
    #[inline(always)]
    #[must_use]
    pub fn sample(
        &self,
        set_speed: T,
        speed: T,
        memory: &mut Memory<T>,
        elapsed: T,
        ceiling: &Ceiling<T>,
    ) -> T {
        let (miss, lead) = (set_speed - speed, speed - memory.filtered);
        let filter = self.filter + elapsed;
        let integrated = memory.integrated + elapsed * 0.5 * (miss + memory.miss);
        let (mut rack, free) = self.order(miss, integrated, lead, filter, ceiling);
        if free {
            memory.integrated = integrated;
        } else {
            (rack, _) = self.order(miss, memory.integrated, lead, filter, ceiling);
        }
        if !self.derivative.is_zero() {
            memory.filtered = memory.filtered + elapsed / filter * lead;
        }
        memory.miss = miss;
        rack
    }
}

/// What a sampling governor keeps between samples.
#[derive(Debug, Clone, Copy)]
pub struct Memory<T = f64> {
    /// Integrated error [rev].
    pub integrated: T,
    /// Filtered speed [rev/s].
    pub filtered: T,
    /// Error at the last sample [rev/s].
    pub miss: T,
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::*;

    const GOVERNOR: Governor = Governor {
        base_rack: 10.0,
        proportional: 2.0,
        integral: 4.0,
        derivative: 0.5,
        filter: 0.25,
        minimum_rack: 0.0,
        maximum_rack: 16.0,
        anti_windup: true,
        timing: Timing::Every(0.25),
    };
    const OPEN: Ceiling = Ceiling { rack: 16.0, torque: f64::INFINITY };

    #[test]
    fn samples_by_hand() {
        let mut memory = Memory { integrated: 0.0, filtered: 20.0, miss: 0.0 };
        // Error 1, integral 0.25 (0 + 1)/2 = 0.125: 10 + 2 + 0.5.
        assert_eq!(GOVERNOR.sample(21.0, 20.0, &mut memory, 0.25, &OPEN), 12.5);
        // Speed leads its filter by 0.5; derivative 0.5 * 0.5 / 0.5; error 0.5, integral 0.125 + 0.1875.
        assert_eq!(GOVERNOR.sample(21.0, 20.5, &mut memory, 0.25, &OPEN), 10.0 + 1.0 + 1.25 - 0.5);
        assert_eq!(memory.filtered, 20.25);
    }

    #[test]
    fn the_integral_stands_still_at_a_limit_and_only_against_it() {
        let mut memory = Memory { integrated: 1.0, filtered: 20.0, miss: 4.0 };
        assert_eq!(GOVERNOR.sample(24.0, 20.0, &mut memory, 0.25, &OPEN), 16.0);
        assert_eq!(memory.integrated, 1.0);
        let back = GOVERNOR.command(19.0, 20.0, 4.0, 20.0, &OPEN);
        assert_eq!((back.rack, back.error_rate), (16.0, -1.0));
        let full = Ceiling { rack: 16.0, torque: 12.0 };
        assert_eq!(GOVERNOR.command(21.0, 20.0, 1.0, 20.0, &full).error_rate, 0.0);
        let winding = Governor { anti_windup: false, ..GOVERNOR };
        assert_eq!(winding.command(24.0, 20.0, 1.0, 20.0, &OPEN).error_rate, 4.0);
    }
}
