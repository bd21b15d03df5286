//! The rack over a step: the governor's command after dead time and lag, within limits of rate and position.

use super::inputs::Span;
use super::step::{Ahead, Ship};

impl<const D: bool> Ship<'_, D> {
    /// Governor's command for an error, an integral and an acceleration.
    #[inline(always)]
    pub(super) fn commanded(&self, error: f64, sum: f64, acceleration: f64) -> f64 {
        let command = self.c.k_p * error + self.c.k_i * sum;
        if self.acting.derivative {
            command - self.c.k_d * acceleration
        } else if D {
            self.eased(command)
        } else if self.acting.filter {
            command - self.c.k_d * (self.speed - self.filtered) / self.c.filter.time
        } else {
            command
        }
    }

    /// Rack at the step's end, and its mean, for a continuous governor; updates its integral.
    #[inline(always)]
    pub(super) fn fed(&mut self, ahead: &Ahead) -> [f64; 2] {
        let Ahead { speed, rise, against } = *ahead;
        let seen = self.seen_after(speed);
        if !self.winds_up {
            let error = self.set_span.mean - self.speed;
            self.sum = self.sum + error * self.h - rise * (0.5 * self.h);
            // The integral of the filtered speed is that of the speed minus `T_f` times the filtered speed's change.
            self.sum += self.c.filter.time * (seen - self.filtered);
        }
        let mut command = self.c.k_p * (self.set_span.end - seen) + self.c.k_i * self.sum;
        if D {
            command = self.eased(command);
        } else if self.acting.filter {
            command -= self.c.k_d * (speed - seen) / self.c.filter.time;
        }
        if self.c.droop > 0.0 && !self.winds_up {
            let less = self.drooped(command);
            self.sum -= less;
            command -= self.c.k_i * less;
        }
        let mut found = self.followed(self.dead_time.over(self.at, self.start, command));
        if self.acting.derivative {
            // The command depends on the acceleration that it causes.
            let acceleration = self.brought_about(speed, found[0], against, self.at_once * self.c.k_d);
            let command = command - self.c.k_d * acceleration;
            found = self.followed(self.dead_time.over(self.at, self.start, command));
        }
        self.limited(found)
    }

    /// Decrease of the error's integral by the droop over a step. Without this decrease the command rises linearly to
    /// `command`.
    #[inline(always)]
    fn drooped(&self, command: f64) -> f64 {
        let ended = if self.acting.derivative {
            command - self.c.k_d * (self.acceleration + self.growth)
        } else {
            command
        };
        let half = 0.5 * self.c.droop * self.h;
        half * (self.start + ended) / (1.0 + half * self.c.k_i)
    }

    /// Rack after the actuator's lag and rate limit.
    #[inline(always)]
    fn followed(&self, late: Span) -> [f64; 2] {
        if self.acting.rate {
            // Linear command with the given mean and end.
            let start = 2.0 * late.mean - late.end;
            let [rack, area] = paced(self.rack, start, (late.end - start) / self.h, self.h, self.pace());
            return [rack, area / self.h];
        }
        if !self.acting.lag {
            return [late.end, late.mean];
        }
        let lag = &self.c.lag;
        let rack = lag.over(self.lagged, late.end, late.mean);
        [rack, late.mean + (self.lagged - rack) * lag.in_steps]
    }

    #[inline(always)]
    fn pace(&self) -> Pace {
        Pace { lag: self.c.lag.time, up: self.c.fastest_up, down: self.c.fastest_down }
    }

    /// Rack within the limits of position.
    #[inline(always)]
    fn limited(&self, [mut rack, mut mean]: [f64; 2]) -> [f64; 2] {
        if self.acting.rack_limit {
            let within = self.within_limits(rack);
            if within != rack {
                rack = within;
                mean = (within + self.rack) * 0.5;
            }
        }
        [rack, mean]
    }

    #[inline(always)]
    pub(super) fn within_limits(&self, rack: f64) -> f64 {
        if !self.acting.rack_limit {
            rack
        } else if rack > self.c.rack_most {
            self.c.rack_most
        } else if rack < self.c.rack_least {
            self.c.rack_least
        } else {
            rack
        }
    }

    /// Rack at the step's end, and mean rack over the step, for a governor that samples by a clock.
    #[inline(always)]
    pub(super) fn clocked(&mut self) -> [f64; 2] {
        let (h, begin) = (self.h, self.at as f64 * self.h);
        let end = begin + h * (1.0 - 1e-9);
        let Some(mut clock) = self.clock.take() else {
            return [self.rack; 2];
        };
        if D {
            self.time_firing(&mut clock);
        }
        while clock.next < end {
            let since = clock.next - begin;
            let grown = self.growth * since * (1.0 / h);
            let speed = self.speed + (self.acceleration + grown * 0.5) * since;
            let seen = self.seen_within(speed, since);
            let (acceleration, error) = (self.acceleration + grown, self.set.at(clock.next) - seen);
            if D {
                self.sample_detail(speed, clock.period);
            }
            let sum = self.sum + error * clock.period;
            let lost = self.c.droop * clock.period;
            let mut command = if clock.sums_first {
                self.commanded(error, sum, acceleration) / (1.0 + lost * self.c.k_i)
            } else {
                self.commanded(error, self.sum, acceleration)
            };
            let sum = sum - lost * command;
            if self.stands(command, error) {
                command = self.commanded(error, self.sum, acceleration);
            } else {
                self.sum = sum;
            }
            clock.coming.push_back((clock.next + self.late, command));
            clock.taken += 1;
            if D && clock.at_firings {
                clock.first = clock.next;
                break;
            }
            clock.next = clock.first + clock.period * clock.taken as f64;
        }
        let (mut rack, mut area, mut from) = (self.rack, 0.0, 0.0);
        loop {
            let arrived = clock.coming.front().filter(|(time, _)| *time < end);
            let to = arrived.map_or(h, |(time, _)| time - begin);
            let length = (to - from).max(0.0);
            let [last, more] = paced(rack, clock.acting, 0.0, length, self.pace());
            area += more;
            (rack, from) = (last, to);
            let Some((_, command)) = arrived else { break };
            clock.acting = *command;
            clock.coming.pop_front();
        }
        self.clock = Some(clock);
        self.limited([rack, area * (1.0 / h)])
    }
}

