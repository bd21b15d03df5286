"""Logs of a power analyser and of a PLC, from `init` to a fingerprint, and what their units may not be."""

from __future__ import annotations

import json
import math
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import Vessel, cli
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.faults.scan import scan
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.processing.cleaning import Cleaner, require_load, require_size, require_unit
from shipfp_rs.processing.roles import guess_roles, named, named_roles
from shipfp_rs.processing.trial import Processing
from shipfp_rs.processing.trial_channels import Load, SetPoint, Tacho, Torque
from shipfp_rs.processing.trial_template import drafted, moved, windows_toml
from shipfp_rs.support.toml import template
from tests.cli.small_trial import refused
from tests.first_hour.logs import answer

CASES = Path(__file__).parents[1] / "data" / "cases"
GENSET = {
    'pole_pairs = "to be given"': "pole_pairs = 2",
    'rpm = "to be given"': "rpm = 1500.0",
    "# efficiency = 0.95": "efficiency = 0.955",
}
POD = {'rated_torque_Nm = "to be given"': "rated_torque_Nm = 80e3"}


def trial(folder: Path, name: str, answers: dict[str, str]) -> Path:
    """Return the TRIAL.toml that `init` writes for a case, with what it asks for."""
    shutil.copy(CASES / f"{name}.csv", folder)
    assert cli.main(["init", str(folder), "--log", str(folder / f"{name}.csv")]) == 0
    path = folder / "TRIAL.toml"
    answer(path, answers)
    assert '= "to be given"' not in path.read_text(encoding="utf-8")
    return path


def found(path: Path) -> dict[str, list[float]]:
    assert cli.main(["run", str(path), "--out", str(path.parent / "result")]) == 0
    told = json.loads((path.parent / "result" / "fingerprint.json").read_text(encoding="utf-8"))
    return {name: one["ci95"] for name, one in told["parameters"].items() if one["ci95"]}


def test_cases_power_analyser_of_a_generating_set_runs(tmp_path: Path) -> None:
    path = trial(tmp_path, "genset_power", GENSET)
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    assert {key: table.get("column") for key, table in content["channels"].items()} == {
        "set_point": None, "load": "P", "f": "f"
    }  # fmt: skip
    for window in content["windows"]:
        assert 0.02 <= window["start_s"] <= window["stop_s"] - 20.0
        assert window["stop_s"] <= 240.0
    start_s, stop_s = content["operating_point"]["steady_s"]
    power_W = np.mean(Log.open(tmp_path / "genset_power.csv").read("P", start_s, stop_s)) * 1e3 / 0.955
    # tau_n = J omega / M, of J = 24 kg m2, and the gains go with the torque, which is 1666.5 Nm in the truth.
    torque, omega = power_W / (50.0 * math.pi), 50.0 * math.pi
    gains = {"vK_p": 6.0 * 1666.54 / torque, "vK_i": 7.0 * 1666.54 / torque}
    truth = {"tau_n": 24.0 * omega / torque, "g": -0.25, **gains, "tau_act": 0.06, "T_d": 0.03}
    intervals = found(path)
    figures = closed_loop(Fingerprint.load(tmp_path / "result" / "fingerprint.json"))
    assert figures["phase margin"].value == pytest.approx(55.0, rel=0.15)
    assert figures["gain margin"].value == pytest.approx(12.5, rel=0.15)
    assert all(low <= truth[name] <= high for name in truth for low, high in [intervals[name]]), intervals


def test_cases_clean_chirp_of_a_plc_runs_as_it_is(tmp_path: Path) -> None:
    intervals = found(trial(tmp_path, "pod_clean_chirp", POD))
    truth = {"tau_n": 2.571, "p": 2.0, "vK_p": 6.0, "vK_i": 4.0}
    assert all(low <= truth[name] <= high for name in truth for low, high in [intervals[name]]), intervals


def test_cases_clean_chirp_has_no_fault() -> None:
    log = Log.open(CASES / "pod_clean_chirp.csv")
    for channel in ("POD1_SPEED_REF_RPM", "POD1_SPEED_ACT_RPM"):
        assert scan(Rows(log, channel), 0, log.channel(channel).samples) == {}


