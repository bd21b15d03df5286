"""Load steps of a record are those that were made, with dip and recovery of a first-order answer known by hand."""

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.validation import measured_steps

RATE_HZ = 50.0


def record(*, moving: bool = False, band: float = 1.0) -> fp.Experiment:
    """A speed that dips by 5 % at once and comes back with a time constant of 1 s, at 10 and 30 s."""
    time = np.arange(0.0, 50.0, 1.0 / RATE_HZ)
    speed, load = np.ones_like(time), np.ones_like(time)
    for at, size in ((10.0, 0.4), (30.0, -0.4)):
        since = time - at
        load += np.where(since >= 0.0, size, 0.0)
        speed -= np.where(since >= 0.0, 0.125 * size * np.exp(-np.maximum(since, 0.0)), 0.0) * band
    load += 0.005 * np.random.default_rng(3).standard_normal(len(time))
    asked = 1.0 + (0.02 * np.sin(time) if moving else 0.0)
    signals = {"n_set": 1500.0 * asked * np.ones_like(time), "n_e": 1500.0 * speed, "M_load": 900.0 * load}
    return fp.Experiment("S1", RATE_HZ, signals, {"n_set": 1500.0, "n_e": 1500.0, "M_load": 900.0})


def test_dip_and_recovery_are_those_of_the_answer() -> None:
    up, down = measured_steps(record())
    assert (up.at_s, down.at_s) == pytest.approx((10.0, 30.0), abs=0.05)
    assert (up.step, down.step) == pytest.approx((360.0, -360.0), abs=4.5)  # 40 % of 900 Nm
    for one in (up, down):
        assert one.deviation_pct == pytest.approx(5.0, abs=0.1)
        assert one.recovery_s == pytest.approx(np.log(5.0 / 2.0), abs=0.06)  # 5 % exp(-t) = 2 %


def test_a_speed_that_stays_in_the_band_recovers_at_once() -> None:
    assert [one.recovery_s for one in measured_steps(record(band=0.2))] == [0.0, 0.0]


def test_while_the_set_point_moves_no_step_is_told() -> None:
    assert measured_steps(record(moving=True)) == []


def test_a_load_that_swings_makes_no_step_and_gaps_are_bridged() -> None:
    one = record()
    time = np.arange(len(one)) / RATE_HZ
    swinging = {**one.signals, "M_load": 900.0 + 200.0 * np.sin(2.0 * time)}
    assert measured_steps(fp.Experiment("S1", RATE_HZ, swinging, one.operating_point)) == []
    torn = {name: row.copy() for name, row in one.signals.items()}
    torn["n_e"][700:720] = np.nan
    assert len(measured_steps(fp.Experiment("S1", RATE_HZ, torn, one.operating_point))) == 2


def test_without_a_load_there_are_none() -> None:
    one = record()
    bare = {name: row for name, row in one.signals.items() if name != "M_load"}
    assert measured_steps(fp.Experiment("S1", RATE_HZ, bare, one.operating_point)) == []
