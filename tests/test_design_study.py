"""Do the predicted standard deviations of a design come true? Virtual launch.

The study (`pytest -m study -k design -s`) prints a table; DESIGN_DRAWS sets another number of draws than 200.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context

import numpy as np
import pytest

from shipfp_rs.designs import Noise, Subject, design
from shipfp_rs.experiment import Experiment
from shipfp_rs.identification import identify
from shipfp_rs.signals import Excitation
from shipfp_rs.structure import Structure

SHIP = "stan-launch-804"
AMPLITUDE_RPM = 39.0
STRUCTURE = Structure.linear(products=True)
SENSORS = {"n_e": Noise(0.001, 2.0), "M_b": Noise(0.004, 1.0)}
"""Below the sample rate's reach on purpose: the noise is coloured, and differently on each signal."""


@dataclass(frozen=True)
class Case:
    """A planned set point with what is predicted of it, relative to the true values."""

    excitation: Excitation
    predicted: Mapping[str, float]


def subject() -> Subject:
    return Subject.of(SHIP, STRUCTURE, None)


@cache
def planned(kind: str, duration_s: float, highest_hz: float = 2.0) -> Case:
    # Ten samples a period of the highest frequency are enough, and quick to fit.
    plan = design(
        SHIP,
        amplitude_rpm=AMPLITUDE_RPM,
        duration_s=duration_s,
        kind=kind,
        structure=STRUCTURE,
        sensors=SENSORS,
        highest_hz=highest_hz,
        longest_samples=round(20.0 * duration_s),
    )
    return Case(plan.excitation, plan.prediction.relative_pct)


def noisy(excitation: Excitation, seed: Sequence[int]) -> Experiment:
    """Return what the sensors would record of the expected ship."""
    expected, generator = subject(), np.random.default_rng(seed)
    clean = expected.respond(excitation)
    drawn = {
        signal: samples
        + clean.operating_point[signal] * SENSORS[signal].draw(len(samples), excitation.rate_hz, generator)
        for signal, samples in clean.signals.items()
        if signal in SENSORS
    }
    return replace(clean, signals={**clean.signals, **drawn})


def estimate(job: tuple[Excitation, Sequence[int]]) -> list[float]:
    """Estimates over the true values in percent, in the structure's order."""
    fingerprint = identify(noisy(*job), STRUCTURE)
    truth = subject().values
    found = [fingerprint[name].value for name in subject().free]
    return [
        np.nan if value is None else 100.0 * value / truth[name]
        for name, value in zip(subject().free, found, strict=True)
    ]


def observed(pool: ProcessPoolExecutor | None, excitation: Excitation, draws: int) -> np.ndarray:
    """Spread of the estimates over the true values [%], shape (P,)."""
    jobs = [(excitation, (7, draw)) for draw in range(draws)]
    results = []
    for result in map(estimate, jobs) if pool is None else pool.map(estimate, jobs, chunksize=2):
        results.append(result)
        if sys.stderr.isatty():
            print(f"\r{len(results)} of {draws}", end="", file=sys.stderr)
    return np.std(np.array(results), axis=0, ddof=1)


@pytest.mark.study
def test_design_predictions_come_true(monkeypatch):
    draws = int(os.environ.get("DESIGN_DRAWS", "200"))
    # One thread a process: the matrices are too small for more.
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    cases = {
        "sines, 300 s": planned("sines", 300.0),
        "multisine, 300 s": planned("multisine", 300.0),
        "mix, 300 s": planned("mix", 300.0),
    }
    spreads = {}
    names = subject().free
    print(f"\nStandard deviations [% of value], {draws} draws: predicted / observed")
    print("design".ljust(24) + "".join(f"{name:>18}" for name in names))
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for label, case in cases.items():
            spreads[label] = observed(pool, case.excitation, draws)
            cells = [
                f"{case.predicted[name]:.3f} / {spread:.3f}"
                for name, spread in zip(names, spreads[label], strict=True)
            ]
            print(label.ljust(24) + "".join(f"{cell:>18}" for cell in cells), flush=True)
    for label, case in cases.items():
        for name, spread in zip(names, spreads[label], strict=True):
            assert spread == pytest.approx(case.predicted[name], rel=0.15), (label, name)


def test_predicted_deviations_come_true():
    case = planned("mix", 120.0)
    spread = observed(None, case.excitation, 30)
    # The standard deviation of 30 draws scatters by 13 %; three times that is what this can tell.
    ratio = spread / [case.predicted[name] for name in subject().free]
    assert np.all(np.abs(ratio - 1.0) < 0.4)
    assert 0.8 < ratio.mean() < 1.2
