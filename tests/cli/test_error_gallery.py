"""Slips that people make, each with words of the line it costs: where it is, and what to do."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse, sine_response
from shipfp_rs.logs.log import Log
from shipfp_rs.support.toml import template
from shipfp_rs.support.units import Calibration
from tests.cli.small_trial import SWEEP, refused

LAUNCH = (Path(fp.__file__).parent / "data" / "vessels" / "stan-launch-804.toml").read_text(encoding="utf-8")
SHIP = fp.Vessel.load("stan-launch-804")
STEPS = fp.signals.steps([13.0], 1.0)


def ship(old: str, new: str) -> tuple[dict[str, str], list[str]]:
    """Return the file of a launch with one slip in it, and the command that meets it."""
    assert old in LAUNCH
    return {"my.toml": LAUNCH.replace(old, new, 1)}, ["simulate", "my.toml"]


def trial(old: str, new: str) -> tuple[dict[str, str], list[str]]:
    """Return the template of a trial with one slip in it, and the command that meets it."""
    assert old in template("TRIAL")
    return {"TRIAL.toml": template("TRIAL").replace(old, new)}, ["run", "TRIAL.toml"]


def sweep(old: str, new: str) -> tuple[dict[str, str], list[str]]:
    """Return a sweep with one slip in it, and the command that meets it."""
    text = SWEEP.replace("high = 2.0 }", "high = 2.0, points = 9 }")
    assert old in text
    return {"SWEEP.toml": text.replace(old, new)}, ["sweep", "SWEEP.toml", "--out", "out"]


def designed(line: str, vessel: str = "stan-tug-1205") -> tuple[dict[str, str], list[str]]:
    """Return a plan of a trial as it is asked for."""
    return {}, ["design", vessel, *line.split(), "--out", "plan"]


def typed(line: str, files: dict[str, str] | None = None) -> tuple[dict[str, str], list[str]]:
    """Return files that are there, and a command as it is typed."""
    return files or {}, line.split()


COMMANDS = [
    (ship("n_e_rpm = 1300.0", "n_e_rpm = 21.667"), "operating_point.n_e_rpm", "rev/s for rpm?"),
    (ship("M_b_Nm = 222.93", "M_b_Nm = 0.22293"), "operating_point.M_b_Nm", "kNm for Nm?"),
    (ship("efficiency = 0.95", "efficiency = 95.0"), "gearbox.efficiency", "percent?"),
    (ship("thrust_deduction = 0.06", "thrust_deduction = 6.0"), "propeller.thrust_deduction", "percent?"),
    (ship("diameter_m = 0.77", "diameter_m = 770.0"), "propeller.diameter_m", "mm for m?"),
    (ship("density_kg_m3 = 1000.0", "density_kg_m3 = 1.0"), "water.density_kg_m3", "t/m3 for kg/m3?"),
    (ship("rated_speed_rpm = 1800.0", "rated_speed_rpm = 30.0"), "engine.rated_speed_rpm", "rev/s for rpm?"),
    (ship("inertia_kg_m2 = 21.2", "inertia = 21.2"), "shaft.inertia", "mean 'inertia_kg_m2'?"),
    (ship("K_p = 10.0", 'K_p = "10"'), "governor.K_p", "without quotes"),
    (ship("inertia_kg_m2 = 21.2", "inertia_kg_m2 = 1e9"), "shaft.inertia_kg_m2: found 1e+09, with which", "in 7.14e+07 s"),
    (ship("ratio = 3.0", "ratio = nan"), "gearbox.ratio: found nan, expected "),
    (ship("efficiency = 0.95", "efficiency = 1.05"), "gearbox.efficiency: found 1.05, expected less than or equal to 1"),
    (ship("side_inertia_kg_m2 = 2.81", "side_inertia_kg_m2 = 28.1"), "found 28.1, expected at most inertia_kg_m2, 21.2"),
    (ship("g = -0.583", "g = 2.0"), "operating_point.g: found 2, expected less than the propeller's torque exponent 2"),
    (ship("v = 1.583", "v = 0"), "operating_point.v: found 0, expected greater than or equal to 0.01"),
    (ship("M_b_Nm = 222.93", "M_b_Nm = 222.93\nM_s_Nm = 635.0"), "M_b_Nm: found both M_b_Nm and M_s_Nm, expected one"),
    (ship("600.0, 900.0", "900.0, 600.0"), "engine.envelope.speed_rpm: found 600 after 900, expected ascending speeds"),
    (ship("600.0, 900.0", "900.0"), "engine.envelope.torque_Nm: found 6 values, expected 5 as in speed_rpm"),
    (
        ship("240.0, 340.0, 400.0, 446.0", "200.0, 200.0, 200.0, 200.0"),
        "engine.envelope.torque_Nm: found 200 Nm at 1300 rpm, expected more than the operating point's",
    ),
    (ship("472.0, 472.0", "472.0, 600.0"), "found 600 Nm at 1800 rpm, 113.1 kW, expected at most the rated 89 kW"),
    (
        ship("cylinders = 4", "cylinders = 4\nminimum_torque_Nm = 300.0"),
        "engine.minimum_torque_Nm: found 300, expected less than the operating point's brake torque 222.9 Nm",
    ),
    (trial("pulses_per_rev = 4", "pulses_per_rev = 4.0"), "channels.PTM_4.pulses_per_rev", "valid integer"),
    (trial('log = "run.parquet"', 'logs = "run.parquet"'), "trial.logs", "mean 'log'?"),
    (trial('log = "run.parquet"', 'log = "run.prquet"'), "unknown log format '.prquet'", "mean '.parquet'?"),
    (trial("[trial]", "[trial"), "TRIAL.toml: not TOML: Expected ']'"),
    (trial('vessel = "stan-tug-1205"', 'vessel = "stan-tug"'), "'stan-tug'", "mean 'stan-tug-1205'?"),
    (typed("simulate stan-launch-80"), "'stan-launch-80'", "mean 'stan-launch-804'?"),
    (typed("simulate stan-launch-804 --amplitude-rpm 0.03"), "--amplitude-rpm 0.03", "as a fraction of the speed"),
    (typed("simulate stan-launch-804 --noise 5"), "--noise is 5 times the signal", "percent for a fraction?"),
    (typed("simulate stan-launch-804 --amplitude-rpm 1300"), "deviates by up to 1300 rpm", "give deviations"),
    (typed("convert log.csv out.csv", {"log.csv": "time,torque\n0,1\n"}), "1 row of samples", "expected 2 or more"),
    (typed("convert log.zip out.parquet", {"log.zip": "PK"}), "a compressed file", "unpack it first"),
    (typed("convert log.csv out.parquet", {"log.csv": "torque\n1\n2\n3\n"}), "no time base", "give rate_hz (--rate)"),
    (typed("inspect TRIAL.toml", {"TRIAL.toml": template("TRIAL")}), "a TRIAL.toml", "shipfp inspect LOG TRIAL.toml"),
    (typed("init .", {"TRIAL.toml": "mine"}), "TRIAL.toml: exists already", "rename it"),
    (typed("sweep SWEEP.toml", {"SWEEP.toml": "[sweep]\ndraw = 10\n"}), "SWEEP.toml: sweep.draw", "mean 'draws'?"),
    (typed("reproduce virtul"), "Did you mean 'virtual'?; see shipfp reproduce --help"),
    (typed("inti"), "No such command 'inti'", "see shipfp --help"),
    (typed("init log.csv", {"log.csv": "t,n"}), "found a file", "shipfp init --log log.csv"),
    (typed("init a b"), "see shipfp init --help"),
    (typed("init --speed"), "see shipfp init --help"),
    (typed("simulate missing.toml"), "missing.toml"),
    (typed("simulate stan-tug-1205 --duration -1"), "'--duration': found '-1'"),
    (typed("simulate stan-tug-1205 --excitation noise"), "'--excitation'", "see shipfp simulate --help"),
    (typed("simulate stan-tug-1205 --raw --noise 0.1"), "--noise: expected none with --raw"),
    (typed("simulate stan-tug-1205 --out log.csv"), "--out log.csv: expected a name that ends in .parquet"),
    (typed("simulate stan-tug-1205 --amplitude-rpm 0"), "'--amplitude-rpm': found '0'"),
    (sweep("duration_s = 10.0", "duration_s = 1e14"), "found 1e+14 s at 20 Hz, expected at most 5000000 samples a draw"),
    (sweep("draws = 2", "draws = 1000000000000"), "draws: found 1000000000000, expected less than or equal to 10000000"),
    (sweep('noise = "white"', "starts = 1000000000"), "identify.starts: found 1000000000, expected less"),
    (sweep("draws = 2", 'design = "grid"\nrepeats = 9999999'), "expected at most 10000000 draws"),
    (sweep("draws = 2", 'draws = 2\nname = ""'), "sweep.name: found an empty text"),
    (designed(""), "neither --duration nor --accuracy"),
    (designed("--accuracy nan"), "--accuracy"),
    (designed("--duration -1"), "--duration"),
    (designed("--duration 1e12"), "samples"),
    (designed("--duration 100", "stan-tug-1206"), "did you mean 'stan-tug-1205'"),
    (designed("--duration 100 --avoid 3"), "--avoid: found '3', expected LOW:HIGH"),
    (designed("--duration 100 --avoid 5:1"), "--avoid: found '5:1'"),
    (designed("--duration 100 --avoid 0:100"), "--avoid"),
    (designed("--duration 100 --amplitude 2000"), "--amplitude is 2000"),
    (designed("--duration 100 --kind squares --avoid 2:3"), "'squares' jumps"),
    (designed("--duration 30"), "settling time"),
    (designed("--duration 100 --rate-limit 1.5", "stan-launch-804"), "no zero crossing in"),
    (designed("--duration 100 --longest 10"), "--longest is 10"),
    (designed("--duration 100 --volts 0:5"), "expected 0 to 5 V"),
    (designed("--duration 100 --volts nan:1"), "--volts: found 'nan:1'"),
    (designed("--accuracy 3 --parameter T_M2"), "'T_M2' is not identifiable here"),
    (designed("--duration 100 --parameter %s{}"), "--parameter: found without --accuracy"),
    (designed("--duration 100 --torque-noise 1e15"), "--torque-noise is 1e+15, expected 1e-07 to 100"),
    (designed("--duration 100", "missing.json"), "missing.json"),
]  # fmt: skip


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
    model = fp.linearise(SHIP).response(frequency, ("dn", "dM_b"))
    speed, torque = (np.conj(part) if conjugate else part for part in model)
    return FrequencyResponse("S", frequency, {"n_e": factor * speed, "M_b": torque}, **changes)


def fit(data: object) -> object:
    return fp.identify(data, fp.Structure.linear(products=True))


def deviations(percent: float) -> dict[str, np.ndarray]:
    return {"n_e": np.full(12, percent), "M_b": np.full(12, percent)}


CALLS = [
    (lambda: fp.simulate(SHIP, STEPS, n_e_rpm=21.667), "'Stan Launch 804': set point", "rev/s for rpm?"),
    (lambda: fp.simulate(SHIP, STEPS, noise={"n_e": 5.0}), "noise['n_e'] is 5 times the signal", "percent for a fraction?"),
    (lambda: experiment(operating_point={"n_set": 1300.0, "n_e": 21.667}), "signal 'n_e'", "rev/s for rpm?"),
    (lambda: experiment(operating_point={"n_set": 1300.0, "M_s": 0.6358}), "signal 'M_s'", "kNm for Nm?"),
    (lambda: experiment(signals={"n_set": np.ones(10), "Ms": np.ones(10)}), "signal 'Ms' is unknown", "mean 'M_s'?"),
    (lambda: experiment(signals={"n_e": np.ones(10)}), "neither of 'n_set' and 'command'", "a governor's set point"),
    (lambda: fit(response(2.0)), "'S': n_e follows the set point", "peak to peak for amplitude?"),
    (lambda: fit(response(conjugate=True)), "'S': n_e leads the set point", "give the complex conjugate"),
    (
        lambda: response(phase_std=deviations(3.0), amplitude_std=deviations(0.01)),
        "response 'S': phase_std of 'n_e'",
        "degrees for radians?",
    ),
    (
        lambda: response(phase_std=deviations(0.1), amplitude_std=deviations(3.0)),
        "response 'S': amplitude_std of 'n_e'",
        "percent for a fraction?",
    ),
    (
        lambda: sine_response((1725.0, 80.0, -40.0), (1184.0, 76.0, 12.0)),
        "sine_response: the phases of output reach 40",
        "degrees for radians?",
    ),
    (lambda: fp.Structure.linear().with_fixed(tau=1.17), "has no parameter 'tau'", "mean 'tau_n'?"),
    (lambda: fp.Structure.linear(dead_time_loop=True).with_fixed(T_d=120.0), "parameter T_d: fixed at 120 s", "ms for s?"),
    (lambda: fp.signals.chirp(0.01, 60.0, 100.0, 13.0), "stop_hz is 60 Hz", "sample faster"),
    (
        lambda: Log.from_arrays({"U_torque": np.zeros(9)}, rate_hz=9.0).read("torque"),
        "memory: no channel 'torque'",
        "mean 'U_torque'?",
    ),
    (lambda: Calibration.from_table([1.0, 1.0], [2.0, 3.0]), "calibration table", "at least two different readings"),
]  # fmt: skip


def told_as(line: str, words: list[str]) -> None:
    """Require one line that says these words, what was expected or what to do."""
    assert line.strip("\n").count("\n") == 0
    assert [word for word in words if word not in line] == []
    todo = r"expected|did you mean|give |choose|check |unpack|rename|sample faster|make |shorten|--help"
    assert re.search(todo, line, re.I)


@pytest.mark.parametrize(("given", "words"), [(given, words) for given, *words in COMMANDS])
def test_a_slip_at_the_command_line_costs_one_line_and_writes_nothing(
    given, words, tmp_path, monkeypatch, capsys
) -> None:
    files, arguments = given
    monkeypatch.chdir(tmp_path)
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    line = refused(arguments, capsys)
    told_as(line, words)
    assert not re.search("_pct|_rpm ", line)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == files


@pytest.mark.parametrize(("call", "words"), [(call, words) for call, *words in CALLS])
def test_a_slip_in_python_costs_one_line(call, words) -> None:
    with pytest.raises(fp.InputError) as caught:
        call()
    told_as(str(caught.value), words)


def test_the_same_calls_without_the_slip_pass() -> None:
    fit(response())
    experiment()
    response(phase_std=deviations(0.1), amplitude_std=deviations(0.01))
    sine_response((1725.0, 80.0, -0.7), (1184.0, 76.0, 0.2))
    fp.simulate(SHIP, STEPS, n_e_rpm=1300.0, noise={"n_e": 0.05})
