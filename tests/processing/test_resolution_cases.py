"""What the resolution of a tachometer leaves in the speed is told, as large as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.report.markup import Say
from shipfp_rs.report.pictures import of_the_tachometer
from tests.processing.test_speed_sources import trial


def recorded(pulses: int, rate_hz: float, folder: Path) -> tuple[Experiment, np.ndarray]:
    """Return the experiment of an even shaft with that many pulses a turn, and its true speed [rpm]."""
    time = np.arange(round(120.0 * rate_hz)) / rate_hz
    turned = 1000.0 / 60.0 * time + 20.0 / 60.0 / (2 * np.pi * 0.1) * (1.0 - np.cos(2 * np.pi * 0.1 * time))
    rpm = 1000.0 + 20.0 * np.sin(2 * np.pi * 0.1 * time)
    train = np.where((turned * pulses) % 1.0 < 0.5, 5.0, 0.0).astype(np.float32)
    log = Log.from_arrays(
        {"U_set": rpm, "pulses": train}, rate_hz=rate_hz, units={"U_set": "rpm"}, name="log"
    )
    table = f'column = "pulses"\npulses_per_rev = {pulses}\nshaft = "engine"'
    described = trial(folder, table, n_e_rpm=1000.0, rate_hz=50.0, window=(5.0, 115.0), speed="best")
    (experiment,) = process(log, described)
    at = 5.0 + np.arange(len(experiment)) / experiment.rate_hz
    return experiment, 1000.0 + 20.0 * np.sin(2 * np.pi * 0.1 * at)


@pytest.mark.parametrize(("pulses", "rate_hz"), [(1, 1000.0), (4, 1000.0), (8, 2000.0)])
def test_cases_what_a_tachometer_s_resolution_leaves_is_told(
    pulses: int, rate_hz: float, tmp_path: Path
) -> None:
    experiment, true = recorded(pulses, rate_hz, tmp_path)
    left = np.nanstd(experiment.signals["n_e"] - true)
    assert experiment.provenance["speed"]["resolution_rpm"] == pytest.approx(left, rel=0.35)


def test_cases_the_report_says_how_much_of_the_residual_is_the_tachometer_s(tmp_path: Path) -> None:
    experiment, true = recorded(1, 1000.0, tmp_path)
    say = Say("en")
    told = of_the_tachometer(experiment, {"n_e": true}, say)
    assert told.startswith("n_e minus the model: standard deviation ")
    assert "The tachometer resolves about" in told
    assert "(pulses a turn: 1)" in told
    noise = 100.0 * np.random.default_rng(0).standard_normal(len(true))
    assert of_the_tachometer(experiment, {"n_e": true + noise}, say) == ""
    assert of_the_tachometer(replace(experiment, provenance={}), {"n_e": true}, say) == ""