def test_cases_noise_of_two_steps_that_stands_is_stuck() -> None:
    samples = np.round(1000.0 + np.random.default_rng(3).normal(0.0, 2.0, 6000))
    samples[2000:2100] = 1001.0
    ((first, stop),) = scan(Rows(Log.from_arrays({"n": samples}, rate_hz=100.0), "n"), 0, 6000)[
        "stuck"
    ].tolist()
    assert abs(first - 2000) + abs(stop - 2100) <= 4


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("efficiency = 0.955", "calibration = { scale = 1.0471 } #", "channels.load: 208.8 W on average"),
        ("pole_pairs = 2", "calibration = { scale = 30 }", "channels.f: 9e+04 rpm on average"),
        ("pole_pairs = 2", "", "turns 3000 rpm; a machine of 2 times as many pairs of poles? check channels.f.pole_pairs"),
        ("pole_pairs = 2", 'pole_pairs = "to be given"', "channels.f.pole_pairs: found 'to be given', expected a"),
        ('unit = "Hz"', 'unit = "rpm"', "channels.f.pole_pairs: found a value with unit = 'rpm'"),
        ("efficiency = 0.955", "efficiency = 95.5", "channels.load.efficiency: found 95.5"),
        ("efficiency = 0.955", "efficiency = 0.955\ncalibration = { scale = 1e3 }", "load.efficiency: found calibration"),
        ("rpm = 1500.0", "rpm = 1800.0", "check unit and calibration of both, channels.set_point and channels.f"),
    ],
)  # fmt: skip
def test_cases_units_that_can_t_be_are_refused_by_the_channel_s_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    path = trial(tmp_path, "genset_power", GENSET)
    capsys.readouterr()
    path.write_text(path.read_text().replace(old, new))
    line = refused(["check", str(path)], capsys)
    assert said in line
    assert "pulses_per_rev" not in line


@pytest.mark.parametrize(
    ("name", "unit", "quantity"),
    [
        ("shaft_torque_kNm", "kNm", "torque"),
        ("TorqueKNm", "kNm", "torque"),
        ("load_kW", "kW", "power"),
        ("P [kW]", "kW", "power"),
        ("f [Hz]", "Hz", "frequency"),
        ("Shaft speed 1_s", "1/s", "speed"),
        ("TORQUE_ACT_PCT", "%", "torque"),
        ("POD1_SPEED_ACT_PCT", "%", "speed"),
        ("Fuel level [pct]", "%", "other"),
    ],
)
def test_cases_units_at_the_end_of_a_name(name: str, unit: str, quantity: str) -> None:
    told = named(Channel(name, "", 100.0, 1))
    assert (told.unit, told.quantity) == (unit, quantity)


def test_cases_a_torque_in_knm_by_its_name_is_not_taken_for_nm() -> None:
    log = Log.from_arrays({"shaft_torque_kNm": np.ones(9)}, rate_hz=1.0)
    torque = Torque.model_validate({"column": "shaft_torque_kNm", "unit": "Nm", "location": "gauge"})
    with pytest.raises(InputError, match=r"is in 'kNm', channels\.torque\.unit says 'Nm'"):
        require_unit(log, "torque", torque)


def test_cases_a_load_far_below_the_rating_is_refused_and_an_odd_speed_told() -> None:
    off, tug = {"M_load": np.full(9, 0.1)}, Vessel.load("stan-tug-1205")
    with pytest.raises(InputError, match=r"^channels\.load: 1\.7 Nm at most, but the rated torque"):
        require_load([off, {"M_load": np.full(9, 1.7)}], tug)
    require_load([off, {"M_load": np.full(9, 5e3)}], tug)
    speed = Tacho.model_validate({"column": "n", "unit": "rpm"})
    with pytest.warns(LogWarning, match=r"channels\.n: a mean of 2\.5e\+04 rpm is unusual"):
        require_size("C1", "n", speed, np.full(9, 25e3))
    switched_off = Load.model_validate({"column": "P", "unit": "kW", "quantity": "power"})
    require_size("C1", "load", switched_off, np.full(9, 0.3), switched_off.calibration.calibration("W"))


def test_cases_per_cent_and_poles_lead_to_the_shaft() -> None:
    told = {"column": "M", "unit": "%", "rated_torque_Nm": 500.0}
    load = Load.model_validate({**told, "quantity": "torque"})
    asked = SetPoint.model_validate({"column": "f", "unit": "1/s", "pole_pairs": 3})
    scales = [
        one.calibration.scale for one in (Torque.model_validate(told | {"location": "brake"}), load, asked)
    ]
    assert scales == [5.0, 5.0, 20.0]


