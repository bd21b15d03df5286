"""Drives in open loop: the command's own answer tells inertia, damping and lag, and nobody speaks of a governor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.structure_estimates import TAKEN_FOR_TORQUE
from shipfp_rs.structures.ship import commanded
from shipfp_rs.structures.structure import Structure

TRUTH = {"tau_n": 0.8, "g": -0.6, "v": 1.3, "p": 1.6, "T_d": 0.05, "tau_act": 0.12}
SPEED_RPM, TORQUE_NM, VOLTS = 900.0, 12.0, 5.0
POINT = {"command": VOLTS, "n_e": SPEED_RPM, "M_b": TORQUE_NM}


def recorded(truth: dict[str, float]) -> fp.Experiment:
    """Return steps of the command, of a tenth."""
    random, rate_hz = np.random.default_rng(2), 25.0
    time = np.arange(0.0, 90.0, 1.0 / rate_hz)
    at = 3.0 + np.cumsum(random.uniform(3.0, 8.0, 14))
    levels = np.append(0.0, np.repeat(random.uniform(-0.1, 0.1, 14), 2)[:-1])
    command = np.interp(time, np.column_stack([at, at + 0.12]).ravel(), levels)
    bare = fp.Experiment("steps", rate_hz, {"command": VOLTS * (1.0 + command)}, {"command": VOLTS})
    rows = 1.0 + commanded(Structure).equations.simulate(truth, bare)
    speed, torque = rows + 2e-3 * random.standard_normal(rows.shape)
    signals = {**bare.signals, "n_e": SPEED_RPM * speed, "M_b": TORQUE_NM * torque}
    return replace(bare, signals=signals, operating_point=POINT)


def without_torque(experiment: fp.Experiment) -> fp.Experiment:
    return replace(experiment, signals={name: experiment.signals[name] for name in ("command", "n_e")})


@pytest.fixture(scope="module")
def found() -> fp.Fingerprint:
    return fp.identify(recorded(TRUTH), intervals="symmetric")


def test_a_torque_beside_the_command_tells_all(found: fp.Fingerprint) -> None:
    for name, value in TRUTH.items():
        low, high = found[name].ci95
        assert low <= value <= high, name
    assert found["tau_n"].value == pytest.approx(TRUTH["tau_n"], rel=0.03)


def test_nothing_speaks_of_a_governor(found: fp.Fingerprint) -> None:
    assert not {"vK_p", "vK_i", "K_p", "K_i", "T_set"} & (set(found.parameters) | set(found.derived))
    assert "governor" not in " ".join(found.verdict)


def test_it_simulates_and_predicts_and_comes_back_from_its_file(found: fp.Fingerprint, tmp_path) -> None:
    record = recorded(TRUTH)
    again = fp.Fingerprint.load(found.save(tmp_path / "fingerprint.json"))
    for model in (found.predict(record), again.predict(record), again.simulate(record)):
        assert model.signals["command"] == pytest.approx(record.signals["command"])
        assert model.signals["n_e"] == pytest.approx(record.signals["n_e"], rel=0.02)


def test_the_speed_alone_tells_a_torque_drive() -> None:
    record = without_torque(recorded({**TRUTH, "v": 1.0, "g": 0.0}))
    found = fp.identify(record, intervals="symmetric")
    assert found["tau_n"].value == pytest.approx(TRUTH["tau_n"], rel=0.05)
    assert found["p"].value == pytest.approx(TRUTH["p"], rel=0.02)
    assert (found["g"].status, found["v"].status) == ("fixed", "fixed")
    assert (found["g"].reason, found["v"].reason) == ("assumed", "assumed")
    assert TAKEN_FOR_TORQUE in found.verdict


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: {"command": np.full_like(s["command"], VOLTS)}, "the command moves by 0 %"),
        (lambda s: {"n_e": 2.0 * SPEED_RPM - s["n_e"]}, "n_e falls when the command rises"),
        (lambda s: {"n_e": SPEED_RPM / VOLTS * s["command"]}, "command equals n_e"),
    ],
)
def test_a_command_that_moves_nothing_is_refused(change, said: str) -> None:
    record = without_torque(recorded(TRUTH))
    with pytest.raises(fp.InputError, match=said):
        fp.identify(replace(record, signals={**record.signals, **change(record.signals)}))


def test_open_and_closed_loops_are_not_fitted_together() -> None:
    record = without_torque(recorded(TRUTH))
    closed = replace(
        record,
        signals={"n_set": record.signals["n_e"], "n_e": record.signals["n_e"]},
        operating_point={"n_set": SPEED_RPM, "n_e": SPEED_RPM},
    )
    with pytest.raises(fp.InputError, match="some experiments have a set point, others a command"):
        fp.identify([record, closed])


def test_a_known_inertia_tells_what_the_command_does() -> None:
    record = without_torque(recorded({**TRUTH, "g": 0.0}))
    found = fp.identify(record, fixed={"tau_n": TRUTH["tau_n"]}, intervals="symmetric")
    assert found["v"].value == pytest.approx(TRUTH["v"], rel=0.05)
    assert found["p"].value == pytest.approx(TRUTH["p"], rel=0.05)


def test_a_governor_is_not_fitted_to_a_command() -> None:
    with pytest.raises(fp.InputError, match="driven by 'command', structure 'ship' expects 'n_set'"):
        fp.identify(recorded(TRUTH), fp.Structure.ship())


def test_a_declared_drive_without_a_governor_is_fitted_by_its_own_equations() -> None:
    structure = commanded(Structure, ["dead_time_loop", "actuator_lag"], torque="brake", outputs=["dn", "dM"])
    found = fp.identify(recorded(TRUTH), structure)
    for name in ("tau_n", "v"):
        low, high = found[name].ci95
        assert low < found[name].value < high
        assert found[name].value == pytest.approx(TRUTH[name], rel=0.03)
