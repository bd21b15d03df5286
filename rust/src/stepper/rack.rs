//! The rack over a step: the governor's command behind dead time and lag, within the limits of rate and position.

use crate::scalar::Scalar;

use super::inputs::Span;
use super::step::{Ahead, Ship};

impl<T: Scalar, const D: bool> Ship<'_, T, D> {
    /// What the governor orders at an error, a sum and an acceleration.
    #[inline(always)]
    pub(super) fn commanded(&self, error: T, sum: T, acceleration: T) -> T {
        let command = (self.c.k_p * error).plus_product(self.c.k_i, sum);
        if self.acting.derivative {
            command - self.c.k_d * acceleration
        } else if D {
            self.eased(command)
        } else {
            command
        }
    }

    /// The rack at the step's end, and its mean, of a governor that computes all the time; its sum goes on.
    #[inline(always)]
    pub(super) fn fed(&mut self, ahead: &Ahead<T>) -> [T; 2] {
        let Ahead { speed, rise, against } = *ahead;
        if !self.winds_up {
            let error = self.set_span.mean - self.speed;
            self.sum = self.sum.plus(error, self.h).plus(rise, -0.5 * self.h);
        }
        let mut command = (self.c.k_p * (self.set_span.end - speed)).plus_product(self.c.k_i, self.sum);
        if D {
            command = self.eased(command);
        }
        let mut found = self.followed(self.dead_time.over(self.at, self.start, command));
        if self.acting.derivative {
            // The command holds the acceleration that it brings about.
            let acceleration = self.brought_about(speed, found[0], against, self.at_once * self.c.k_d);
            let command = command - self.c.k_d * acceleration;
            found = self.followed(self.dead_time.over(self.at, self.start, command));
        }
        self.limited(found)
    }

    /// Behind the actuator's lag.
    #[inline(always)]
    fn followed(&self, late: Span<T>) -> [T; 2] {
        if !self.acting.lag {
            return [late.end, late.mean];
        }
        let lag = &self.c.lag;
        let rack = late
            .end
            .plus_product(self.lagged - late.end, lag.stays)
            .plus_product(late.end - late.mean, lag.bend);
        [rack, late.mean.plus_product(self.lagged - rack, lag.in_steps)]
    }

    /// Within the limits of rate and position.
    #[inline(always)]
    fn limited(&self, [mut rack, mut mean]: [T; 2]) -> [T; 2] {
        if self.acting.rate {
            let way = rack.value() - self.rack.value();
            if way > self.c.fastest_up.value() {
                rack = self.rack + self.c.fastest_up;
                mean = (rack + self.rack) * 0.5;
            } else if way < self.c.fastest_down.value() {
                rack = self.rack + self.c.fastest_down;
                mean = (rack + self.rack) * 0.5;
            }
        }
        if self.acting.rack_limit {
            let within = self.within_limits(rack);
            if within.value() != rack.value() {
                rack = within;
                mean = (within + self.rack) * 0.5;
            }
        }
        [rack, mean]
    }

    #[inline(always)]
    pub(super) fn within_limits(&self, rack: T) -> T {
        if !self.acting.rack_limit {
            rack
        } else if rack.value() > self.c.rack_most.value() {
            self.c.rack_most
        } else if rack.value() < self.c.rack_least.value() {
            self.c.rack_least
        } else {
            rack
        }
    }

    /// The rack at the step's end, and its mean, behind a governor that computes at its own clock.
    #[inline(always)]
    pub(super) fn clocked(&mut self) -> [T; 2] {
        let (h, begin) = (self.h, self.at as f64 * self.h);
        let end = begin + h * (1.0 - 1e-9);
        let Some(mut clock) = self.clock.take() else {
            return [self.rack; 2];
        };
        if D {
            self.time_firing(&mut clock);
        }
        while clock.next.value() < end {
            let since = clock.next + (-begin);
            let grown = self.growth * since * (1.0 / h);
            let speed = self.speed + self.acceleration.plus(grown, 0.5) * since;
            let (acceleration, error) = (self.acceleration + grown, self.set.at(clock.next) - speed);
            if D {
                self.sample_detail(speed, clock.period);
            }
            let sum = self.sum.plus_product(error, clock.period);
            let mut command =
                self.commanded(error, if clock.sums_first { sum } else { self.sum }, acceleration);
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
        let zero = self.speed.constant(0.0);
        let (mut rack, mut area, mut from) = (self.rack, zero, zero);
        loop {
            let arrived = clock.coming.front().filter(|(time, _)| time.value() < end);
            let to = arrived.map_or(zero.constant(h), |(time, _)| *time + (-begin));
            let length = to - from;
            let mut last = clock.acting;
            if self.acting.lag {
                let time = self.c.lag.time;
                if time.value() > 0.0 {
                    let stays = length / time;
                    let decay = (-stays.value()).exp();
                    last = last + (rack - last) * stays.function(decay, -decay);
                }
                area = area.plus_product(time, rack - last);
            }
            area = area.plus_product(clock.acting, length);
            (rack, from) = (last, to);
            let Some((_, command)) = arrived else { break };
            clock.acting = *command;
            clock.coming.pop_front();
        }
        self.clock = Some(clock);
        self.limited([rack, area * (1.0 / h)])
    }
}