@pytest.mark.parametrize("kind", ["stuck", "clipped", "dropout"])
def test_cases_a_refused_fault_names_the_key_that_lets_it_pass(kind: str) -> None:
    samples = 1000.0 + np.random.default_rng(3).normal(0.0, 2.0, 6000)
    samples[2000:2100] = {"stuck": 1001.0, "clipped": 1020.0, "dropout": 0.0}[kind]
    if kind == "clipped":
        samples = np.clip(samples, 990.0, 1005.0)
    rows = Rows(Log.from_arrays({"n_set": samples}, rate_hz=100.0), "n_set")
    sensor = SetPoint.model_validate({"column": "n_set", "unit": "rpm"})
    raised: list[str] = []
    while len(raised) < 4:
        faults = {key: 6000 if key == "clipped_samples" else 60.0 for key in raised}
        try:
            Cleaner(rows, sensor, Processing.model_validate({"faults": faults}), 0, 6000)
            break
        except InputError as error:
            _, bridge, keys = str(error).partition("(processing.faults.longest_bridge_s)")
            raised.append(keys.rpartition("raise processing.faults.")[2] if bridge else "")
    # A rest at zero or at a limit is one, too.
    expected = {
        "stuck": ["stuck_s"],
        "clipped": ["stuck_s", "clipped_samples"],
        "dropout": ["dropout_s", "stuck_s", "clipped_samples"],
    }
    assert raised == expected[kind]


def test_cases_windows_lie_within_the_log_move_are_long_enough_and_span_no_gap() -> None:
    time = 0.02 + np.arange(0.0, 200.0, 0.02)
    asked = 1000.0 + 20.0 * np.sin(2.0 * np.pi * 0.3 * time) * ((time < 60.0) | (abs(time - 150.0) < 3.0))
    asked[(time > 30.0) & (time < 31.0)] = np.nan
    log = Log.from_arrays({"n_set": asked}, rate_hz=50.0, units={"n_set": "rpm"}, start_s=0.02)
    _, windows = moved(log, "n_set", None)
    told = tomllib.loads(windows_toml(windows))["windows"]
    ends = [(window["start_s"], window["stop_s"]) for window in told]
    assert len(ends) == 3
    assert all(start >= 0.02 and stop - start >= 20.0 for start, stop in ends)
    assert not any(start < 31.0 and stop > 30.1 for start, stop in ends)
    assert ends[2][0] < 147.0
    assert ends[2][1] > 153.0


def test_cases_no_window_is_where_the_set_point_rests() -> None:
    time = np.arange(0.0, 100.0, 0.02)
    creeps = {"n_set": np.round(1000.0 + 0.004 * time, 1)}
    log = Log.from_arrays(creeps, rate_hz=50.0, units={"n_set": "rpm"})
    assert {window.kind for window in moved(log, "n_set", None)[1]} == {"steady"}


def test_cases_a_current_is_no_set_point() -> None:
    roles = named_roles([Channel("Current setpoint", "A", 50.0, 9), Channel("Speed", "rpm", 50.0, 9)])
    assert (roles.set_point, roles.command) == (None, "Current setpoint")
    time = np.arange(0.0, 60.0, 0.02)
    leads, follows = (np.sin(0.5 * (time - late)) for late in (0.0, 1.0))
    log = Log.from_arrays({"I1": leads, "U12": follows}, rate_hz=50.0, units={"I1": "A", "U12": "V"})
    assert guess_roles(log).set_point is None


@pytest.mark.parametrize(("rate_hz", "asked"), [(25.0, True), (100.0, True), (2000.0, False)])
def test_cases_a_set_point_that_comes_as_seldom_as_the_torque_may_be_held(
    rate_hz: float, asked: bool
) -> None:
    names = ("SPEED_REF_RPM", "SPEED_ACT_RPM", "TORQUE_KNM")
    log = Log.from_arrays({name: np.linspace(60.0, 70.0, 900) for name in names}, rate_hz=rate_hz)
    text = drafted(template("TRIAL"), log, [Path("plc.csv")], guess_roles(log), [])
    assert ("\n# held = true " in text.partition("[channels.set_point]")[2].partition("\n\n")[0]) == asked


def test_cases_a_speed_in_per_cent_is_told_from_its_set_point_and_asked_for_its_calibration() -> None:
    names = ("POD1_SPEED_REF_PCT", "POD1_SPEED_ACT_PCT")
    log = Log.from_arrays({name: np.linspace(60.0, 70.0, 900) for name in names}, rate_hz=25.0)
    roles = guess_roles(log)
    assert (roles.set_point, list(roles.speeds)) == (names[0], [names[1]])
    text = drafted(template("TRIAL"), log, [Path("pod.csv")], roles, [])
    table = text.partition('[channels."POD1_SPEED_ACT_PCT"]')[2].partition("\n\n")[0]
    assert 'unit = "%"' in table
    assert 'calibration = "to be given"  # from % to rpm' in table
    beside = Log.from_arrays({"n_set_rpm": np.ones(9), "SPEED_REF_PCT": np.ones(9)}, rate_hz=1.0)
    assert guess_roles(beside).set_point == "n_set_rpm"
