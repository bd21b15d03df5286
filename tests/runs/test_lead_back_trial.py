"""A trial whose TRIAL.toml has the vessel simulated to take off its estimates what the linear structure lacks."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from shipfp_rs import Fingerprint, Vessel, cli, signals
from shipfp_rs.assessment.ship_parameters import parameters_of
from shipfp_rs.simulation.inflow import Inflow
from shipfp_rs.simulation.raw_log import simulate_raw_log, trial_toml
from shipfp_rs.simulation.sensors import Sensors
from shipfp_rs.support.toml import built_in

SHIP = Vessel.load("stan-tug-1205").replace({"actuator.lag_s": 0.06})
FILE = built_in("vessels")["stan-tug-1205"].read_text(encoding="utf-8") + "\n[actuator]\nlag_s = 0.06\n"
IDENTIFY = """
[identify]
torque = "gauge"
products = true
free_exponent = true
noise = "white"
covariance = "sandwich"
offsets = "relative"
initial_state = "zero"
starts = 1
lead_back = true
[identify.fixed]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raw log of a ship whose actuator lags in moving water, its vessel file, and a structure without lag."""
    folder = tmp_path_factory.mktemp("trial")
    chirp = signals.chirp(0.02, 0.9, 120.0, 40.0, rate_hz=200.0)
    log, truth = simulate_raw_log(
        SHIP, chirp, faults=("C",), steady_s=30.0, inflow=Inflow(0.002), simulated_hz=200.0, seed=5
    )
    log.write(folder / "log.parquet")
    (window,) = truth.windows
    began = dataclasses.replace(window, start_s=window.start_s - 2.0)
    text = trial_toml("ship.toml", "log.parquet", Sensors(), dataclasses.replace(truth, windows=(began,)))
    known = parameters_of(SHIP)
    text = text.replace("rate_hz = 50.0", "rate_hz = 6.25") + IDENTIFY
    (folder / "TRIAL.toml").write_text(text + f"tau_n = {known['tau_n']}\ng = {known['g']}\n")
    (folder / "ship.toml").write_text(FILE)
    return folder


def identified(folder: Path, name: str) -> Fingerprint:
    assert cli.main(["run", str(folder / name), "--out", str(folder / "result"), "--force"]) == 0
    return Fingerprint.load(folder / "result" / "fingerprint.json")


def test_what_the_structure_lacks_is_taken_off(folder: Path) -> None:
    truth = parameters_of(SHIP)
    led_back = identified(folder, "TRIAL.toml")
    (folder / "alone.toml").write_text(
        (folder / "TRIAL.toml").read_text().replace("lead_back = true", "lead_back = false")
    )
    alone = identified(folder, "alone.toml")
    assert led_back.settings["offsets"] == alone.settings["offsets"] == "relative"
    assert led_back.settings["covariance"] == "sandwich"
    for name in ("vK_p", "vK_i"):
        low, high = led_back[name].ci95
        assert low < truth[name] < high, name
    low, high = alone["vK_p"].ci95
    assert not low < truth["vK_p"] < high, "the structure has no lag"
    page = (folder / "result" / "report.html").read_text()
    assert "vK_p" in page


def test_a_grey_box_has_nothing_to_be_led_back_from(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (folder / "TRIAL.toml").read_text()
    box = '\n[structure]\nkind = "grey_box"\nfree = ["Kp_abs"]\n[identify]\nlead_back = true\n'
    (folder / "box.toml").write_text(text[: text.index("[identify]")] + box)
    assert cli.main(["run", str(folder / "box.toml"), "--out", str(folder / "box")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "identify.lead_back" in line
    assert not (folder / "box").exists()
