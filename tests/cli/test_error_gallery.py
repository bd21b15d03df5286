"""Forty slips that people make, each with the whole line it costs: what was found, what was expected, what to do."""

# ruff: noqa: E501 each line stands whole, as it is printed

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs import cli
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse, sine_response
from shipfp_rs.logs import formats, log
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.plausibility import require_sense
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.toml import template
from shipfp_rs.vessel.vessel import Vessel

LAUNCH = (Path(fp.__file__).parent / "data" / "vessels" / "stan-launch-804.toml").read_text(encoding="utf-8")
STEPS = fp.signals.steps([13.0], 1.0)


def ship(old: str, new: str) -> tuple[dict[str, str], list[str]]:
    """Return the file of a launch with one slip in it, and the command that meets it."""
    assert old in LAUNCH
    return {"my.toml": LAUNCH.replace(old, new)}, ["simulate", "my.toml"]


def trial(old: str, new: str) -> tuple[dict[str, str], list[str]]:
    """Return the template of a trial with one slip in it, and the command that meets it."""
    assert old in template("TRIAL")
    return {"TRIAL.toml": template("TRIAL").replace(old, new)}, ["run", "TRIAL.toml"]


COMMANDS: list[tuple[tuple[dict[str, str], list[str]], str]] = [
    (
        ship("n_e_rpm = 1300.0", "n_e_rpm = 21.667"),
        "my.toml: operating_point.n_e_rpm: found 21.667 rpm, expected 180 to 2700 rpm as this engine would have; rev/s for rpm? that is 1300 rpm",
    ),
    (
        ship("M_b_Nm = 222.93", "M_b_Nm = 0.22293"),
        "my.toml: operating_point.M_b_Nm: found 0.22293 Nm, expected 1.889 to 944.3 Nm as this engine would have; kNm for Nm? that is 222.9 Nm",
    ),
    (
        ship("efficiency = 0.95", "efficiency = 95.0"),
        "my.toml: gearbox.efficiency: found 95.0, expected a fraction of at most 1; percent? that is 0.95",
    ),
    (
        ship("thrust_deduction = 0.06", "thrust_deduction = 6.0"),
        "my.toml: propeller.thrust_deduction: found 6.0, expected a fraction of at most 1; percent? that is 0.06",
    ),
    (
        ship("diameter_m = 0.77", "diameter_m = 770.0"),
        "my.toml: propeller.diameter_m: found 770 m, expected 0.05 to 15 m as propellers would have; mm for m? that is 0.77 m",
    ),
    (
        ship("density_kg_m3 = 1000.0", "density_kg_m3 = 1.0"),
        "my.toml: water.density_kg_m3: found 1 kg/m3, expected 900 to 1100 kg/m3 as water would have; t/m3 for kg/m3? that is 1000 kg/m3",
    ),
    (
        ship("rated_speed_rpm = 1800.0", "rated_speed_rpm = 30.0"),
        "my.toml: engine.rated_speed_rpm: found 30 rpm, expected 40 to 2e+04 rpm as engines would have; rev/s for rpm? that is 1800 rpm",
    ),
    (
        ship("inertia_kg_m2 = 21.2", "inertia = 21.2"),
        "my.toml: shaft.inertia: found an unknown key, did you mean 'inertia_kg_m2'?",
    ),
    (
        ship("K_p = 10.0", 'K_p = "10"'),
        "my.toml: governor.K_p: found '10', expected a valid number, without quotes",
    ),
    (
        ship("g = -0.583", "g = 2.583"),
        "my.toml: operating_point.g: found 2.583, expected less than the propeller's torque exponent 2",
    ),
    (
        trial('location = "gauge"', 'location = "guage"'),
        "TRIAL.toml: channels.torque.location: found 'guage', expected 'gauge', 'brake' or 'shaft'",
    ),
    (
        trial("pulses_per_rev = 4", "pulses_per_rev = 4.0"),
        "TRIAL.toml: channels.PTM_4.pulses_per_rev: found 4.0, expected a valid integer",
    ),
    (
        trial("stop_s = 600.0", "stop_s = 60.0"),
        "TRIAL.toml: windows.0.stop_s: found 60, expected more than start_s, 100",
    ),
    (
        trial('log = "run.parquet"', 'logs = "run.parquet"'),
        "TRIAL.toml: trial.logs: found an unknown key, did you mean 'log'?",
    ),
    (
        trial('log = "run.parquet"', 'log = "run.prquet"'),
        "run.prquet: unknown log format '.prquet', expected one of .parquet, .pq, .feather, .arrow, .arrows, .csv, .txt, .tsv, .tab, .prn, .lvm, .log, .asc, .raw, .dat, .tdms, .d7d, .dxd, .mf4, .mdf, .h5, .hdf5, .mat, .blf, .trc, .json, .jsonl, .xml; did you mean '.parquet'?",
    ),
    (
        trial("[trial]", "[trial"),
        "TRIAL.toml: not TOML: Expected ']' at the end of a table declaration (at line 3, column 7)",
    ),
    (
        trial('vessel = "stan-tug-1205"', 'vessel = "stan-tug"'),
        "vessel 'stan-tug': found no built-in ship of this name, did you mean 'stan-tug-1205'? (a ship of your own is given by the path of its .toml file)",
    ),
    (
        ({}, ["simulate", "stan-launch-80"]),
        "vessel 'stan-launch-80': found no built-in ship of this name, did you mean 'stan-launch-804'? (a ship of your own is given by the path of its .toml file)",
    ),
    (
        ({}, ["simulate", "stan-launch-804", "--amplitude-rpm", "0.03"]),
        "--amplitude-rpm 0.03: expected more than 0.26 rpm; a fraction for rpm? that is 39 rpm",
    ),
    (
        ({}, ["simulate", "stan-launch-804", "--noise", "5"]),
        "--noise is 5 times the signal, expected at most 1; percent for a fraction? that is 0.05",
    ),
    (
        ({}, ["simulate", "stan-launch-804", "--amplitude-rpm", "1300"]),
        "excitation 'chirp': deviates by up to 1300 rpm from a set point of 1300 rpm, expected much less; give deviations, not the set point itself",
    ),
    (
        ({"log.csv": "time,torque\n0,1\n"}, ["convert", "log.csv", "out.csv"]),
        "log.csv: time column 'time' does not increase from row to row; give rate_hz (--rate)",
    ),
    (
        ({"log.zip": "PK"}, ["convert", "log.zip", "out.parquet"]),
        "log.zip: a compressed file, expected a log; unpack it first",
    ),
    (
        ({"log.csv": "torque\n1\n2\n3\n"}, ["convert", "log.csv", "out.parquet"]),
        "log.csv: no time base for 'torque': neither a column 'time' nor a rate; add the column or give rate_hz (--rate), or name the column of time (--time)",
    ),
    (
        ({"TRIAL.toml": template("TRIAL")}, ["inspect", "TRIAL.toml"]),
        "TRIAL.toml: a TRIAL.toml, expected the log first: shipfp inspect LOG TRIAL.toml",
    ),
    (
        ({"TRIAL.toml": "mine"}, ["init", "."]),
        "TRIAL.toml: exists already; rename it or choose another folder",
    ),
    (
        ({"SWEEP.toml": "[sweep]\ndraw = 10\n"}, ["sweep", "SWEEP.toml"]),
        "SWEEP.toml: sweep.draw: found an unknown key, did you mean 'draws'?",
    ),
    (({}, ["reproduce", "virtul"]), "No such command 'virtul'. Did you mean 'virtual'?; see shipfp --help"),
]


