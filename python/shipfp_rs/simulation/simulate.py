"""Simulated experiments: a vessel's nonlinear plant under an excitation, optionally with noise or inflow fluctuations."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from scipy import fft, signal
from scipy.interpolate import make_interp_spline

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import UNITS, Experiment, Hold
from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.conditioning import LowPass
from shipfp_rs.signals import Excitation
from shipfp_rs.support.arguments import Whole, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.drive_train import DriveTrain, drive_train
from shipfp_rs.vessel.linear_model import LinearModel, linearise
from shipfp_rs.vessel.steady_state import OperatingPoint, ship_about, steady_state, whole_about
from shipfp_rs.vessel.vessel import Vessel


@dataclass(frozen=True)
class Inflow:
    """Random disturbance of the propeller's torque at a given speed, with exponential autocorrelation.

    Parameters
    ----------
    share
        Standard deviation of the disturbance, relative to the operating point's torque. For a ship like the tug, a
        share of 0.01 causes a scatter of 0.5 to 1 % in the amplitudes of sine fits over 100 to 300 s, as in appendix E.
    memory_s
        Time in which the autocorrelation falls to 1/e [s].
    """

    share: float = 0.01
    memory_s: float = 1.0

    def samples(self, count: int, rate_hz: float, seed: int) -> Array:
        """Return the disturbance relative to the operating point's torque, shape (count,)."""
        correlation = math.exp(-1.0 / (self.memory_s * rate_hz))
        draws = np.random.default_rng([0x1F, seed]).standard_normal(count)
        draws[1:] *= math.sqrt(1.0 - correlation**2)
        return np.asarray(self.share * signal.lfilter([1.0], [1.0, -correlation], draws))


def disturbed(experiment: Experiment, model: LinearModel, inflow: Inflow, seed: int) -> Experiment:
    """Add the linear drive train's response to disturbed inflow to n_e, n_s and M_g of a simulated experiment.

    With the propeller's torque M_p* = p n* + w, n* = -w / (tau_n s + p - g + L) and M_g* = w + (p + tau_prop s) n*, where L
    is the loop with its dead time. The linear model suffices, since the responses are small.
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
"""Least rate of a simulated set point [Hz]; a slower one is interpolated, which preserves its shape between samples."""
LEAD_S = 10.0
"""Time at the operating point before the record, in which filters settle and levels are measured [s]."""


@checked
def replay(vessel: Vessel, record: Experiment, at_the_shaft: bool = False) -> Experiment:
    """Return a vessel's response to a record's set point, without inflow fluctuations, sampled and masked like the record.

    A set point that is linear between samples (hold "first"), as from processed logs, is assumed to be low-passed; the
    response is then low-passed in the same way.

    Parameters
    ----------
    vessel
        The ship.
    record
        Record whose set point is applied: its deviation from the record's operating point is added to the vessel's.
    at_the_shaft
        Whether the speed is measured on the propeller's side of the torsionally flexible shaft.
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
    # The record's set point is returned instead of the simulated one, whose low-passed ends differ.
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


Method = Literal["rk4", "heun", "euler"]
Noise = Mapping[str, float | tuple[float, float]]

LOGGER = logging.getLogger("shipfp_rs")

LARGEST_SHARE = 0.9
"""Largest relative deviation of the set point; a larger one would stall an engine."""
_LARGEST_STEP = 0.025
_MOST_SUBSTEPS = 20_000
"""Largest RK4 step times the fastest pole: the error, a few times 0.025^4 / 120, is below 1e-8 of the deviation."""


@runtime_checkable
class FittedModel(Protocol):
    """A model that simulates itself about the operating point of its data, such as a fingerprint."""

    def simulate(self, drive: Excitation) -> Experiment:
        """Simulate noise-free signals."""


