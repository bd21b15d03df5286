//! Speed governor: proportional, integral, and derivative of the filtered speed, between the limits of the rack.

use super::engine::limited;

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
pub struct Governor {
    /// Rack position without any error, `X_0` [mm].
    pub base_rack: f64,
    /// [mm/(rev/s)].
    pub proportional: f64,
    /// [mm/rev].
    pub integral: f64,
    /// Derivative gain, on the speed alone, so that a step of the set point gives no peak [mm s/(rev/s)].
    pub derivative: f64,
    /// Time constant of the derivative's filter [s].
    pub filter: f64,
    pub minimum_rack: f64,
    pub maximum_rack: f64,
    /// Whether the integral is held while a limit acts on the command.
    pub anti_windup: bool,
    pub timing: Timing,
}

/// Limits of the command at a time: of the rack, and of the engine's torque.
#[derive(Debug, Clone, Copy)]
pub struct Ceiling {
    /// Limit of the rack [mm]: its stop and the smoke limit.
    pub rack: f64,
    /// The rack at which the engine's torque meets its envelope [mm].
    pub torque: f64,
}

/// A command and how the governor's memory changes.
#[derive(Debug, Clone, Copy)]
pub struct Command {
    /// [mm].
    pub rack: f64,
    /// Rate of the integrated error [rev/s].
    pub error_rate: f64,
    /// Rate of the filtered speed [rev/s2].
    pub filter_rate: f64,
}

impl Governor {
    #[inline(always)]
    fn wanted(&self, miss: f64, integrated: f64, lead: f64, filter: f64) -> f64 {
        let wanted = self.base_rack + self.proportional * miss + self.integral * integrated;
        if self.derivative == 0.0 { wanted } else { wanted - self.derivative * lead / filter }
    }

    /// What is ordered at a speed error [rev/s], its integral [rev] and a lead of the speed over the filtered one [rev/s],
    /// over so long a filter time [s]; and whether the integral may go on.
    #[inline(always)]
    fn order(&self, miss: f64, integrated: f64, lead: f64, filter: f64, ceiling: &Ceiling) -> (f64, bool) {
        let wanted = self.wanted(miss, integrated, lead, filter);
        let held = (wanted > ceiling.rack.min(ceiling.torque) && miss > 0.0)
            || (wanted < self.minimum_rack && miss < 0.0);
        (limited(wanted, self.minimum_rack, ceiling.rack), !(self.anti_windup && held))
    }

    /// The command of a governor that always computes.
    #[inline(always)]
    #[must_use]
    pub fn command(
        &self,
        set_speed: f64,
        speed: f64,
        integrated: f64,
        filtered: f64,
        ceiling: &Ceiling,
    ) -> Command {
        let (miss, lead) = (set_speed - speed, speed - filtered);
        let (rack, free) = self.order(miss, integrated, lead, self.filter, ceiling);
        Command {
            rack,
            error_rate: if free { miss } else { 0.0 },
            filter_rate: if self.derivative == 0.0 { 0.0 } else { lead / self.filter },
        }
    }

    /// The command at a sample `elapsed` [s] after the one before, whose error was `miss_before`.
    ///
    /// The trapezoidal rule integrates, so that sampling delays by the hold alone, half a period.
    #[inline(always)]
    #[must_use]
    pub fn sample(
        &self,
        set_speed: f64,
        speed: f64,
        memory: &mut Memory,
        elapsed: f64,
        ceiling: &Ceiling,
    ) -> f64 {
        let (miss, lead) = (set_speed - speed, speed - memory.filtered);
        let filter = self.filter + elapsed;
        let integrated = memory.integrated + elapsed * 0.5 * (miss + memory.miss);
        let (mut rack, free) = self.order(miss, integrated, lead, filter, ceiling);
        if free {
            memory.integrated = integrated;
        } else {
            (rack, _) = self.order(miss, memory.integrated, lead, filter, ceiling);
        }
        if self.derivative != 0.0 {
            memory.filtered += elapsed / filter * lead;
        }
        memory.miss = miss;
        rack
    }
}

/// What a sampling governor keeps between samples.
#[derive(Debug, Clone, Copy)]
pub struct Memory {
    /// Integrated error [rev].
    pub integrated: f64,
    /// Filtered speed [rev/s].
    pub filtered: f64,
    /// Error at the last sample [rev/s].
    pub miss: f64,
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
