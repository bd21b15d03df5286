"""Windows that are held out: they leave the fit as it is, are predicted with a band, and show a ship that changed."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import shipfp_rs as fp
from shipfp_rs.assessment.si import parameters_of, with_parameters
from shipfp_rs.assessment.validation import held_out
from shipfp_rs.cli import app
from shipfp_rs.simulation.raw_log import trial_toml

TUG = fp.Vessel.load("stan-tug-1205")
SENSORS = fp.Sensors(rate_hz=500.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of two chirps and its TRIAL.toml, which fits both."""
    made = tmp_path_factory.mktemp("trial")
    chirps = [
        fp.signals.chirp(first, last, 60.0, 40.0, rate_hz=500.0, name=name)
        for name, first, last in (("up", 0.02, 1.5), ("down", 1.5, 0.02))
    ]
    log, truth = fp.simulate_raw_log(TUG, chirps, sensors=SENSORS, seed=3)
    log.write(made / "log.parquet")
    (made / "TRIAL.toml").write_text(trial_toml("stan-tug-1205", "log.parquet", SENSORS, truth))
    return made


def use(folder: Path, name: str, uses: dict[str, str], *, without: str | None = None) -> Path:
    """TRIAL.toml with these uses of windows, and without one of them."""
    head, *windows = (folder / "TRIAL.toml").read_text().split("[[windows]]")
    kept = [one for one in windows if without is None or f'name = "{without}"' not in one]
    for window, how in uses.items():
        kept = [one.replace(f'name = "{window}"', f'name = "{window}"\nuse = "{how}"') for one in kept]
    path = folder / name
    path.write_text("[[windows]]".join([head, *kept]))
    return path


@pytest.fixture(scope="module")
def names(folder: Path) -> tuple[str, str]:
    first, second = (window.name for window in fp.Trial.load(folder / "TRIAL.toml").windows)
    return first, second


@pytest.fixture(scope="module")
def result(folder: Path, names: tuple[str, str]):
    return fp.run(use(folder, "held.toml", {names[1]: "validation"}), out=folder / "held")


def test_a_window_held_out_does_not_change_the_fit_by_a_bit(folder, names, result):
    alone = fp.run(use(folder, "alone.toml", {}, without=names[1]), out=folder / "alone").fingerprint
    kept = ("parameters", "derived", "covariance", "settings", "data", "si", "load_side", "elements")
    held = result.fingerprint.to_dict()
    assert {key: held[key] for key in kept} == {key: alone.to_dict()[key] for key in kept}
    assert [one.name for one in fp.read_experiments(folder / "held" / "experiments.parquet")] == [names[0]]
    assert [one.name for one in fp.read_experiments(folder / "held" / "validation.parquet")] == [names[1]]


def test_the_same_ship_is_predicted_within_its_band(folder, names, result):
    stored = json.loads((folder / "held" / "fingerprint.json").read_text())["held_out"]
    assert list(stored) == [names[1]]
    for output, row in stored[names[1]].items():
        assert 88.0 <= row["inside_pct"] <= 99.5, output
        assert row["nrmse_pct"] > 60.0, output
    assert any(line.startswith(f"Held out and predicted: {names[1]}") for line in result.fingerprint.verdict)
    page = (folder / "held" / "report.html").read_text()
    assert 'id="held-out"' in page
    assert f"{names[1]}, held out: what the prediction misses" in page


def test_a_heavier_ship_is_predicted_worse():
    """Quiet signals: an inertia that is a tenth larger moves the response by more than the band."""
    noise, true = {"n_e": 0.003, "M_g": 0.01}, parameters_of(TUG)
    heavier = with_parameters(TUG, {name: 1.1 * true[name] for name in ("tau_n", "tau_prop")})
    first, second = (
        fp.signals.chirp(0.02, 2.0, 60.0, 40.0, rate_hz=50.0, name="first"),
        fp.signals.chirp(2.0, 0.05, 40.0, 40.0, rate_hz=50.0, name="second"),
    )
    found = fp.identify(fp.simulate(TUG, first, noise=noise, seed=1), torque="gauge", outputs=["dn", "dM"])
    same, other = (held_out(found, fp.simulate(ship, second, noise=noise, seed=2)) for ship in (TUG, heavier))
    for output in ("dn", "dM"):
        assert same.score[output]["inside_pct"] >= 93.0, output
    assert other.score["dn"]["inside_pct"] < 0.5 * same.score["dn"]["inside_pct"]
    assert other.score["dn"]["nrmse_pct"] < same.score["dn"]["nrmse_pct"] - 2.0
    assert other.score["dM"]["nrmse_pct"] < same.score["dM"]["nrmse_pct"]
    assert np.all(same.band["M_g"] > 0.0)


def test_check_names_what_is_fitted_and_what_is_held_out(folder, names):
    path = use(folder, "check.toml", {names[1]: "validation"})
    told = json.loads(CliRunner().invoke(app, ["check", str(path), "--json"]).stdout)
    assert {window["name"]: window["use"] for window in told["windows"]} == {
        names[0]: "fit",
        names[1]: "validation",
    }
    assert "held out" in CliRunner().invoke(app, ["check", str(path)]).output


def test_a_trial_whose_windows_are_all_held_out_is_refused(folder, names):
    path = use(folder, "none.toml", dict.fromkeys(names, "validation"))
    with pytest.raises(
        fp.InputError, match=r"windows: found .*validation.*, expected one window or more to fit"
    ):
        fp.Trial.load(path)
    assert isinstance(CliRunner().invoke(app, ["check", str(path)]).exception, fp.InputError)
