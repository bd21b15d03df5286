"""A trial of forty seconds at 50 Hz that is read, cleaned and identified within a second or two."""

from __future__ import annotations

from pathlib import Path

import pytest

import shipfp_rs as fp
from shipfp_rs import cli
from shipfp_rs.logs.log import Log
from shipfp_rs.vessel.vessel import Vessel


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that must be refused, and return its one line."""
    status = cli.main(arguments)
    told = capsys.readouterr()
    assert (status, told.out) == (2, ""), told
    assert told.err.startswith("shipfp: error: ")
    assert told.err.count("\n") == 1
    assert "internal" not in told.err
    assert len(told.err) < 1000
    return told.err


SMALL = """
[trial]
name = "Small"
vessel = "stan-tug-1205"
log = "log.parquet"

[channels.set_point]
column = "set point"
unit = "rpm"
calibration = { scale = 1.0 }

[channels.torque]
column = "torque"
unit = "Nm"
calibration = { scale = 1.0, offset = 0.0 }
location = "gauge"

[channels.speed]
column = "speed"
unit = "rpm"
shaft = "engine"

[operating_point]
n_e_rpm = 1183.8
M_Nm = 1725.0

[[windows]]
name = "C1"
kind = "chirp"
start_s = 1.0
stop_s = 39.0

[identify]
products = true
starts = 2
fixed = { tau_n = 1.17 }
"""
SWEEP = """
[sweep]
vessel = "stan-launch-804"
draws = 2

[excitation]
duration_s = 10.0
start_hz = 0.2
rate_hz = 20.0

[noise]
n_e = 0.001
M_b = 0.005

[identify]
noise = "white"

[factors]
"noise.level" = { low = 0.5, high = 2.0 }
"""


def small_log() -> Log:
    """Return what a tug's set point, speed and torque do in a chirp, in their units."""
    chirp = fp.signals.chirp(0.05, 1.5, 40.0, 40.0, rate_hz=50.0)
    trial = fp.simulate(Vessel.load("stan-tug-1205"), chirp, noise={"n_e": 0.02, "M_g": 0.02}, seed=1)
    names = {"n_set": ("set point", "rpm"), "n_e": ("speed", "rpm"), "M_g": ("torque", "Nm")}
    return Log.from_arrays(
        {name: trial.signals[signal] for signal, (name, _) in names.items()},
        rate_hz=50.0,
        units=dict(names.values()),
    )


def write_small_trial(folder: Path) -> None:
    """Write log.parquet, TRIAL.toml and SWEEP.toml into a folder."""
    small_log().write(folder / "log.parquet")
    (folder / "TRIAL.toml").write_text(SMALL, encoding="utf-8")
    (folder / "SWEEP.toml").write_text(SWEEP, encoding="utf-8")
