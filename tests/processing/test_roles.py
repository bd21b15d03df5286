"""`init` writes a trial whatever it finds: roles by name in several languages, by unit, and by what a channel does."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli
from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.roles import guess_roles
from shipfp_rs.processing.trial import Trial
from tests.cli.small_trial import refused

DRAW = np.random.default_rng(3)


@pytest.mark.parametrize(
    ("set_point", "torque", "speed"),
    [
        ("n_set", "Torque", "n_e"),
        ("Drehzahl Sollwert", "Drehmoment", "Drehzahl"),
        ("gewenst toerental", "askoppel", "toerental"),
        ("consigne", "couple arbre", "régime moteur"),
        ("setpunkt varvtal", "vridmoment", "varvtal"),
        ("consigna", "par motor", "velocidad"),
    ],
)
def test_roles_by_name(set_point: str, torque: str, speed: str) -> None:
    names = [torque, speed, set_point, "T_oil"]
    units = {speed: "rpm", set_point: "rpm", "T_oil": "°C"}
    log = Log.from_arrays(dict.fromkeys(names, np.arange(1.0, 9.0)), rate_hz=1.0, units=units)
    roles = guess_roles(log)
    assert (roles.set_point, roles.torque, [*roles.speeds]) == (set_point, torque, [speed])
    assert roles.reasons["T_oil"] == "not known by name or unit"


def test_what_leads_is_the_set_point() -> None:
    steps = np.repeat(DRAW.normal(0.0, 1.0, 60), 200)
    late = np.roll(steps, 40)
    followed = np.convolve(late, np.ones(30) / 30, mode="same")
    log = Log.from_arrays({"CH1": followed, "CH2": steps, "CH3": 2.0 * followed}, rate_hz=100.0)
    roles = guess_roles(log)
    assert roles.set_point == "CH2"
    assert "2 other channels follow its changes" in roles.reasons["CH2"]


def test_breakage_c3_init_writes_whatever_it_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log.csv").write_text(
        "Zeit [s];CH1;CH2\n" + "".join(f"{k / 10:.1f};{k % 7};1\n" for k in range(50))
    )
    assert cli.main(["init", str(tmp_path), "--log", str(tmp_path / "log.csv")]) == 0
    text = (tmp_path / "TRIAL.toml").read_text()
    assert "# CH1, 10 Hz: not known by name or unit" in text
    assert "# No set point was found: name its channel below." in text
    with pytest.raises(InputError, match=r"channels\.set_point\.column: found 'to be given'"):
        Trial.load(tmp_path / "TRIAL.toml")
    told = " ".join(capsys.readouterr().out.split())
    assert "no set point found: name its channel in the file, or with --set-point" in told


def test_breakage_c7_init_writes_a_vessel_file(tmp_path: Path) -> None:
    assert cli.main(["init", str(tmp_path), "--vessel"]) == 0
    assert "[gearbox]" in (tmp_path / "vessel.toml").read_text()
    assert cli.main(["init", str(tmp_path), "--vessel"]) == 2


def test_a_load_is_told_by_name_and_unit_together() -> None:
    names = {"Engine load": "%", "Generator power": "kW", "n_set": "rpm", "Speed": "rpm", "Torque": "Nm"}
    log = Log.from_arrays(dict.fromkeys(names, np.arange(1.0, 9.0)), rate_hz=1.0, units=names)
    roles = guess_roles(log)
    assert (roles.load, roles.torque) == ("Generator power", "Torque")


@pytest.mark.parametrize("command", ["check", "run"])
def test_what_no_log_tells_is_asked_for_by_the_name_of_its_channel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    time = np.arange(0.0, 60.0, 0.02)
    asked = -5.0 + 0.1 * np.sin(np.where((time > 20) & (time < 50), 2 * np.pi * 0.3 * time, 0.0))
    asked += DRAW.normal(0.0, 1e-3, len(time))
    channels = {"U_soll": asked, "Drehmoment": 800.0 + asked, "Drehzahl": 1200.0 - 200.0 * (asked + 5.0)}
    log = Log.from_arrays(
        channels, rate_hz=50.0, units={"U_soll": "V", "Drehmoment": "Nm", "Drehzahl": "rpm"}
    )
    log.write(tmp_path / "log.parquet")
    assert cli.main(["init", str(tmp_path), "--log", str(tmp_path / "log.parquet")]) == 0
    assert "Give what is marked 'to be given' (1)" in " ".join(capsys.readouterr().out.split())
    out = ["--out", str(tmp_path / "result")] if command == "run" else []
    line = refused([command, str(tmp_path / "TRIAL.toml"), *out], capsys)
    assert "set_point.calibration: found 'to be given', expected channel 'U_soll' from V to rpm: {" in line
    assert not (tmp_path / "result").exists()


@pytest.mark.parametrize(
    ("names", "set_point", "torque", "speeds", "location"),
    [
        ({"MotorVelocitySet": "rpm", "feedback_deg_s": "", "Motor torque": "Nm"}, 0, 2, [1], "brake"),
        ({"Moment_set": "Nm", "Sollgeschwindigkeit": "U/min", "Geschwindigkeit": "U/min", "DMS": "kNm"}, 1, 3, [2], "gauge"),
        ({"speed_cmd": "rad/s", "encoder": "rad/s", "torque_sensor": "N m", "load_torque": "N m"}, 0, 2, [1], "gauge"),
        ({"nSoll": "1/min", "nIst": "1/min", "MIst Motor": "Nm", "Pgen Last": "kW"}, 0, 2, [1], "brake"),
        ({"Hastighet referanse": "o/min", "Hastighet målt": "o/min", "Dreiemoment aksel": "Nm"}, 0, 2, [1], "gauge"),
        ({"Régime demandé": "tr/min", "Régime": "tr/min", "Couple moteur": "N.m", "Réseau": "kW"}, 0, 2, [1], "brake"),
        ({"Wind": "m/s", "Speed over ground": "kn", "Engine speed": "rpm", "Speed demand": "rpm"}, 3, None, [2], "gauge"),
    ],
)  # fmt: skip
def test_names_and_units_go_before_what_a_channel_does(
    names: dict[str, str], set_point: int, torque: int | None, speeds: list[int], location: str
) -> None:
    called = list(names)
    log = Log.from_arrays(dict.fromkeys(names, np.linspace(1.0, 2.0, 400)), rate_hz=50.0, units=names)
    roles = guess_roles(log, lambda name: pytest.fail(f"{name} is looked at"))
    assert roles.set_point == called[set_point]
    assert roles.torque == (None if torque is None else called[torque])
    assert [*roles.speeds] == [called[index] for index in speeds]
    assert roles.location == location


def test_a_load_s_motion_makes_windows_where_the_set_point_stands_still(tmp_path: Path) -> None:
    time = np.arange(0.0, 120.0, 0.02)
    load = 100.0 + np.where(
        (time > 30.0) & (time < 100.0), 20.0 * np.sign(np.sin(2.0 * np.pi * time / 30.0)), 0.0
    )
    speed = 1500.0 - 0.1 * (load - 100.0) + DRAW.normal(0.0, 0.05, len(time))
    channels = {
        "Set point": np.full(len(time), 1500.0),
        "Speed": speed,
        "Generator power": load + DRAW.normal(0.0, 0.1, len(time)),
    }
    units = {"Set point": "rpm", "Speed": "rpm", "Generator power": "kW"}
    Log.from_arrays(channels, rate_hz=50.0, units=units).write(tmp_path / "log.parquet")
    assert cli.main(["init", str(tmp_path), "--log", str(tmp_path / "log.parquet")]) == 0
    (window,) = Trial.load(tmp_path / "TRIAL.toml").windows
    assert window.kind == "steps"
    assert (window.start_s, window.stop_s) == (pytest.approx(30.0, abs=1.0), pytest.approx(100.0, abs=15.0))


def rpm_log(**channels: tuple[float, str]) -> Log:
    arrays = {name: np.full(2000, level) for name, (level, _) in channels.items()}
    return Log.from_arrays(arrays, rate_hz=50.0, units={name: unit for name, (_, unit) in channels.items()})


def test_a_known_speed_tells_the_pulses_in_a_turn() -> None:
    log = rpm_log(n_set=(1200.0, "rpm"), pickup=(0.0, "V"), reflectors=(0.0, "V"))
    roles = guess_roles(log, {"pickup": 160.0, "reflectors": 23.1}.get)
    assert roles.pulses == {"pickup": 8}
    assert set(roles.trains) == {"pickup", "reflectors"}


def test_a_speed_behind_a_gear_is_left_out_or_wants_a_vessel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = guess_roles(rpm_log(n_set=(1200.0, "rpm"), n_engine=(1200.4, "rpm"), n_prop=(351.0, "rpm")))
    assert both.speeds == {"n_engine": "engine"}
    assert "not used, since no vessel file tells the gear" in both.reasons["n_prop"]
    rpm_log(n_set=(1200.0, "rpm"), n_prop=(351.0, "rpm")).write(tmp_path / "log.parquet")
    assert cli.main(["init", str(tmp_path), "--log", str(tmp_path / "log.parquet")]) == 0
    path = tmp_path / "TRIAL.toml"
    window = '\n[[windows]]\nname = "W1"\nstart_s = 1.0\nstop_s = 30.0\n'
    path.write_text(path.read_text().replace("# No window was found", f"{window}# No window was found"))
    assert cli.main(["check", str(path)]) == 2
    assert "trial.vessel: found nothing beside channels.n_prop.shaft" in capsys.readouterr().err


def test_the_torque_of_a_shaft_is_the_load_where_no_set_point_moves_and_pitch_is_none() -> None:
    channels = {"EEC1.EngineSpeed": (1600.0, "rpm"), "EEC1.ActualEngPercentTorque": (57.0, "%"),
                "ShaftTorque": (11.0, "kNm"), "PitchCommand": (70.0, "%"), "PitchFeedback": (70.0, "%")}  # fmt: skip
    roles = guess_roles(rpm_log(**channels))
    assert (roles.set_point, roles.torque, roles.load) == (None, "EEC1.ActualEngPercentTorque", "ShaftTorque")
    assert roles.location == "brake"
    resting = guess_roles(rpm_log(**channels, n_set=(1600.0, "rpm")))
    assert (resting.set_point, resting.load) == ("n_set", "ShaftTorque")
    lever = guess_roles(rpm_log(EngineSpeed=(1600.0, "rpm"), EngineCommand=(70.0, "%")))
    assert lever.set_point == "EngineCommand"