/// Actuator dynamics: lag [s], and highest rates up and down.
#[derive(Debug, Clone, Copy)]
pub struct Pace {
    pub lag: f64,
    pub up: f64,
    pub down: f64,
}

/// Rack after `length` seconds, and its integral over time, for a linear command: exact.
///
/// The rack moves at the rate limit while the lag demands a higher rate, and otherwise as the lag demands; at most three
/// phases.
#[inline(always)]
pub fn paced(rack: f64, command: f64, slope: f64, length: f64, pace: Pace) -> [f64; 2] {
    let Pace { lag: tau, up, down } = pace;
    let gap = command - rack;
    let (mut held, mut reached) = (0.0, rack);
    if gap > up * tau || gap < down * tau {
        let pace = if gap > 0.0 { up } else { down };
        let until = (gap - pace * tau) / (pace - slope);
        held = if until > 0.0 { until.min(length) } else { length };
        reached += pace * held;
    }
    let mut area = 0.5 * (rack + reached) * held;
    let (asked, left, pace) = (command + slope * held, length - held, slope.clamp(down, up));
    if left == 0.0 {
        return [reached, area];
    }
    let (mut free, mut freed) = (0.0, asked);
    if tau > 0.0 {
        let beyond = asked - reached - slope * tau;
        let until = if pace == slope { left } else { tau * (beyond / (tau * (pace - slope))).ln() };
        free = until.clamp(0.0, left);
        freed = asked + slope * (free - tau) - beyond * (-free / tau).exp();
        area += (asked + 0.5 * slope * free) * free + tau * (reached - freed);
    }
    let last = freed + pace * (left - free);
    [last, area + 0.5 * (freed + last) * (left - free)]
}