def experiment(**changes: object) -> Experiment:
    """Return ten samples of the launch at its operating point, with one thing changed."""
    content: dict = {
        "name": "C11",
        "rate_hz": 100.0,
        "signals": {"n_set": np.full(10, 1300.0), "n_e": np.full(10, 1300.0), "M_s": np.full(10, 635.8)},
        "operating_point": {"n_set": 1300.0, "n_e": 1300.0, "M_s": 635.8},
    }
    return Experiment(**(content | changes))


def response(factor: complex = 1.0, *, conjugate: bool = False, **changes: object) -> FrequencyResponse:
    """Return what the launch answers to slow sines, with one slip in it."""
    frequency = np.geomspace(0.002, 1.0, 12)
    model = fp.linearise(Vessel.load("stan-launch-804")).response(frequency, ("dn", "dM_b"))
    speed, torque = (np.conj(part) if conjugate else part for part in model)
    return FrequencyResponse("S", frequency, {"n_e": factor * speed, "M_b": torque}, **changes)


def fit(data: object) -> object:
    return fp.identify(data, fp.Structure.linear(products=True))


def calibrated(set_point: float, torque: float) -> None:
    """Meet the check that every window of a log passes through, the engine turning at 1184 rpm."""
    signals = {"n_set": np.full(9, set_point), "n_e": np.full(9, 1184.0), "M_g": np.full(9, torque)}
    require_sense("window 'C11'", signals, Vessel.load("stan-tug-1205"))


