"""Tables of SWEEP.toml for the trial and the measurement chain of a draw."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from shipfp_rs.signals.standard import Kind
from shipfp_rs.simulation.raw_log import FAULTS_PER_MINUTE, RANGES
from shipfp_rs.support.toml import Section

Positive = Annotated[float, Field(gt=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Often = Annotated[float, Field(ge=FAULTS_PER_MINUTE[0], le=FAULTS_PER_MINUTE[1])]


class Excitation(Section):
    """Excitation of the set point, see `signals.standard`."""

    kind: Kind = "chirp"
    """Kind of signal."""
    duration_s: Positive = 120.0
    """Duration [s]."""
    amplitude_rpm: Positive = 40.0
    """Largest deviation from the operating point [rpm]."""
    start_hz: Positive | None = None
    """Lowest frequency [Hz]; default: depends on the duration."""
    stop_hz: Positive | None = None
    """Highest frequency [Hz]; default: depends on the sample rate."""
    rate_hz: Positive = 50.0
    """Sample rate of the experiment; a raw log is sampled at sensors.rate_hz."""


class Noise(Section):
    """Standard deviation of each signal's noise relative to its operating point, for the chain "experiment"."""

    n_e: Share = 0.0
    """Of the engine speed."""
    n_s: Share = 0.0
    """Of the shaft speed."""
    M_b: Share = 0.0
    """Of the brake torque."""
    M_s: Share = 0.0
    """Of the shaft torque."""
    M_g: Share = 0.0
    """Of the gauge torque."""
    X_f: Share = 0.0
    """Of the fuel rack."""
    level: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.0
    """Factor by which the noise of all signals is multiplied."""
    correlation: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.0
    """Correlation between successive samples (first-order autoregression)."""


class OperatingPoint(Section):
    """Operating point; default: that of the ship."""

    n_e_rpm: Positive | None = None
    """Engine speed [rpm]."""


def _can_be(name: str) -> Any:
    low, high = RANGES[name]
    return Field(default=None, ge=low, le=high)


class Sensors(Section):
    """Measurement chain of a raw log; for defaults see `simulation.raw_log.Sensors`."""

    rate_hz: float | None = _can_be("rate_hz")
    """Sample rate of the logger [Hz]."""
    set_point_noise_V: float | None = _can_be("set_point_noise_V")
    """Standard deviation of the set point's voltage [V]."""
    torque_noise_V: float | None = _can_be("torque_noise_V")
    """Standard deviation of the torque's voltage [V]."""
    pulse_noise_V: float | None = _can_be("pulse_noise_V")
    """Standard deviation of the pulses' voltage [V]."""
    telemetry_hz: float | None = _can_be("telemetry_hz")
    """Bandwidth of the torque's noise [Hz]."""
    receiver_limit_V: float | None = _can_be("receiver_limit_V")
    """Voltage at which the torque receiver saturates [V]."""
    edge_s: float | None = _can_be("edge_s")
    """Rise and fall time of the pulses [s]."""
    steady_s: Positive = 60.0
    """Steady stretch before the excitation [s]."""


class Faults(Section):
    """Numbers of faults per minute in a raw log (Table 6.10)."""

    A: Often = 0.0
    """Pulses counted twice, on every pulse train."""
    B: Often = 0.0
    """Missed pulses, on every pulse train."""
    C: Often = 0.0
    """Dropouts of the torque's telemetry, during which the receiver saturates."""
    D1: Often = 0.0
    """Relay jumps of the set point."""