@checked
def simulate(
    vessel: Vessel | FittedModel,
    excitation: Excitation,
    *,
    n_e_rpm: float | None = None,
    method: Literal["rk4", "heun", "euler"] = "rk4",
    limits: bool = True,
    substeps: int | None = None,
    noise: Noise | None = None,
    seed: Whole | None = None,
) -> Experiment:
    """Simulate a trial, from the steady state at the operating point.

    A vessel with elements in addition to the plant of eq. 3.1-3.11 (dead times, limits, sampling, firing, a flexible
    shaft, a moving ship) is simulated with all of them; in bollard pull unless it has a `ship`.

    Parameters
    ----------
    vessel
        The ship, or a fingerprint, whose model is simulated about the operating point of its data. With a fingerprint,
        only `noise` and `seed` of the other arguments are accepted.
    excitation
        Deviations of the set point.
    n_e_rpm
        Operating point [rpm]; None: the ship's.
    method
        "rk4", "heun" or "euler"; "euler" shows the bias of a coarse simulation. A vessel with additional elements
        requires "rk4", and is simulated by the ship model that is also used for identification.
    limits
        Whether the engine's torque limit is active.
    substeps
        Integration steps per sample. None: 1 for "heun" and "euler"; for "rk4" chosen by accuracy. The error is then
        below 1e-8 of the deviation for the thesis's plant (larger where the torque limit acts), and for any other
        vessel about 1e-5 of the operating point's values, or 1e-4 where cylinders fire or signals jump.
    noise
        For each output, the standard deviation of its noise relative to that of the clean signal, or a pair of this and
        the correlation of successive samples (first-order autoregression).
    seed
        Seed of the noise; None: a random seed, which is stored in the provenance.

    Returns
    -------
    Experiment
        n_set, n_e [rpm], n_s [rev/s], M_b, M_s, M_g [Nm], X_f [mm], E_n [rev, zero at the operating point].
        M_g is the torque at a gauge between the two inertias, M_p + J_2/I_p (M_s - M_p).

    Raises
    ------
    InputError
        If the operating point can't be reached, or an argument is out of range.
    SimulationError
        If the integration diverges.

    Examples
    --------
    >>> from shipfp_rs import signals
    >>> experiment = simulate(Vessel.load("stan-launch-804"), signals.steps([65.0], 60.0))
    >>> round(experiment.signals["n_e"][-1])
    1365
    """
    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    if not isinstance(vessel, Vessel):
        if n_e_rpm is not None or method != "rk4" or not limits or substeps is not None:
            raise InputError(
                "simulate: found n_e_rpm, method, limits or substeps beside a fingerprint, expected them only for a vessel"
            )
        answer = vessel.simulate(excitation)
        return dataclasses.replace(
            answer,
            signals=_with_noise(answer.signals, noise, seed),
            provenance={**answer.provenance, "noise": dict(noise or {}), "seed": seed if noise else None},
        )
    if substeps is not None and substeps < 1:
        raise InputError(f"substeps is {substeps}, expected 1 or more")
    point = steady_state(vessel, n_e_rpm)
    if excitation.amplitude_rpm >= LARGEST_SHARE * point.n_e_rpm:
        raise InputError(
            f"excitation {excitation.name!r}: deviates by up to {excitation.amplitude_rpm:g} rpm from a set point of "
            f"{point.n_e_rpm:g} rpm, expected much less; give deviations, not the set point itself"
        )
    train = drive_train(vessel)
    if train.extends_the_plant and method != "rk4":
        raise InputError(
            f"method is {method!r}, expected 'rk4' for vessel {vessel.name!r}, which has elements in "
            "addition to the plant of eq. 3.1-3.11"
        )
    steps = substeps or (_substeps(vessel, train, point, excitation.rate_hz) if method == "rk4" else 1)
    envelope = vessel.envelope() if limits else (np.empty(0), np.empty(0))
    set_point = point.n_e + excitation.samples / 60.0
    LOGGER.info(
        "simulate: %s, %s, %d samples of %d steps", vessel.name, excitation.name, len(excitation), steps
    )
    run = _Run(set_point, 1.0 / excitation.rate_hz, steps, excitation.hold)
    clean = (
        _whole(vessel, train, point, envelope, run)
        if train.extends_the_plant
        else _plant(vessel, point, envelope, run, method)
    )
    return Experiment(
        name=excitation.name,
        rate_hz=excitation.rate_hz,
        signals=_with_noise(clean, noise, seed),
        operating_point=point.levels,
        hold=excitation.hold,
        kind=excitation.kind,
        provenance={
            "source": "simulation",
            "vessel": vessel.name,
            "method": method,
            "step_s": 1.0 / (excitation.rate_hz * steps),
            "limits": limits,
            "noise": dict(noise or {}),
            "seed": seed if noise else None,
            "segments": [dataclasses.asdict(segment) for segment in excitation.segments],
        },
    )


class _Run(NamedTuple):
    """Set point of the engine speed [rev/s], sample interval [s], steps per sample, and interpolation of the set point."""

    set_point: Array
    dt: float
    steps: int
    hold: Hold


_Limit = tuple[Array, Array]
"""Torque limit: engine speeds [rev/s], and the highest torque at each [Nm]; both are empty without a limit."""


