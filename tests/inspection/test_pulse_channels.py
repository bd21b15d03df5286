"""Which channels an inspection takes for pulse trains, and logs that are short, empty or slow."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

from shipfp_rs import cli
from shipfp_rs.inspection import inspect_log
from shipfp_rs.inspection.channels import pulse_rate
from shipfp_rs.logs.log import Channel, Log, Rows
from tests.tacho.test_pulse_levels import record

RATE = 2000.0
TIME = np.arange(round(60.0 * RATE)) / RATE
RNG = np.random.default_rng(4)


def rate_of(samples: np.ndarray, rate_hz: float = RATE) -> float | None:
    return pulse_rate(Rows(Log.from_arrays({"x": samples}, rate_hz=rate_hz), "x"))


@pytest.mark.parametrize("kind", ["run-up", "from rest", "fading", "drift", "missing tooth"])
def test_breakage_c1_sinusoidal_pick_ups_are_pulse_trains(kind):
    truth = record(kind, RATE, seed=2)
    assert rate_of(truth.samples) == pytest.approx(len(truth.pulse_s) / 60.0, rel=0.15)


def wander(scale: float) -> np.ndarray:
    return scale * np.cumsum(RNG.standard_normal(len(TIME))) / np.sqrt(len(TIME))


def ripple(amplitudes: tuple[float, ...]) -> np.ndarray:
    shaft = 2.0 * np.pi * np.cumsum(5.16 * (1.0 + 0.005 * np.sin(0.6 * TIME))) / RATE
    return sum(a * np.sin(k * shaft) for a, k in zip(amplitudes, (1.0, 3.0, 3.82, 11.46), strict=True))


@pytest.mark.parametrize(
    "samples",
    [
        1700.0 + ripple((4.0, 12.0, 10.0, 60.0)) + RNG.normal(0.0, 5.0, len(TIME)),
        1700.0 + ripple((0.0, 0.0, 0.0, 60.0)) + RNG.normal(0.0, 1.0, len(TIME)),
        ripple((20.0, 30.0, 25.0, 60.0)) + RNG.normal(0.0, 1.0, len(TIME)),
        1700.0 + 300.0 * np.sin(0.6 * TIME) + wander(100.0),
        np.where(TIME // 4 % 2 == 0, 1000.0, 1800.0) + RNG.normal(0.0, 20.0, len(TIME)),
        np.where(RNG.random(60)[(TIME // 1).astype(int)] < 0.5, 1000.0, 1800.0) + RNG.normal(0.0, 20.0, len(TIME)),
        -5.0 + 0.15 * np.sin(2 * np.pi * 0.5 * TIME) + RNG.normal(0.0, 0.004, len(TIME)),
        RNG.normal(0.0, 1.0, len(TIME)),
        wander(1.0),
        0.2 * np.sin(2 * np.pi * 50.0 * TIME) + RNG.normal(0.0, 0.002, len(TIME)),
    ],
    ids=[
        "torque", "torque of one order", "torque about zero", "torque in a sea", "torque of even steps",
        "torque of uneven steps", "set point", "noise", "wander", "hum",
    ],
)  # fmt: skip
def test_breakage_c1_a_fluctuating_torque_is_no_pulse_train(samples):
    assert rate_of(samples) is None


@pytest.mark.parametrize(
    ("low", "high"), [(1000.0, 1200.0), (6.0, 8.0), (-5.2, -4.8), (-2.0, 2.0), (-1.0, 3.0)]
)
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_speed_or_voltage_that_steps_between_two_levels_is_no_pulse_train(low, high, noise):
    steps = np.where(TIME % 3.0 < 1.5, low, high)
    assert rate_of(steps + noise * (high - low) * RNG.standard_normal(len(TIME))) is None


def test_a_unit_of_speed_is_no_pulse_train_though_it_steps_down_to_zero():
    log = Log.from_arrays({"x": np.where(TIME % 3.0 < 1.5, 0.0, 60.0)}, rate_hz=RATE, units={"x": "rpm"})
    assert [report.pulses_hz for report in inspect_log(log).channels] == [None]


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.2, 4.8), (-0.4, 4.6), (-24.0, 0.0)])
def test_pulses_between_logic_levels_are_a_train_however_slow(low, high):
    assert rate_of(np.where(TIME % 3.0 < 1.5, low, high)) == pytest.approx(1.0 / 3.0, rel=0.1)


def test_a_train_about_zero_is_one_at_the_rates_of_a_shaft_after_a_rest_too():
    turns = np.where(TIME > 40.0, 8.0 * TIME, 0.25)
    assert rate_of(np.where(turns % 1.0 < 0.5, 2.0, -2.0)) == pytest.approx(8.0 / 3.0, rel=0.1)


def empty_beside(**channels: np.ndarray) -> Log:
    def blocks(name, first, size):
        data = channels.get(name, np.empty(0))
        for start in range(first, len(data), size):
            yield data[start : start + size]

    rows = [Channel(name, "V", 500.0, len(data)) for name, data in channels.items()]
    return Log("memory", [*rows, Channel("empty", "V", 500.0, 0)], blocks)


def test_breakage_c3_an_empty_channel_is_told_of():
    log = empty_beside(n_set=RNG.normal(-5.0, 0.004, 30_000))
    reports = {report.channel.name: report for report in inspect_log(log).channels}
    assert reports["empty"].pulses_hz is None
    assert np.isnan(reports["empty"].low)


def short_log(tmp_path, seconds: float):
    time = np.arange(round(seconds * RATE)) / RATE
    moving = time > 0.5 * seconds
    log = Log.from_arrays(
        {
            "n_set": -5.0 + 0.1 * moving * np.sin(2 * np.pi * 0.5 * time) + RNG.normal(0.0, 0.004, len(time)),
            "PTM_4": np.where(20.0 * time % 1 < 0.3, 5.0, 0.0) + RNG.normal(0.0, 0.02, len(time)),
        },
        rate_hz=RATE,
    )
    return log.write(tmp_path / "short.parquet")


@pytest.mark.parametrize("rate", ["1e-12", "500"])
def test_breakage_c3_a_rate_far_too_low_is_no_internal_error(tmp_path, rate, capsys):
    np.savetxt(tmp_path / "log.csv", RNG.normal(0.0, 1.0, (500, 2)), delimiter=",", header="a,b", comments="")
    assert cli.main(["inspect", str(tmp_path / "log.csv"), "--rate", rate]) == 0
    assert "500" in capsys.readouterr().out


@pytest.mark.parametrize("seconds", [6.0, 16.0, 30.0])
def test_breakage_c3_logs_below_forty_seconds_are_inspected_and_begun_with(tmp_path, seconds, capsys):
    path = short_log(tmp_path, seconds)
    assert cli.main(["inspect", str(path)]) == 0
    assert cli.main(["init", str(tmp_path), "--log", str(path)]) == 0
    shown = capsys.readouterr().out
    assert ("no windows found" in shown) == (seconds < 10.0)
    trial = tomllib.loads((tmp_path / "TRIAL.toml").read_text())
    assert trial["channels"]["set_point"]["column"] == "n_set"


SHORT_TRIAL = """
[trial]
name = "Short"
vessel = "stan-tug-1205"
log = "short.parquet"