def deviations(percent: float) -> dict[str, np.ndarray]:
    return {"n_e": np.full(12, percent), "M_b": np.full(12, percent)}


CALLS: list[tuple[Callable[[], object], str]] = [
    (
        lambda: fp.simulate(Vessel.load("stan-launch-804"), STEPS, n_e_rpm=21.667),
        "vessel 'Stan Launch 804': set point is 21.667 rpm, expected one near 1800 rpm; rev/s for rpm? that is 1300 rpm",
    ),
    (
        lambda: fp.simulate(Vessel.load("stan-launch-804"), STEPS, noise={"n_e": 5.0}),
        "noise['n_e'] is 5 times the signal, expected at most 1; percent for a fraction? that is 0.05",
    ),
    (
        lambda: experiment(operating_point={"n_set": 1300.0, "n_e": 21.667}),
        "experiment 'C11': signal 'n_e' is 1300 on average, its operating point 21.667, expected both in rpm; is the operating point in rev/s for rpm?",
    ),
    (
        lambda: experiment(operating_point={"n_set": 1300.0, "M_s": 0.6358}),
        "experiment 'C11': signal 'M_s' is 635.8 on average, its operating point 0.6358, expected both in Nm; is the operating point in kNm for Nm?",
    ),
    (
        lambda: experiment(signals={"n_set": np.ones(10), "Ms": np.ones(10)}),
        "experiment 'C11': signal 'Ms' is unknown, did you mean 'M_s'?",
    ),
    (
        lambda: experiment(signals={"n_e": np.ones(10)}),
        "experiment 'C11': neither of 'n_set' and 'command' among ['n_e']; expected a governor's set point, or the command of a drive without one",
    ),
    (
        lambda: fit(response(2.0)),
        "'S': n_e follows the set point with a gain of 1.98 at its lowest frequencies, expected 1; peak to peak for amplitude? give both channels alike",
    ),
    (
        lambda: fit(response(conjugate=True)),
        "'S': n_e leads the set point by 0.0202 rad at 0.002 Hz, expected it to follow; the sign of the phase turned? give the complex conjugate",
    ),
    (
        lambda: response(phase_std=deviations(3.0), amplitude_std=deviations(0.01)),
        "response 'S': phase_std of 'n_e' is 3 at best, expected less than 1.81 at some frequency; degrees for radians?",
    ),
    (
        lambda: response(phase_std=deviations(0.1), amplitude_std=deviations(3.0)),
        "response 'S': amplitude_std of 'n_e' is 3 at best, expected less than 1 at some frequency; percent for a fraction?",
    ),
    (
        lambda: sine_response((1725.0, 80.0, -40.0), (1184.0, 76.0, 12.0)),
        "sine_response: the phases of output reach 40, expected radians; degrees for radians? convert them with numpy.radians",
    ),
    (
        lambda: calibrated(1184.0 / 60.0, 1725.0),
        "channels.set_point: 19.73 rpm on average in window 'C11', where the engine turns 1184 rpm; rev/s for rpm? check channels.set_point.calibration",
    ),
    (
        lambda: calibrated(1184.0, 1.725),
        "channels.torque: 1.725 Nm on average in window 'C11', where the engine's rating makes 4479 Nm; kNm for Nm? that is 1725; check unit and calibration",
    ),
    (
        lambda: calibrated(4 * 1184.0, 1725.0),
        "channels.set_point: 4736 rpm on average in window 'C11', where the engine turns 1184 rpm; a number of pulses wrong by 4? check pulses_per_rev of the pulse trains",
    ),
    (
        lambda: calibrated(1184.0 / 3.82, 1725.0),
        "channels.set_point: 309.9 rpm on average in window 'C11', where the engine turns 1184 rpm; the propeller's shaft for the engine's, or the other way round? check shaft of the pulse trains",
    ),
    (
        lambda: fp.Structure.linear().with_fixed(tau=1.17),
        "structure 'linear' has no parameter 'tau'; it has tau_n, g, v, K_p, K_i, p; did you mean 'tau_n'?",
    ),
    (
        lambda: fp.Structure.linear(dead_time_loop=True).with_fixed(T_d=120.0),
        "parameter T_d: fixed at 120 s, expected 0 to 0.5 s; ms for s? that is 0.12 s",
    ),
    (
        lambda: fp.signals.chirp(0.01, 60.0, 100.0, 13.0),
        "stop_hz is 60 Hz, expected less than half of rate_hz 100; sample faster",
    ),
    (
        lambda: Log.from_arrays({"U_torque": np.zeros(9)}, rate_hz=9.0).read("torque"),
        "memory: no channel 'torque', found U_torque; did you mean 'U_torque'?",
    ),
    (
        lambda: Calibration.from_table([1.0, 1.0], [2.0, 3.0]),
        "calibration table: expected finite numbers and at least two different readings",
    ),
]


