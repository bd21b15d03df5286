//! Delayed sensors: past outputs, interpolated linearly between steps.

use super::output::Output;
use super::step::Ship;

/// Outputs of the last steps.
#[derive(Debug)]
pub struct Late {
    channels: Vec<(usize, f64)>,
    ring: Vec<f64>,
    length: usize,
    at: usize,
}

impl Late {
    /// None without a delay.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new<const D: bool>(ship: &Ship<'_, D>, outputs: &[Output], h: f64) -> Option<Self> {
        let [speed, torque] = ship.channel_delays()?;
        let channels: Vec<_> = outputs
            .iter()
            .map(|output| match output {
                Output::Speed | Output::PropellerSpeed => speed,
                Output::EngineTorque | Output::GaugeTorque => torque,
                Output::Rack | Output::Sum => 0.0,
            })
            .map(|delay| {
                let whole = (delay / h).floor();
                (whole as usize, delay * (1.0 / h) - whole)
            })
            .collect();
        let length = channels.iter().map(|channel| channel.0).max().unwrap_or_default() + 2;
        // Before the record all outputs are constant.
        let mut ring = Vec::with_capacity(length * outputs.len());
        for &output in outputs {
            ring.extend(std::iter::repeat_n(ship.output(output), length));
        }
        Some(Self { channels, ring, length, at: 0 })
    }

    /// Store the outputs at the next step's beginning.
    #[inline(always)]
    pub fn push<const D: bool>(&mut self, ship: &Ship<'_, D>, outputs: &[Output]) {
        self.at += 1;
        let place = self.at % self.length;
        for (channel, &output) in outputs.iter().enumerate() {
            self.ring[channel * self.length + place] = ship.output(output);
        }
    }

    /// An output with the delay of its sensor.
    #[inline(always)]
    pub fn read(&self, channel: usize) -> f64 {
        let (whole, part) = self.channels[channel];
        let of =
            |steps: usize| self.ring[channel * self.length + (self.at + self.length - steps) % self.length];
        let (later, earlier) = (of(whole), of(whole + 1));
        later + (earlier - later) * part
    }
}