[channels.set_point]
column = "n_set"
unit = ""
calibration = { scale = -251.38, offset = -85.29 }

[channels.PTM_4]
column = "PTM_4"
pulses_per_rev = 4
shaft = "propeller"

[operating_point]
n_e_rpm = 1146.0
steady_s = [0.0, 12.0]

[[windows]]
name = "S1"
kind = "sine"
start_s = 12.5
stop_s = 24.0
"""


@pytest.mark.parametrize("rests", [True, False])
def test_breakage_c3_a_short_log_is_inspected_with_its_trial(tmp_path, rests, capsys):
    log = Log.open(short_log(tmp_path, 25.0))
    if not rests:
        # A set point that creeps: no rest is found, and the trial's own counts.
        arrays = {name: np.array(log.read(name)) for name in log.channels}
        arrays["n_set"] += 0.02 * np.arange(len(arrays["n_set"])) / RATE
        Log.from_arrays(arrays, rate_hz=RATE).write(tmp_path / "short.parquet")
    (tmp_path / "TRIAL.toml").write_text(SHORT_TRIAL)
    assert cli.main(["inspect", str(tmp_path / "short.parquet"), str(tmp_path / "TRIAL.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any(window["kind"] == "steady" for window in found["windows"])
    assert found["checks"]["pulse_trains"]["median_rpm"]["PTM_4"] == pytest.approx(1146.0, rel=1e-3)
