//! A step of a ship with what only the simulation of a whole drive train needs.

use crate::scalar::Scalar;

use super::command::Clock;
use super::shaft::Twist;
use super::step::{Ahead, Ship};

impl<T: Scalar, const D: bool> Ship<'_, T, D> {
    /// Torque of the engine as the step begins.
    #[inline(always)]
    pub(super) fn braked(&self) -> T {
        match &self.detail {
            Some(detail) if D => self.speed.constant(detail.brake),
            _ => self.engine(self.speed, self.rack).0,
        }
    }

    /// That torque, less what is lost on the engine's side.
    #[inline(always)]
    pub(super) fn driving(&mut self) -> T {
        self.driving_at(self.speed, self.rack)
    }

    #[inline(always)]
    fn driving_at(&mut self, speed: T, rack: T) -> T {
        let asked = self.engine(speed, rack).0;
        match &mut self.detail {
            Some(detail) if D => asked.constant(detail.net(asked.value(), speed.value())),
            _ => asked,
        }
    }

    /// A command, less what the governor takes off for the filtered speed's rate.
    #[inline(always)]
    pub(super) fn eased(&self, command: T) -> T {
        self.detail.as_ref().map_or(command, |detail| command.plus(self.c.k_d, -detail.pace))
    }

    /// Let a governor that computes once a firing do so when one is due in this step.
    #[inline(always)]
    pub(super) fn time_firing(&self, clock: &mut Clock<T>) {
        if let (Some(detail), true) = (&self.detail, clock.at_firings) {
            let due = detail.fires().map_or(f64::INFINITY, |part| (self.at as f64 + part) * self.h);
            clock.next = clock.next.constant(due);
            // Firings come quicker as the engine does; the sum is one over time.
            if clock.taken > 0 && due.is_finite() {
                clock.period = clock.next - clock.first;
            }
        }
    }

    #[inline(always)]
    pub(super) fn sample_detail(&mut self, speed: T, period: T) {
        if let Some(detail) = &mut self.detail {
            detail.sample(speed.value(), period.value());
        }
    }

    /// Highest rack that stop and charge air allow at the step's end.
    #[inline(always)]
    fn choke(&mut self) {
        if let Some(detail) = &self.detail
            && detail.smokes()
        {
            self.c.rack_most = self.rack.constant(detail.ceiling(self.rack.value(), self.h));
        }
    }

    /// Begin with the ripple of the propeller, in the charge air of the rack.
    pub(super) fn rest_detail(&mut self) {
        if let Some(detail) = &mut self.detail {
            self.law = self.law * detail.propeller.ripple();
            detail.stop = self.c.rack_most.value();
        }
        self.choke();
    }

    /// Foresee the step's end by the firings that are under way, where there are any.
    #[inline(always)]
    fn foresee(&mut self, ahead: &mut Ahead<T>) {
        let Some(detail) = &mut self.detail else { return };
        if let Some(torque) = detail.foresee(0.5 * (self.speed + ahead.speed).value(), self.h) {
            let mean = ahead.speed.constant(torque);
            let pace = match &self.twist {
                Some(twist) => {
                    (mean - twist.torque(self.speed).plus(twist.torque_growth, 0.5)) * twist.inverse
                }
                None => (mean - self.law + -0.5 * detail.load_growth) * self.c.inverse_tau,
            };
            self.growth = (pace - self.acceleration) * 2.0;
            ahead.rise = pace * self.h;
            ahead.speed = self.speed + ahead.rise;
        }
        detail.follow(ahead.rise.value(), self.h);
    }

    /// A step of either shaft.
    #[inline(always)]
    pub(super) fn detailed(&mut self, mut ahead: Ahead<T>) {
        self.foresee(&mut ahead);
        self.choke();
        let [rack, mean_rack] = self.driven(&ahead);
        let drive = self.drive(&ahead, rack, mean_rack);
        let speed = match self.twist.take() {
            Some(twist) => self.detailed_twist(twist, drive),
            None => self.detailed_rigid(&ahead, drive),
        };
        let net = self.driving_at(speed, rack);
        let ended = match &self.twist {
            Some(twist) => (net - twist.torque(speed)) * twist.inverse,
            None => (net - self.law) * self.c.inverse_tau,
        };
        self.arrived(speed, ended, speed - ahead.speed, rack);
    }

    /// Torque on the engine's side at both ends of the step, behind what its firings and its rate make of it.
    #[inline(always)]
    fn drive(&mut self, ahead: &Ahead<T>, rack: T, mean_rack: T) -> [T; 2] {
        // A command that jumps in a step did so before a cylinder fires: the governor computes first.
        let stairs = self.clock.is_some() && !self.acting.lag;
        let fires = self.detail.as_ref().is_some_and(|detail| detail.fires().is_some());
        let start = if stairs && fires { rack } else { mean_rack * 2.0 - rack };
        let asked = [(self.speed, start), (ahead.speed, rack)]
            .map(|(speed, rack)| self.engine(speed, rack).0.value());
        let speeds = [self.speed.value(), ahead.speed.value()];
        let drive = self.detail.as_mut().map_or(asked, |detail| {
            detail.breathe(mean_rack.value(), self.h);
            detail.drive(asked, speeds, self.h, stairs)
        });
        drive.map(|torque| rack.constant(torque))
    }

    /// Load at both ends of a step that takes the propeller from a speed to another one, and its slope.
    #[inline(always)]
    fn loaded(&mut self, from: T, to: T) -> ([T; 2], T) {
        let begun = self.law.value();
        let Some(detail) = &mut self.detail else { return ([self.law; 2], to) };
        let [law, slope] = detail.propeller.load(&mut self.law_of, from.value(), to, self.h);
        self.law = to.constant(law);
        (detail.bent_load([begun, law]).map(|torque| to.constant(torque)), to.constant(slope))
    }

    #[inline(always)]
    fn detailed_rigid(&mut self, ahead: &Ahead<T>, drive: [T; 2]) -> T {
        let (load, slope) = self.loaded(self.speed, ahead.speed);
        let mean = (drive[0] + drive[1] - load[0] - load[1]) * 0.5;
        let speed = self.speed.plus_product(mean, self.c.step_over_tau);
        self.law = self.law.plus_product(speed - ahead.speed, slope);
        speed
    }

    #[inline(always)]
    fn detailed_twist(&mut self, mut twist: Box<Twist<T>>, drive: [T; 2]) -> T {
        let torque = twist.torque(self.speed);
        let pace = (torque - self.law) * twist.inverse_prop;
        let ahead = twist.propeller.plus(pace, self.h).plus(twist.propeller_growth, 0.5 * self.h);
        let (load, slope) = self.loaded(twist.propeller, ahead);
        let speed = twist.go(self.speed, drive, load);
        self.law = self.law.plus_product(twist.propeller - ahead, slope);
        let after = twist.torque(speed);
        twist.torque_growth = after - torque;
        twist.propeller_growth = (after - self.law) * twist.inverse_prop - pace;
        self.twist = Some(twist);
        speed
    }
}
