"""Fluctuations of the propeller's torque by uneven inflow, and the response of the drive train."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy import fft, signal

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.linear_model import LinearModel


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
