"""Sample times of the signals in a stretch."""

from __future__ import annotations

from dataclasses import dataclass

from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.low_pass import LowPass, Source, on_a_simple_rate
from shipfp_rs.support.arrays import Array


@dataclass(frozen=True)
class Grid:
    """Sample times of the signals in a stretch."""

    label: str
    start_s: float
    rate_hz: float
    count: int

    @property
    def stop_s(self) -> float:
        """End of the stretch [s], one sample interval after the last."""
        return self.start_s + self.count / self.rate_hz

    def low_passed(self, channel: Channel, source: Source) -> Array:
        """Samples of `source`, on the channel's own index, low-passed and sampled on the grid."""
        channel, source = on_a_simple_rate(channel, source, self.rate_hz)
        start = (self.start_s - channel.start_s) * channel.rate_hz
        return LowPass(channel, self.rate_hz, start)(source, self.count)