def _plant(
    vessel: Vessel, point: OperatingPoint, envelope: _Limit, run: _Run, method: Method
) -> dict[str, Array]:
    """Signals of the plant of eq. 3.1-3.11."""
    rows = _core.simulate_ship_by(
        ship_about(vessel, point),
        run.set_point / point.n_e,
        run.dt,
        run.steps,
        method,
        run.hold,
        np.array([1.0, 0.0]),
        [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b", "dM_g", "dX", "dE")],
        np.array([envelope[0] / point.n_e, envelope[1] / point.M_b]),
    )
    N, M_b, M_g, X = 1.0 + rows[:4]
    return {
        "n_set": 60.0 * run.set_point,
        "n_e": 60.0 * point.n_e * N,
        "n_s": point.n_s * N,
        "M_b": point.M_b * M_b,
        "M_s": point.M_s * M_b,
        "M_g": point.M_s * M_g,
        "X_f": point.X_f * X,
        "E_n": point.n_e * rows[4],
    }


def _whole(
    vessel: Vessel, train: DriveTrain, point: OperatingPoint, envelope: _Limit, run: _Run
) -> dict[str, Array]:
    """Signals of a drive train with all its elements."""
    rows = _core.simulate_detailed_ship(
        *whole_about(vessel, point),
        train.strength,
        train.quadrants,
        run.set_point / point.n_e,
        run.dt,
        run.steps,
        run.hold,
        [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dn_prop", "dM_b", "dM_g", "dX", "dE")],
        np.array([envelope[0] / point.n_e, envelope[1] / point.M_b]),
    )
    N, N_prop, M_b, M_g, X = 1.0 + rows[:5]
    ratio = vessel.gearbox.ratio * vessel.gearbox.efficiency
    drag = vessel.drag_torque(point.n_s) * N**vessel.gearbox.drag_exponent
    return {
        "n_set": 60.0 * run.set_point,
        "n_e": 60.0 * point.n_e * N,
        "n_s": point.n_s * N_prop,
        "M_b": point.M_b * M_b,
        "M_s": ratio * point.M_b * M_b - drag,
        "M_g": ratio * point.M_b * M_g,
        "X_f": point.X_f * X,
        "E_n": point.n_e * rows[5],
    }


def _substeps(vessel: Vessel, train: DriveTrain, point: OperatingPoint, rate_hz: float) -> int:
    model = dataclasses.replace(linearise(vessel, point.n_e_rpm), T_d=0.0, T_set=0.0)
    fastest = float(np.abs(model.poles).max())
    steps = max(1, math.ceil(fastest / (rate_hz * _LARGEST_STEP)))
    if train.extends_the_plant:
        steps = max(steps, math.ceil(1.0 / (rate_hz * train.step_s(point.n_s))))
    if steps > _MOST_SUBSTEPS:
        raise InputError(
            f"vessel {vessel.name!r}: its fastest pole has a time constant of {1.0 / fastest:.2g} s, which takes "
            f"{steps:.3g} steps per sample, expected at most {_MOST_SUBSTEPS:g}; check inertia and gains, or give substeps"
        )
    return steps


def _with_noise(clean: Mapping[str, Array], noise: Noise | None, seed: int) -> dict[str, Array]:
    return {
        **clean,
        **{output: _noisy(clean, output, level, seed) for output, level in (noise or {}).items()},
    }


def _noisy(clean: Mapping[str, Array], output: str, level: float | tuple[float, float], seed: int) -> Array:
    if output not in clean or output == "n_set":
        known = ", ".join(name for name in clean if name != "n_set")
        raise InputError(f"noise: found {output!r}, expected outputs among {known}")
    relative, correlation = level if isinstance(level, tuple) else (level, 0.0)
    if not (math.isfinite(relative) and relative >= 0.0):
        raise InputError(f"noise[{output!r}] is {relative}, expected zero or more")
    if relative > 1.0:
        raise InputError(
            f"noise[{output!r}] is {relative:g} times the signal, expected at most 1; percent for a fraction? that is "
            f"{relative / 100.0:g}"
        )
    if not abs(correlation) < 1.0:
        raise InputError(f"noise[{output!r}] has correlation {correlation}, expected between -1 and 1")
    # Each signal has its own random stream: its noise does not depend on the noise of other signals.
    generator = np.random.default_rng([list(UNITS).index(output), seed])
    draws = generator.standard_normal(len(clean[output]))
    # The first sample has the stationary distribution, so there is no transient.
    draws[1:] *= math.sqrt(1.0 - correlation**2)
    coloured = signal.lfilter([1.0], [1.0, -correlation], draws)
    return np.asarray(clean[output] + relative * np.std(clean[output]) * coloured)
