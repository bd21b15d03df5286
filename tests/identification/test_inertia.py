"""Inertia in kg m2 from the operating point alone, where torque and speed are those of one shaft."""

from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from tests.identification.parity import Case, simulated


def experiment(gauge: bool, scale: float = 1.0, speed: str = "n_e") -> fp.Experiment:
    _, one = simulated(Case(gauge=gauge, seconds=60.0))
    random = np.random.default_rng(2)
    signals = {
        name: scale * (row + 0.5 * random.standard_normal(len(row))) for name, row in one.signals.items()
    }
    point = {name: scale * value for name, value in one.operating_point.items()}
    signals[speed], point[speed] = signals.pop("n_e"), point.pop("n_e")
    return replace(one, signals=signals, operating_point=point)


def test_cases_inertia_in_si_without_a_vessel(tmp_path) -> None:
    found = fp.identify(experiment(gauge=False), intervals="symmetric")
    row, tau = found.si["inertia"], found["tau_n"]
    factor = 1000.0 / (2.0 * np.pi * 1000.0 / 60.0)
    assert row["value"] == pytest.approx(factor * tau.value)
    assert row["ci95"] == pytest.approx([factor * end for end in tau.ci95])
    assert (row["unit"], row["seen_from"]) == ("kg m2", "engine")
    assert row["ci95"][0] < factor * 1.2 < row["ci95"][1]
    assert fp.Fingerprint.load(found.save(tmp_path / "fingerprint.json")).si == found.si


def test_cases_inertia_of_a_gauge_is_told_beside_the_shaft_s_own_speed() -> None:
    found = fp.identify(experiment(gauge=True, speed="n_s"), torque="gauge", intervals="symmetric")
    assert {name: row["seen_from"] for name, row in found.si.items()} == dict.fromkeys(
        ("inertia", "propeller_inertia"), "propeller shaft"
    )


def test_cases_no_inertia_where_a_gear_ratio_or_units_are_missing() -> None:
    assert fp.identify(experiment(gauge=True), torque="gauge", intervals="symmetric").si == {}
    assert fp.identify(experiment(gauge=False, scale=1e-3), intervals="symmetric").si == {}
