"""Tables of SWEEP.toml that say what a draw's trial is and what it is measured with."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from shipfp_rs.signals import Kind
from shipfp_rs.simulation.sensors import FAULTS_PER_MINUTE, RANGES
from shipfp_rs.support.toml import Section

Positive = Annotated[float, Field(gt=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Often = Annotated[float, Field(ge=FAULTS_PER_MINUTE[0], le=FAULTS_PER_MINUTE[1])]


class Excitation(Section):
    """What is put on the set point, see `signals.standard`."""

    kind: Kind = "chirp"
    duration_s: Positive = 120.0
    amplitude_rpm: Positive = 40.0
    start_hz: Positive | None = None
    stop_hz: Positive | None = None
    rate_hz: Positive = 50.0
    """Sample rate of the experiment; a raw log is sampled at sensors.rate_hz."""


class Noise(Section):
    """Standard deviation of each signal's noise over its operating point, for the chain "experiment"."""

    n_e: Share = 0.0
    n_s: Share = 0.0
    M_b: Share = 0.0
    M_s: Share = 0.0
    M_g: Share = 0.0
    X_f: Share = 0.0
    level: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.0
    """Multiplies all of them."""
    correlation: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.0
    """Of successive samples (first-order autoregression)."""


class OperatingPoint(Section):
    """Where the ship runs; the ship's own point where nothing is given."""

    n_e_rpm: Positive | None = None


def _can_be(name: str) -> Any:
    low, high = RANGES[name]
    return Field(default=None, ge=low, le=high)


class Sensors(Section):
    """The measurement chain of a raw log, see `simulation.sensors.Sensors`, which has the usual values."""

    rate_hz: float | None = _can_be("rate_hz")
    set_point_noise_V: float | None = _can_be("set_point_noise_V")
    torque_noise_V: float | None = _can_be("torque_noise_V")
    pulse_noise_V: float | None = _can_be("pulse_noise_V")
    telemetry_hz: float | None = _can_be("telemetry_hz")
    receiver_limit_V: float | None = _can_be("receiver_limit_V")
    edge_s: float | None = _can_be("edge_s")
    steady_s: Positive = 60.0
    """Steady stretch before the excitation [s]."""


class Faults(Section):
    """Faults of a raw log, each so many a minute (Table 6.10); zero: none."""

    A: Often = 0.0
    B: Often = 0.0
    C: Often = 0.0
    D1: Often = 0.0
