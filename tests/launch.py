"""The virtual launch about its operating point, linear: truth, clean outputs and noisy records for statistical tests."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.signals import Excitation
from shipfp_rs.structures.state_space import LinearEquations
from shipfp_rs.vessel.linear_model import LinearModel, linearise
from shipfp_rs.vessel.vessel import Vessel


def echo(experiment: Experiment) -> Experiment:
    """Return what such a model makes of an experiment."""
    moved = 1.0 + experiment.normalised("n_set")
    signals = {name: experiment.operating_point[name] * moved for name in ("n_e", "M_g")}
    return replace(experiment, signals={"n_set": experiment.signals["n_set"], **signals})


Array = npt.NDArray[np.float64]

LAUNCH = linearise(Vessel.load("stan-launch-804"))
TRUTH = {"tau_n": LAUNCH.tau_n, "g": LAUNCH.g, "vK_p": LAUNCH.v * LAUNCH.K_p, "vK_i": LAUNCH.v * LAUNCH.K_i}
POINT = {"n_set": 1300.0, "n_e": 1300.0, "M_b": 222.93, "X_f": 13.07}
SIGNALS = {"dn": "n_e", "dM_b": "M_b", "dX": "X_f"}


def outputs_of(
    excitation: Excitation,
    outputs: tuple[str, ...] = ("dn", "dM_b"),
    model: LinearModel = LAUNCH,
    initial: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Return the exact normalised outputs from the initial dn and dE, shape (O, N)."""
    equations = LinearEquations(
        tuple("dM" if output == "dM_b" else output for output in outputs), gauge=False
    )
    bare = Experiment(
        excitation.name,
        excitation.rate_hz,
        {"n_set": POINT["n_set"] + excitation.samples},
        {"n_set": POINT["n_set"]},
        hold=excitation.hold,
    )
    return equations.simulate(
        dataclasses.asdict(model) | dict(zip(equations.states, initial, strict=True)), bare
    )


def noise(shape: tuple[int, int], correlation: float, seed: int | list[int]) -> Array:
    """Return stationary noise of unit variance, first-order autoregressive along the last axis."""
    shocks = np.random.default_rng(seed).standard_normal(shape)
    shocks[:, 1:] *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], shocks, axis=1))


def record(excitation: Excitation, rows: Array, outputs: tuple[str, ...] = ("dn", "dM_b")) -> Experiment:
    """Return an experiment that measured these normalised outputs, shape (O, N)."""
    measured = {
        SIGNALS[output]: POINT[SIGNALS[output]] * (1.0 + row)
        for output, row in zip(outputs, rows, strict=True)
    }
    return Experiment(
        excitation.name,
        excitation.rate_hz,
        {"n_set": POINT["n_set"] + excitation.samples, **measured},
        POINT,
        hold=excitation.hold,
        kind=excitation.kind,
    )


def noisy_record(
    excitation: Excitation,
    level: float,
    correlation: float,
    seed: int | list[int],
    model: LinearModel = LAUNCH,
) -> Experiment:
    """Return speed and torque with noise of a standard deviation relative to each output's root mean square."""
    clean = outputs_of(excitation, model=model)
    root_mean_square = np.sqrt(np.mean(clean**2, axis=1, keepdims=True))
    return record(excitation, clean + level * root_mean_square * noise(clean.shape, correlation, seed))
