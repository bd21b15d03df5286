//! A step of a ship with the additional elements of a whole drive train.

use super::command::Clock;
use super::shaft::Twist;
use super::step::{Ahead, Ship};

impl<const D: bool> Ship<'_, D> {
    /// Engine torque at the beginning of the step.
    #[inline(always)]
    pub(super) fn braked(&self) -> f64 {
        match &self.detail {
            Some(detail) if D => detail.brake,
            _ => self.engine(self.speed, self.burnt).0,
        }
    }

    /// Torque of the engine minus losses on the engine's side.
    #[inline(always)]
    pub(super) fn driving(&mut self) -> f64 {
        self.driving_at(self.speed, self.burnt)
    }

    #[inline(always)]
    fn driving_at(&mut self, speed: f64, rack: f64) -> f64 {
        let asked = self.engine(speed, rack).0;
        match &mut self.detail {
            Some(detail) if D => detail.net(asked, speed),
            _ => asked,
        }
    }

    /// A command minus the governor's derivative of the filtered speed.
    #[inline(always)]
    pub(super) fn eased(&self, command: f64) -> f64 {
        self.detail.as_ref().map_or(command, |detail| command - self.c.k_d * detail.pace)
    }

    /// Sample a governor that computes once per firing, if a firing is due in this step.
    #[inline(always)]
    pub(super) fn time_firing(&self, clock: &mut Clock) {
        if let (Some(detail), true) = (&self.detail, clock.at_firings) {
            let due = detail.fires().map_or(f64::INFINITY, |part| (self.at as f64 + part) * self.h);
            clock.next = due;
            // The time between firings varies with the speed, so the integral uses the actual time.
            if clock.taken > 0 && due.is_finite() {
                clock.period = clock.next - clock.first;
            }
        }
    }

    #[inline(always)]
    pub(super) fn sample_detail(&mut self, speed: f64, period: f64) {
        if let Some(detail) = &mut self.detail {
            detail.sample(speed, period);
        }
    }

    /// Set the highest rack at the step's end, which the rack's stop and the charge air limit.
    #[inline(always)]
    fn choke(&mut self) {
        if let Some(detail) = &self.detail
            && detail.smokes()
        {
            self.c.rack_most = detail.ceiling(self.rack, self.h);
        }
    }

    /// Set the initial ripple of the propeller, and the charge air for the initial rack.
    pub(super) fn rest_detail(&mut self) {
        if let Some(detail) = &mut self.detail {
            self.law *= detail.propeller.ripple();
            detail.stop = self.c.rack_most;
        }
        self.choke();
    }

    /// Predict the state at the step's end from the torque of the present firings, if the ship has any.
    #[inline(always)]
    fn foresee(&mut self, ahead: &mut Ahead) {
        let Some(detail) = &mut self.detail else { return };
        if let Some(mean) = detail.foresee(0.5 * (self.speed + ahead.speed), self.h) {
            let pace = match &self.twist {
                Some(twist) => (mean - twist.torque(self.speed) - 0.5 * twist.torque_growth) * twist.inverse,
                None => (mean - self.law - 0.5 * detail.load_growth) * self.c.inverse_tau,
            };
            self.growth = (pace - self.acceleration) * 2.0;
            ahead.rise = pace * self.h;
            ahead.speed = self.speed + ahead.rise;
        }
        detail.follow(ahead.rise, self.h);
    }

    /// A step of a stiff or torsionally flexible shaft.
    #[inline(always)]
    pub(super) fn detailed(&mut self, mut ahead: Ahead) {
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

    /// Engine torque at both ends of the step, with firings and the limited rate of torque.
    #[inline(always)]
    fn drive(&mut self, ahead: &Ahead, rack: f64, mean_rack: f64) -> [f64; 2] {
        // A jump of the command in a step precedes the firing, since the governor computes first.
        let stairs = self.clock.is_some() && !self.acting.lag;
        let fires = self.detail.as_ref().is_some_and(|detail| detail.fires().is_some());
        let start = if stairs && fires { rack } else { mean_rack * 2.0 - rack };
        let asked =
            [(self.speed, start), (ahead.speed, rack)].map(|(speed, rack)| self.engine(speed, rack).0);
        let speeds = [self.speed, ahead.speed];
        self.detail.as_mut().map_or(asked, |detail| {
            detail.breathe(mean_rack, self.h);
            detail.drive(asked, speeds, self.h, stairs)
        })
    }

    /// Load at both ends of a step in which the propeller's speed changes, and its slope.
    #[inline(always)]
    fn loaded(&mut self, from: f64, to: f64) -> ([f64; 2], f64) {
        let begun = self.law;
        let Some(detail) = &mut self.detail else { return ([self.law; 2], to) };
        let [law, slope] = detail.propeller.load(&mut self.law_of, from, to, self.h);
        self.law = law;
        (detail.bent_load([begun, law]), slope)
    }

    #[inline(always)]
    fn detailed_rigid(&mut self, ahead: &Ahead, drive: [f64; 2]) -> f64 {
        let (load, slope) = self.loaded(self.speed, ahead.speed);
        let mean = (drive[0] + drive[1] - load[0] - load[1]) * 0.5;
        let speed = self.speed + mean * self.c.step_over_tau;
        self.law += (speed - ahead.speed) * slope;
        speed
    }

    #[inline(always)]
    fn detailed_twist(&mut self, mut twist: Box<Twist>, drive: [f64; 2]) -> f64 {
        let torque = twist.torque(self.speed);
        let pace = (torque - self.law) * twist.inverse_prop;
        let ahead = twist.propeller + pace * self.h + twist.propeller_growth * (0.5 * self.h);
        let (load, slope) = self.loaded(twist.propeller, ahead);
        let speed = twist.go(self.speed, drive, load);
        self.law += (twist.propeller - ahead) * slope;
        let after = twist.torque(speed);
        twist.torque_growth = after - torque;
        twist.propeller_growth = (after - self.law) * twist.inverse_prop - pace;
        self.twist = Some(twist);
        speed
    }
}
