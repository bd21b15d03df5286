"""Do 95 % intervals hold the truth in 95 of 100 cases? White and coloured noise on the virtual launch.

The study (`pytest -m study -k coverage -s`) prints a table; COVERAGE_DRAWS sets another number of draws than 300,
COVERAGE_CELL=0.20,0.9 picks one noise level and correlation.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from scipy.stats import binom

from shipfp_rs import signals
from shipfp_rs.identification.identify import identify
from shipfp_rs.signals import Excitation
from shipfp_rs.structures.structure import Structure
from tests.launch import TRUTH, noisy_record

LEVELS = (0.01, 0.05, 0.20)
CORRELATIONS = (0.0, 0.9, 0.99)
LONG = signals.chirp(0.005, 10.0, 150.0, 13.0, rate_hz=100.0)


def held(level: float, correlation: float, draw: int, excitation: Excitation) -> list[bool]:
    """Whether the interval of each parameter holds its truth in one draw, seeded by its place in the study."""
    seed = [round(100 * level), round(100 * correlation), draw]
    fingerprint = identify(
        noisy_record(excitation, level, correlation, seed), Structure.linear(products=True)
    )
    intervals = (fingerprint[name].ci95 for name in TRUTH)
    return [
        interval is not None and interval[0] <= truth <= interval[1]
        for interval, truth in zip(intervals, TRUTH.values(), strict=True)
    ]


def _draw(job: tuple[float, float, int]) -> list[bool]:
    return held(*job, LONG)


@pytest.mark.study
def test_coverage_of_the_intervals_in_every_noise(monkeypatch):
    draws = int(os.environ.get("COVERAGE_DRAWS", "300"))
    cells = [(level, correlation) for level in LEVELS for correlation in CORRELATIONS]
    if picked := os.environ.get("COVERAGE_CELL"):
        cells = [tuple(float(figure) for figure in picked.split(","))]
    jobs = [(*cell, draw) for cell in cells for draw in range(draws)]
    # One thread a process: the matrices are too small for more.
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    results = []
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for result in pool.map(_draw, jobs, chunksize=5):
            results.append(result)
            if sys.stderr.isatty():
                print(f"\r{len(results)} of {len(jobs)} fits", end="", file=sys.stderr)
    coverage = np.array(results).reshape(len(cells), draws, len(TRUTH)).mean(axis=1)
    print(
        f"\nCoverage of nominal 95 % intervals [%], {draws} draws of {len(LONG.samples)} samples, two outputs"
    )
    print("noise  correlation  " + "".join(f"{name:>8}" for name in TRUTH))
    for (level, correlation), row in zip(cells, coverage, strict=True):
        print(f"{level:5.0%}  {correlation:11.2f}  " + "".join(f"{100 * share:8.1f}" for share in row))
    # Every cell within what chance does to that many draws, and together much closer.
    low, high = binom.interval(1.0 - 0.01 / coverage.size, draws, 0.95)
    assert coverage.min() >= low / draws
    assert coverage.max() <= high / draws
    assert 0.935 <= coverage.mean() <= 0.965


@pytest.mark.parametrize("correlation", [0.9, 0.99])
def test_intervals_hold_the_truth_though_the_noise_is_coloured(correlation):
    inside = np.array([held(0.05, correlation, draw, LONG) for draw in range(8)])
    # Intervals that take this noise for white hold 14 to 64 % of g and vK_i.
    assert inside.mean() >= 0.85
