//! Ends of steps late in a record.

use super::*;
use crate::drive_train::{PARAMETERS, Tables};
use crate::hold::Hold;
use crate::stepper::Envelope;

fn train(dead_time: f64, period: f64) -> DriveTrain {
    let values = PARAMETERS.map(|name| match name {
        "inertia" => 21.2,
        "propeller_inertia" => 2.8,
        "gear_ratio" => 3.0,
        "shaft_stiffness" | "maximum_rack" | "smoke_margin" | "rack_rate" | "torque_rate" | "ship_mass" => {
            f64::INFINITY
        }
        "minimum_torque" | "minimum_rack" => f64::NEG_INFINITY,
        "torque_exponent" => 2.0,
        "set_dead_time" => dead_time,
        "governor_period" => period,
        "anti_windup" | "fuel_dead_time" | "fuel_lag" | "firing_interval" => 0.0,
        _ => 1.0,
    });
    DriveTrain::from_parameters(&values, Tables::default()).expect("a drive train")
}

/// The step that ends at a sample's arrival may begin a rounding before it, where a share of the step is less than that.
#[test]
fn breakage_b3_every_step_ends_later_than_it_begins() {
    let (dt, substeps) = (0.0025, 1000);
    let set_speed = vec![7.0; 10];
    let run = Run { set_speed: &set_speed, dt, substeps, hold: Hold::Zero };
    for (dead_time, period) in [(0.4756, 0.0), (0.3, 0.0), (0.1 / 3.0, 0.0), (0.0, 0.0037)] {
        let train = train(dead_time, period);
        let envelope = Envelope::new(&[], &[]).expect("no limit");
        let mut march = March::new(&train, &envelope, &run);
        for sample in (51_150..51_300_u32).chain(110_000..111_000).chain(900_000..901_000) {
            let arrival = march.set_point.next_break(f64::from(sample) * dt).min(1e6);
            if period > 0.0 {
                march.next_sample = (f64::from(sample) * dt / period).ceil() * period;
            }
            let event = if period > 0.0 { march.next_sample } else { arrival };
            let mut now = event;
            for _ in 0..4 {
                now = now.next_down();
            }
            for _ in 0..8 {
                let begin = march.flow(now);
                let border = event + 0.5 * march.step;
                let end = march.next_end(now, border, &begin);
                assert!(end > now, "sample {sample}: {end} after {now}");
                now = now.next_up();
            }
        }
    }
}
