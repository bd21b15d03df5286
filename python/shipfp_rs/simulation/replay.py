"""Response of a simulated vessel to a record's set point, at the record's samples."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import fft, signal
from scipy.interpolate import make_interp_spline

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.conditioning import LowPass
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.linear_model import LinearModel
from shipfp_rs.vessel.vessel import Vessel


@dataclass(frozen=True)
class Inflow:
    """A disturbance of the propeller's torque at a given speed, exponentially correlated.

    Parameters
    ----------
    share
        Standard deviation of the disturbance over the operating point's torque. With a response as large as the tug's, one
        per cent scatters the amplitudes of sine fits over 100 to 300 s by 0.5 to 1 %, as in appendix E.
    memory_s
        Time in which the correlation falls to 1/e [s].
    """

    share: float = 0.01
    memory_s: float = 1.0

    def samples(self, count: int, rate_hz: float, seed: int) -> Array:
        """Return the disturbance over the operating point's torque, shape (count,)."""
        correlation = math.exp(-1.0 / (self.memory_s * rate_hz))
        draws = np.random.default_rng([0x1F, seed]).standard_normal(count)
        draws[1:] *= math.sqrt(1.0 - correlation**2)
        return np.asarray(self.share * signal.lfilter([1.0], [1.0, -correlation], draws))


def disturbed(experiment: Experiment, model: LinearModel, inflow: Inflow, seed: int) -> Experiment:
    """Return a simulated experiment in disturbed water, with the linear drive train's response added to n_e, n_s, M_g.

    With the propeller's torque M_p* = p n* + w, n* = -w / (tau_n s + p - g + L) and M_g* = w + (p + tau_prop s) n*, where L
    is the loop with its dead time. The responses are small, so that the drive train is linear.
    """
    count, rate = len(experiment), experiment.rate_hz
    size = fft.next_fast_len(count, real=True)
    s = 2j * np.pi * np.maximum(fft.rfftfreq(size, 1.0 / rate), 1e-9)
    q = model
    loop = q.v * (q.K_p + q.K_i / s) * np.exp(-s * q.T_d)
    water = fft.rfft(inflow.samples(size, rate, seed))
    speed = -water / (q.tau_n * s + q.p - q.g + loop)
    torque = water + (q.p + q.tau_prop * s) * speed
    n, M = (fft.irfft(row, size)[:count] for row in (speed, torque))
    point = experiment.operating_point
    added = {"n_e": n * point["n_e"], "n_s": n * point["n_s"], "M_g": M * point["M_g"]}
    signals = {name: samples + added.get(name, 0.0) for name, samples in experiment.signals.items()}
    return dataclasses.replace(experiment, signals=signals)


LEAST_RATE_HZ = 100.0
"""Rate below which a set point is interpolated, so that its shape is kept [Hz]."""
LEAD_S = 10.0
"""Time at the operating point before the record, in which filters settle and levels are measured [s]."""


@checked
def replay(vessel: Vessel, record: Experiment, at_the_shaft: bool = False) -> Experiment:
    """Return the response of a vessel to a record's set point in still water, sampled and masked like the record.

    A set point with linear course between samples (hold "first", as of processed logs) is assumed to be low-passed; the
    response is then low-passed, too.

    Parameters
    ----------
    vessel
        The ship.
    record
        Record whose set point, as deviation from its operating point, is applied about the vessel's.
    at_the_shaft
        Whether the speed is measured on the shaft behind the twist.
    """
    up = max(1, math.ceil(LEAST_RATE_HZ / record.rate_hz))
    rate = up * record.rate_hz
    lead = up * round(LEAD_S * record.rate_hz)
    moving = _between(record, up)
    samples = np.concatenate([np.zeros(lead), moving, np.full(lead, moving[-1])])
    answer = simulate(vessel, Excitation(record.name, record.kind, rate, samples, hold=record.hold))
    gear = 60.0 * vessel.gearbox.ratio
    signals = {**answer.signals, **({"n_e": answer.signals["n_s"] * gear} if at_the_shaft else {})}
    signals = {name: signals[name] for name in record.signals if name in signals}
    point = {name: float(row[lead // 2 : lead].mean()) for name, row in signals.items() if name != "E_n"}
    if up == 1 or record.hold == "zero":
        rows = {name: row[lead : lead + up * len(record) : up] for name, row in signals.items()}
    else:
        channel = Channel(record.name, "", rate, len(samples))
        low_pass = LowPass(channel, record.rate_hz, float(lead))
        rows = {name: low_pass(partial(_stretch, row), len(record)) for name, row in signals.items()}
    rows = {name: np.where(np.isnan(record.signals[name]), np.nan, row) for name, row in rows.items()}
    # The filtered set point is unknown beyond the record's ends.
    rows["n_set"] = record.signals["n_set"] - record.operating_point["n_set"] + point["n_set"]
    return replace(
        record,
        signals=rows,
        operating_point={**answer.operating_point, **point},
        provenance={"source": "simulation"},
    )


def _between(record: Experiment, up: int) -> Array:
    """Deviation of the set point [rpm] at `up` times the record's rate, shape (up N,); gaps are interpolated."""
    deviation = record.signals["n_set"] - record.operating_point["n_set"]
    at = np.arange(len(deviation))
    known = np.isfinite(deviation)
    if not known.any():
        raise InputError(f"experiment {record.name!r}: every sample of n_set is masked")
    deviation = np.interp(at, at[known], deviation[known])
    if up == 1:
        return deviation
    if record.hold == "zero":
        return np.repeat(deviation, up)
    fine = np.minimum(np.arange(up * len(at)) / up, at[-1])
    return np.asarray(make_interp_spline(at, deviation, k=5)(fine))


def _stretch(samples: Array, start: int, stop: int) -> Array:
    return samples[start:stop].copy()
