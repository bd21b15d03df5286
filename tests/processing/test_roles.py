"""`init` writes a trial whatever it finds: roles by name in several languages, by unit, and by what a channel does."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli
from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.roles import guess_roles
from shipfp_rs.processing.trial import Trial

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
    assert "no set point found" in capsys.readouterr().out


def test_breakage_c7_init_writes_a_vessel_file(tmp_path: Path) -> None:
    assert cli.main(["init", str(tmp_path), "--vessel"]) == 0
    assert "[gearbox]" in (tmp_path / "vessel.toml").read_text()
    assert cli.main(["init", str(tmp_path), "--vessel"]) == 2


def test_a_load_is_told_by_name_and_unit_together() -> None:
    names = {"Engine load": "%", "Generator power": "kW", "n_set": "rpm", "Speed": "rpm", "Torque": "Nm"}
    log = Log.from_arrays(dict.fromkeys(names, np.arange(1.0, 9.0)), rate_hz=1.0, units=names)
    roles = guess_roles(log)
    assert (roles.load, roles.torque) == ("Generator power", "Torque")
