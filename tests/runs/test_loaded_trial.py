"""A generating set whose electric load is measured: its channel is all that is said, and it drives the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.question import question_of
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.runs.run import run
from shipfp_rs.vessel.vessel import Vessel
from tests.families.plant import physical
from tests.families.small_steps import simulate

TRUTH = {"tau_n": 0.9, "g": -0.3, "vK_p": 4.0, "vK_i": 6.0, "p": 0.4, "T_d": 0.06}
PLANT = physical(TRUTH, engine_speed=25.0, shaft_torque=955.0)
RATE_HZ, SECONDS = 400.0, 160.0
TRIAL = """windows = [{ name = "S1", kind = "steps", start_s = 15.0, stop_s = 158.0 }]
[trial]
name = "Load steps"
vessel = "direct-drive"
log = "log.parquet"
rate_hz = 400.0
[channels]
set_point = { column = "n_set", unit = "rpm", calibration = { scale = 1.0 } }
torque = { column = "M", unit = "Nm", calibration = { scale = 1.0 }, location = "brake" }
speed = { column = "n", unit = "rpm" }
load = { column = "P", unit = "kW", calibration = { scale = 1000.0 }, quantity = "power" }
[operating_point]
steady_s = [1.0, 19.0]
"""


def ramps(at: list[float], levels: list[float], ramp_s: float):
    """Levels that are reached in a ramp each, as a function of time; zero before."""
    times = np.ravel([[start, start + ramp_s] for start in at])
    values = np.concatenate([[0.0], np.repeat(levels, 2)[:-1]])
    return lambda time: np.interp(time, times, values)


def recorded() -> dict[str, np.ndarray]:
    """Channels of the log: the load's own law goes with N^p, its steps stand in the electric power."""
    random = np.random.default_rng(11)
    asked = ramps(
        [20.0, 31.3, 47.1, 68.7, 90.2, 115.9, 133.3], [0.02, -0.02, 0.01, -0.01, 0.02, 0.0, 0.015], 0.2
    )
    load = ramps([25.1, 39.8, 58.3, 77.7, 101.4, 124.2, 143.6], [0.2, -0.15, 0.1, -0.25, 0.2, -0.1, 0.0], 0.1)
    pushed = lambda time: PLANT.shaft_torque * load(time)  # noqa: E731 the simulation takes functions
    motion = simulate(PLANT, lambda time: 1.0 + asked(time), SECONDS, step_s=0.5 / RATE_HZ, load=pushed)
    power = 2e-3 * np.pi * motion.load_speed * (PLANT.shaft_torque + motion.load_torque)
    noise = lambda std: std * random.standard_normal(len(motion.asked))  # noqa: E731
    channels = {
        "n_set": 60.0 * motion.asked + noise(0.2),
        "n": 60.0 * motion.engine_speed + noise(1.0),
        "M": motion.brake_torque + noise(5.0),
        "P": power + noise(0.5),
    }
    return {name: values[::2] for name, values in channels.items()}


