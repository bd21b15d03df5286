"""The speed after a load step: as the ship is simulated, and pass, fail or open against the classes of ISO 8528-5."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from shipfp_rs.assessment.closed_loop import CLASSES, STEP_PCT, governing
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.report import loop
from shipfp_rs.report.markup import Say
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

SHIP = Structure.ship(["dead_time_loop", "load"], torque="brake")
QUIET = {parameter.name: parameter.start for parameter in SHIP.parameters} | {"T_d": 0.03, "k_L": 0.8}


def fingerprint(*, possible=(), **values):
    """Return what the table needs of a fingerprint."""
    return SimpleNamespace(
        engine_described=True,
        structure={},
        optimum=QUIET | values,
        settings={"possible": possible},
        adequate={},
        parameters={},
        derived={},
        identifiability=SimpleNamespace(null_space=()),
        covariance={"names": [], "matrix": []},
        why_not="",
        data=(),
        ends_at_meter=False,
    )


def simulated(values):
    """Return times, and how far the speed falls after a load step of the table's size, by the ship's own equations [%]."""
    seconds = np.arange(0.0, 20.0, 0.002)
    # k_L turns a change over the load's operating point into one over the torque's.
    load = np.full(seconds.size, 1.0 + 1e-3 * STEP_PCT / 100.0 / values["k_L"])
    load[0] = 1.0
    record = Experiment(
        "step",
        500.0,
        {"n_set": np.full(seconds.size, 1000.0), "M_load": load},
        {"n_set": 1000.0, "M_load": 1.0},
        hold="zero",
    )
    return seconds, 1e5 * np.abs(SHIP.equations.simulate(values, record)[0])


def test_the_speed_falls_and_recovers_as_the_ship_is_simulated() -> None:
    slack = QUIET | {"vK_p": 0.8, "vK_i": 0.6, "p": 0.5, "g": 0.0}
    seconds, off = simulated(slack)
    for name, found in governing(fingerprint(**slack), SHIP).items():
        assert found.deviation.value == pytest.approx(off.max(), rel=0.01), name
        late = seconds[np.flatnonzero(off > CLASSES[name].band_pct)[-1]]
        assert found.recovery.value == pytest.approx(late, abs=0.03)
        grown = found.largest.value / STEP_PCT
        assert off[seconds >= CLASSES[name].recovery_s].max() * grown <= 1.01 * CLASSES[name].band_pct
        assert off.max() * grown <= 1.01 * CLASSES[name].deviation_pct


def test_a_class_is_passed_failed_or_left_open_by_the_interval() -> None:
    slow = {"vK_p": 0.3, "vK_i": 0.3, "p": 0.5, "g": 0.0}
    assert {one.state for one in governing(fingerprint(), SHIP).values()} == {"pass"}
    assert governing(fingerprint(**slow), SHIP)["G3"].state == "fail"
    assert governing(fingerprint(possible=[slow]), SHIP)["G3"].state == "open"
    unstable = governing(fingerprint(T_d=0.6, vK_p=30.0), SHIP)["G1"]
    assert (unstable.state, unstable.deviation.value) == ("open", None)


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_table_comes_with_a_load_or_a_generating_set_only(language) -> None:
    figures = {"bandwidth": object()}
    say, driven = Say(language), Experiment("a", 10.0, {"n_set": np.ones(9)}, {"n_set": 1.0})
    loaded = replace(
        driven,
        signals={**driven.signals, "M_load": np.ones(9)},
        operating_point={"n_set": 1.0, "M_load": 1.0},
    )
    tug = Vessel.load("stan-tug-1205")
    assert not [*loop.classes(fingerprint(), SHIP, figures, [driven], tug, say)]
    assert not [*loop.classes(fingerprint(), SHIP, figures, [driven], None, say)]
    text, table = loop.classes(fingerprint(), SHIP, figures, [loaded], None, say)
    assert "ISO 8528-5" in text
    for name in CLASSES:
        assert f">{name}<" in table
    assert ("pass" if language == "en" else "erfüllt") in table
