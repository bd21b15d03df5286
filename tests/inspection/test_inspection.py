"""What an inspection tells of a log: its channels and gaps, what makes its lines, and whether its calibrations hold."""

import json
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli, published, signals
from shipfp_rs.inspection import SteadyPoint, inspect_log, static_check
from shipfp_rs.inspection.checks import rates_of
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
from shipfp_rs.vessel.vessel import Vessel
from tests.logger_files import altered

TUG = Vessel.load("stan-tug-1205")
EXCITATIONS = [
    signals.sine_sequence([0.5], 15, 76.0, rate_hz=500.0),
    signals.steps([-250.0, 125.0, 125.0, 125.0, -125.0], 20.0, rate_hz=500.0),
]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("inspection")
    sensors = Sensors()
    log, truth = simulate_raw_log(
        TUG, EXCITATIONS, sensors=sensors, faults=("C", "D1", "B"), steady_s=60.0, pause_s=20.0, seed=4
    )
    lost = {"U_torque": (slice(150_000, 151_000), np.nan)}
    path = altered(log, lost).write(folder / "run.parquet")
    (folder / "TRIAL.toml").write_text(trial_toml("stan-tug-1205", path.name, sensors, truth))
    return path, folder / "TRIAL.toml"


@pytest.fixture(scope="module")
def bare(recorded):
    return inspect_log(Log.open(recorded[0]))


@pytest.fixture(scope="module")
def full(recorded):
    return inspect_log(Log.open(recorded[0]), Trial.load(recorded[1]), C_Q=0.02709)


def test_a_bare_log_tells_channels_pulses_noise_and_gaps(bare):
    reports = {report.channel.name: report for report in bare.channels}
    assert reports["PTM_4"].pulses_hz == pytest.approx(4 * 1183.8 / 60 / 3.82, rel=0.02)
    assert reports["PTM_e"].pulses_hz == pytest.approx(1183.8 / 60, rel=0.02)
    assert reports["U_setpoint"].pulses_hz is None
    assert reports["U_torque"].pulses_hz is None
    assert reports["U_setpoint"].noise == pytest.approx(Sensors().set_point_noise_V, rel=0.1)
    assert reports["U_torque"].gaps.tolist() == [[150_000, 151_000]]
    assert bare.to_dict()["channels"][1]["gaps"] == [[75.0, 75.5]]
    assert {window.kind for window in bare.windows} == {"steady", "sine", "steps"}


def test_the_lines_of_the_torque_have_their_names_and_sizes(full):
    peaks = {peak.name: peak for peak in full.peaks["U_torque"] if peak.name}
    rates = rates_of(TUG, 1183.8)
    for (name, rate), amplitude in zip(rates.items(), Sensors().ripple_Nm, strict=True):
        assert peaks[name].frequency_hz == pytest.approx(rate, abs=0.05)
        assert peaks[name].amplitude == pytest.approx(amplitude, rel=0.1)


def test_the_published_lines_are_those_of_the_tug():
    # Table 6.9 was read off a picture at 1184 rpm.
    rates = rates_of(TUG, 1184.0)
    for row, rate in zip(published.torque_spectrum_peaks(), rates.values(), strict=True):
        assert row.frequency_hz == pytest.approx(rate, rel=0.005)


def test_published_static_torques_are_recomputed():
    rows = published.static_torque()
    points = [
        SteadyPoint(row.engine_speed_rpm, row.engine_speed_rpm, row.measured_torque_nm, 1.0) for row in rows
    ]
    check = static_check(TUG, points, 0.02709)
    assert check["calculated_Nm"] == pytest.approx([row.calculated_torque_nm for row in rows], rel=2e-3)
    # 0.99 is printed for 1184 rpm; its own torques make 1.56.
    printed = [1.56 if row.engine_speed_rpm == 1184 else row.error_pct for row in rows]
    assert check["error_pct"] == pytest.approx(printed, abs=0.15)
    assert check["exponent"] == pytest.approx(2.17, abs=0.02)


def test_steady_points_give_line_exponent_and_reflectors(full):
    line = full.checks["set_point_to_speed"]
    assert line["points"] >= 4
    assert line["slope"] == pytest.approx(1.0, abs=2e-3)
    assert line["largest_residual_rpm"] < 1.0
    static = full.checks["static_torque"]
    assert static["exponent"] == pytest.approx(TUG.propeller.torque_exponent, abs=0.02)
    trains = full.checks["pulse_trains"]
    assert trains["largest_disagreement_pct"] < 0.1
    true = np.diff(np.append((np.arange(4) + np.array(Sensors().reflector_errors)) / 4.0, 1.0)) * 4.0 - 1.0
    ours = np.array(trains["reflector_error_pct_of_pitch"]) / 100.0
    assert min(np.abs(ours - np.roll(true, k)).max() for k in range(4)) < 1e-3


def test_faults_are_told_by_kind_and_channel(full):
    kinds = {(fault["kind"], fault["channel"]): fault for fault in full.faults}
    assert kinds["gap", "U_torque"]["spans"] == [[150_000, 151_000]]
    assert kinds["C", "U_torque"]["count"] > 3
    assert kinds["D1", "U_setpoint"]["count"] > 2
    for fault in full.faults:
        assert fault["count"] == len(fault["spans"])


def test_the_command_prints_json_and_tables_and_draws(recorded, tmp_path, capsys):
    log, trial = recorded
    assert cli.main(["inspect", str(log), str(trial), "--json", "--out", str(tmp_path / "pictures")]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [channel["name"] for channel in content["channels"]][:2] == ["U_setpoint", "U_torque"]
    assert set(content["channels"][0]) >= {"name", "unit", "rate_hz", "samples", "start", "gaps"}
    assert set(content["faults"][0]) >= {"kind", "channel", "count", "spans"}
    pictures = {path.name for path in (tmp_path / "pictures").iterdir()}
    assert pictures == {
        "inspection.json",
        "windows.png",
        "spectrum-1.png",
        "spectrum-2.png",
        "static-torque.png",
    }
    assert cli.main(["inspect", str(log)]) == 0
    shown = capsys.readouterr().out
    assert "U_torque" in shown
    assert "[[windows]]" in shown


def test_spikes_of_a_torque_in_volts_are_listed_without_a_trial():
    """Ripple of the shaft with spikes of one height has two levels and an even period, as a train has."""
    chirp = signals.chirp(0.01, 1.5, 240.0, 40.0, rate_hz=2000.0)
    log, _ = simulate_raw_log(Vessel.load("stan-tug-1205"), chirp, seed=0)
    found = inspect_log(log)
    assert "U_torque" in {fault["channel"] for fault in found.faults if fault["kind"] == "spike"}
    assert {one.channel.name for one in found.channels if one.pulses_hz} == {"PTM_1", "PTM_4", "PTM_e"}
