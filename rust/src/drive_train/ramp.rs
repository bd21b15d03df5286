//! A signal that changes no faster than its rate allows.

use super::engine::limited;

/// Follows a demand at a limited rate, infinite for no limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    rate: f64,
    value: f64,
}

impl Ramp {
    /// At rest at a value.
    #[must_use]
    pub fn new(rate: f64, value: f64) -> Self {
        Self { rate, value }
    }

    /// Whether the rate is limited at all.
    #[inline(always)]
    #[must_use]
    pub fn acts(&self) -> bool {
        self.rate.is_finite()
    }

    /// What of the demand is reached so long [s] after the value was.
    #[inline(always)]
    #[must_use]
    pub fn reached(&self, demand: f64, elapsed: f64) -> f64 {
        if self.acts() {
            let reach = self.rate * elapsed;
            limited(demand, self.value - reach, self.value + reach)
        } else {
            demand
        }
    }

    /// Let time pass, with the demand at its end.
    #[inline(always)]
    pub fn advance(&mut self, demand: f64, elapsed: f64) {
        self.value = self.reached(demand, elapsed);
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::Ramp;

    #[test]
    fn a_demand_out_of_reach_is_approached_at_the_rate() {
        let mut ramp = Ramp::new(8.0, 1.0);
        assert_eq!(ramp.reached(10.0, 0.25), 3.0);
        ramp.advance(10.0, 0.25);
        assert_eq!(ramp.reached(10.0, 0.5), 7.0);
        assert_eq!(ramp.reached(2.5, 0.5), 2.5);
        assert_eq!(ramp.reached(-10.0, 0.5), -1.0);
        assert!(ramp.reached(f64::NAN, 0.5).is_nan());
    }

    #[test]
    fn without_a_rate_the_demand_is_met_at_once() {
        assert_eq!(Ramp::new(f64::INFINITY, 1.0).reached(10.0, 0.0), 10.0);
    }
}