def write_loaded_trial(folder: Path) -> None:
    """Write log.parquet and TRIAL.toml into a folder."""
    pyarrow.parquet.write_table(pa.table(recorded()), folder / "log.parquet")
    (folder / "TRIAL.toml").write_text(TRIAL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("genset")
    write_loaded_trial(folder)
    return folder


def altered(
    folder: Path, tmp_path: Path, changes: dict[str, tuple[slice, float | np.ndarray]], text: str = TRIAL
) -> Trial:
    table = columns_of(folder)
    for channel, (samples, value) in changes.items():
        table[channel][samples] = value
    pyarrow.parquet.write_table(pa.table(table), tmp_path / "log.parquet")
    (tmp_path / "TRIAL.toml").write_text(text)
    return Trial.load(tmp_path / "TRIAL.toml")


def columns_of(folder: Path) -> dict[str, np.ndarray]:
    table = pyarrow.parquet.read_table(folder / "log.parquet")
    return {
        name: column.to_numpy().copy() for name, column in zip(table.column_names, table.columns, strict=True)
    }


def test_power_becomes_the_torque_of_the_shaft(folder: Path) -> None:
    (experiment,) = process(folder / "TRIAL.toml")
    steady = experiment.window(0.0, 4.0).signals["M_load"]
    assert steady.mean() == pytest.approx(PLANT.shaft_torque, rel=1e-3)
    assert experiment.operating_point["M_load"] == pytest.approx(PLANT.shaft_torque, rel=1e-3)


def test_what_a_load_lost_is_masked_in_the_answers(folder: Path, tmp_path: Path) -> None:
    lost = slice(round(50.0 * RATE_HZ), round(50.1 * RATE_HZ))
    (experiment,) = process(altered(folder, tmp_path, {"P": (lost, np.nan)}))
    assert np.isfinite(experiment.signals["M_load"]).all()
    masked = np.flatnonzero(np.isnan(experiment.signals["n_e"])) / experiment.rate_hz + 15.0
    assert masked.min() == pytest.approx(50.0, abs=0.03)
    assert masked.max() == pytest.approx(50.1, abs=0.03)
    assert np.isnan(experiment.signals["M_b"]).sum() == len(masked)


def test_a_load_lost_for_long_is_refused(folder: Path, tmp_path: Path) -> None:
    lost = slice(round(50.0 * RATE_HZ), round(51.0 * RATE_HZ))
    trial = altered(folder, tmp_path, {"P": (lost, np.nan)})
    with pytest.raises(InputError, match="load 'P' has a fault"):
        process(trial)


def test_a_load_that_starts_from_zero_is_normalised_by_the_means_under_load(
    folder: Path, tmp_path: Path
) -> None:
    idle = slice(0, round(20.0 * RATE_HZ))
    (experiment,) = process(altered(folder, tmp_path, {"P": (idle, 0.1), "M": (idle, 30.0)}))
    for name in ("n_e", "M_b", "M_load"):
        assert experiment.operating_point[name] == pytest.approx(np.nanmean(experiment.signals[name]))


def test_a_load_from_zero_beside_another_torque_is_a_part_of_that(folder: Path, tmp_path: Path) -> None:
    idle = slice(0, round(20.0 * RATE_HZ))
    (experiment,) = process(altered(folder, tmp_path, {"P": (idle, 0.0)}))
    point = experiment.operating_point
    assert point["M_b"] == pytest.approx(PLANT.shaft_torque, rel=1e-2)
    swing = np.ptp(experiment.signals["M_load"]) / point["M_b"]
    assert np.ptp(experiment.normalised("M_load")) == pytest.approx(swing)


@pytest.mark.parametrize(("sign", "point"), [(1.0, 955.0), (-1.0, -955.0), (1.0, 0.0)])
def test_a_loads_deviation_is_over_the_torque_and_rises_with_it(sign: float, point: float) -> None:
    load = point + sign * np.linspace(0.0, 95.5, 50)
    signals = {"n_set": np.ones(50), "M_b": np.full(50, 955.0), "M_load": load}
    experiment = Experiment("x", 50.0, signals, {"n_set": 1.0, "M_b": 955.0, "M_load": point})
    assert experiment.normalised("M_load")[[0, -1]] == pytest.approx([0.0, 0.1])


@pytest.mark.parametrize("told", [True, False])
def test_a_load_behind_a_gearbox_is_divided_by_the_torque_of_its_own_shaft(told: bool) -> None:
    """Whether the vessel file has the ratio, or the load at rest is larger than the engine's torque."""
    load = np.linspace(4.9 * 955.0, 4.9 * 955.0 * 1.1, 50)
    signals = {"n_set": np.ones(50), "M_b": np.full(50, 955.0), "M_load": load}
    source = {"load": {"quantity": "torque", "torque_ratio": 4.9}} if told else {}
    point = {"n_set": 1.0, "M_b": 955.0, "M_load": 4.9 * 955.0}
    experiment = Experiment("x", 50.0, signals, point, provenance=source)
    assert experiment.normalised("M_load")[[0, -1]] == pytest.approx([0.0, 0.1])


def test_processing_tells_the_ratio_between_a_load_and_the_engines_torque(folder: Path) -> None:
    trial = Trial.load(folder / "TRIAL.toml")
    geared = Vessel.load("direct-drive").replace({"gearbox.ratio": 2.5, "gearbox.efficiency": 0.96})
    (experiment,) = process(trial.logs()[0], trial, geared)
    assert experiment.provenance["load"] == {"quantity": "power", "torque_ratio": pytest.approx(2.4)}


def test_a_set_point_that_rests_while_the_load_moves_is_no_fault(folder: Path, tmp_path: Path) -> None:
    (experiment,) = process(altered(folder, tmp_path, {"n_set": (slice(None), 1500.0)}))
    assert [fault["kind"] for fault in experiment.provenance["faults"]] == []
    question = question_of([experiment])
    assert question.loaded
    assert "T_set" not in question.always


@pytest.mark.parametrize("torque_Nm", [955.0, 700.0])
def test_without_a_steady_stretch_the_load_follows_from_the_torque(
    torque_Nm: float, folder: Path, tmp_path: Path
) -> None:
    given = TRIAL.replace("steady_s = [1.0, 19.0]", f"n_e_rpm = 1500.0\nM_Nm = {torque_Nm}")
    (experiment,) = process(altered(folder, tmp_path, {}, given))
    assert experiment.operating_point["M_load"] == pytest.approx(torque_Nm, rel=0.01)


def test_a_part_of_the_torque_that_is_the_load_is_known_without_a_steady_stretch(
    folder: Path, tmp_path: Path
) -> None:
    """The rest of the torque is that of a pump on the same shaft; the means over the window are given."""
    table = columns_of(folder)
    given = TRIAL.replace("steady_s = [1.0, 19.0]", f"n_e_rpm = 1500.0\nM_Nm = {table['M'].mean()}")
    (experiment,) = process(altered(folder, tmp_path, {"P": (slice(None), 0.5 * table["P"])}, given))
    mean = experiment.signals["M_load"].mean()
    assert experiment.operating_point["M_load"] == pytest.approx(mean, rel=0.02)


def test_two_loggers_on_one_clock_are_one_trial(folder: Path, tmp_path: Path) -> None:
    """The second one began 0.5 s later; both count on the same clock."""
    table = columns_of(folder)
    time = np.arange(len(table["n"])) / RATE_HZ
    for name, columns, late in (("speed", ("n_set", "n"), 0), ("load", ("M", "P"), round(0.5 * RATE_HZ))):
        kept = {"time": time[late:], **{column: table[column][late:] for column in columns}}
        pyarrow.parquet.write_table(pa.table(kept), tmp_path / f"{name}.parquet")
    text = TRIAL.replace('log = "log.parquet"\nrate_hz = 400.0', 'log = ["speed.parquet", "load.parquet"]')
    (tmp_path / "TRIAL.toml").write_text(text)
    with pytest.raises(InputError, match=r"or \[align\], where the logs are loggers of one trial"):
        Trial.load(tmp_path / "TRIAL.toml")
    (tmp_path / "TRIAL.toml").write_text(f'{text}[align]\nreference = "speed.parquet"\n')
    trial, alone = Trial.load(tmp_path / "TRIAL.toml"), Trial.load(folder / "TRIAL.toml")
    (log,) = trial.logs()
    (two,), (one,) = process(log, trial), process(alone.logs()[0], alone)
    for name in ("n_set", "n_e", "M_b", "M_load"):
        assert two.signals[name] == pytest.approx(one.signals[name], rel=1e-3), name


def test_a_run_on_a_load_without_a_torque_says_what_the_load_determines(folder: Path, tmp_path: Path) -> None:
    text = (folder / "TRIAL.toml").read_text()
    torque = next(line for line in text.splitlines() if line.startswith("torque = "))
    path = folder / "no-torque.toml"
    path.write_text(text.replace(torque + "\n", "") + "M_Nm = 955.0\n")
    found = run(path, tmp_path / "out").fingerprint
    said = " ".join(found.verdict)
    assert "the measured load determines tau_n and the gains, but of p and g only their difference" in said
    assert "Assumed, not given: k_L = 1." in said
    assert (found["k_L"].status, found["k_L"].reason) == ("fixed", "assumed")
    assert "ratios" not in said
    low, high = found["tau_n"].ci95
    assert low < TRUTH["tau_n"] < high
    # The shaft's losses have a prior, so that the engine's slope is known as well as they are.
    low, high = found["(p-g)/tau_n"].ci95
    assert low < (TRUTH["p"] - TRUTH["g"]) / TRUTH["tau_n"] < high
    assert {found[name].status for name in ("p", "g")} == {"prior"}
    path.write_text(path.read_text() + "[identify]\nfixed = { p = 0.4, k_L = 1.0 }\n")
    found = run(path, tmp_path / "out").fingerprint
    assert (found["k_L"].status, found["k_L"].reason) == ("fixed", "given")
    assert "assumed" not in " ".join((*found.verdict, str(found))).lower()