@pytest.mark.parametrize(("given", "line"), COMMANDS)
def test_a_slip_at_the_command_line_costs_one_line_and_writes_nothing(
    given: tuple[dict[str, str], list[str]], line: str, tmp_path, monkeypatch, capsys
) -> None:
    files, arguments = given
    monkeypatch.chdir(tmp_path)
    # Other tests register readers of their own, which would stand among those expected.
    for suffix in set(log._READERS) - set(formats.MODULES):
        monkeypatch.delitem(log._READERS, suffix)
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    status = cli.main(arguments)
    told = capsys.readouterr()
    assert told.err == f"shipfp: error: {line}\n"
    assert (status, told.out) == (2, "")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == files


@pytest.mark.parametrize(("call", "line"), CALLS)
def test_a_slip_in_python_costs_one_line(call: Callable[[], object], line: str) -> None:
    with pytest.raises(fp.InputError) as caught:
        call()
    assert str(caught.value) == line


@pytest.mark.parametrize("line", [line for _, line in [*COMMANDS, *CALLS]])
def test_every_line_says_what_was_expected_or_what_to_do(line: str) -> None:
    assert "\n" not in line
    assert re.search(
        r"expected|did you mean|give |choose|check |unpack|rename|sample faster|--help", line, re.IGNORECASE
    )


def test_the_same_calls_without_the_slip_pass() -> None:
    fit(response())
    experiment()
    calibrated(1184.0, 1725.0)
    response(phase_std=deviations(0.1), amplitude_std=deviations(0.01))
    sine_response((1725.0, 80.0, -0.7), (1184.0, 76.0, 0.2))
    fp.simulate(Vessel.load("stan-launch-804"), STEPS, n_e_rpm=1300.0, noise={"n_e": 0.05})
