"""What the page writes into TRIAL.toml: what it knows, and not a comment less."""

import tomllib
from pathlib import Path

import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.trial import Trial
from shipfp_rs.view.draft import (
    Draft,
    DraftCalibration,
    DraftChannel,
    checked,
    factors,
    guessed,
    problems,
    read_draft,
    written,
)

DRAFT = {
    "name": "My trial",
    "vessel": "stan-tug-1205",
    "channels": [
        {"column": "n", "role": "set_point", "unit": "rpm", "calibration": {"scale": 1.0}},
        {"column": "M [x]", "role": "torque", "unit": "mV", "location": "brake",
         "calibration": {"table": [[0, 0], [1, 2], [3, 6.5]]}},
        {"column": "P", "role": "train", "pulses_per_rev": 4, "shaft": "propeller"},
    ],
    "steady_s": [1.0, 20.0],
    "windows": [
        {"name": "C1", "kind": "chirp", "start_s": 20.0, "stop_s": 90.0},
        {"name": "St1", "kind": "steps", "start_s": 100.0, "stop_s": 190.0},
    ],
}  # fmt: skip


def draft(**changes) -> Draft:
    return Draft.model_validate(DRAFT | changes)


def file_of(**changes) -> str:
    return written(draft(**changes), None, "my.csv")


def trial_of(**changes) -> Trial:
    return checked(file_of(**changes), "TRIAL.toml")


def read_back(folder: Path, text: str) -> Draft:
    (folder / "TRIAL.toml").write_text(text)
    return read_draft(folder / "TRIAL.toml")


def guess(units: dict[str, str]) -> list[DraftChannel]:
    return list(guessed([Channel(name, unit, 1.0, 1) for name, unit in units.items()]))


def test_a_new_file_is_the_commented_template_with_what_was_said(tmp_path):
    text = written(draft(), None, "my.csv", rate_hz=500.0)
    trial = checked(text, "TRIAL.toml")
    assert trial.trial.log == ("my.csv",)
    assert trial.trial.rate_hz == 500.0
    assert trial.channels.torque.location == "brake"
    assert trial.channels.torque.calibration.table == ((0.0, 0.0), (1.0, 2.0), (3.0, 6.5))
    assert list(trial.channels.tachos) == ["P"]
    assert [window.name for window in trial.windows] == ["C1", "St1"]
    assert trial.identify.torque is None  # the location says it
    assert text.count("#") > 40
    (tmp_path / "TRIAL.toml").write_text(text)
    assert Trial.load(tmp_path / "TRIAL.toml").operating_point.steady_s == (1.0, 20.0)


def test_what_was_written_is_read_back_and_written_the_same(tmp_path):
    text = file_of()
    assert written(read_back(tmp_path, text), text, "elsewhere.csv") == text


OWN = """\
# Friday's trial. Keep!
[trial]
name = "Friday"  # not the one before
vessel = "stan-tug-1205"
log = ["one.csv"]

[channels.set_point]
column = "n"
unit = "V"
calibration = { scale = -251.38, offset = -85.29 } # eq. 6.7
delay_s = 0.004   # of the amplifier

[channels.PTM_4] # the good one
column = "P"
pulses_per_rev = 4
shaft = "propeller"
hysteresis = 0.5

[operating_point]
n_e_rpm = 1184.0 # by hand

[[windows]]
# the first
name = "A"
start_s = 1
stop_s = 50

[[windows]]
name = "B" # the second
start_s = 60.5
stop_s = 90

[identify]
starts = 3 # enough

[identify.fixed]
tau_n = 1.17
"""


def test_signals_of_a_slow_log_are_no_faster_than_its_channels():
    rates_hz = {"n": 20.0, "M [x]": 10.0, "P": 1.0}
    assert checked(written(draft(), None, "my.csv", None, rates_hz), "TRIAL.toml").processing.rate_hz == 10.0
    fast = written(draft(), None, "my.csv", None, {"n": 200.0})
    assert checked(fast, "TRIAL.toml").processing.rate_hz == 50.0


def test_comments_and_what_the_page_does_not_know_stay(tmp_path):
    own = read_back(tmp_path, OWN)
    assert written(own, OWN, "x") == OWN
    changed = own.model_dump()
    changed["windows"][1]["stop_s"] = 95.5
    changed["channels"][1]["pulses_per_rev"] = 8
    changed["name"] = "Saturday"
    text = written(Draft.model_validate(changed), OWN, "x")
    assert text == OWN.replace("stop_s = 90\n", "stop_s = 95.5\n").replace(
        "pulses_per_rev = 4", "pulses_per_rev = 8"
    ).replace('"Friday"', '"Saturday"')


def test_a_window_more_or_less_leaves_the_others_comments(tmp_path):
    old = read_back(tmp_path, OWN).model_dump()
    more = {**old, "windows": [*old["windows"], {"name": "C", "start_s": 100.0, "stop_s": 120.0}]}
    text = written(Draft.model_validate(more), OWN, "x")
    assert "# the first" in text
    assert "# the second" in text
    assert [window["name"] for window in tomllib.loads(text)["windows"]] == ["A", "B", "C"]
    less = written(Draft.model_validate({**old, "windows": old["windows"][1:]}), OWN, "x")
    assert "# the first" not in less
    assert 'name = "B" # the second' in less
    assert tomllib.loads(less)["identify"]["fixed"] == {"tau_n": 1.17}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"channels": DRAFT["channels"][:2]}, "at least one table like"),
        ({"channels": DRAFT["channels"][1:]}, "channels.set_point: found nothing"),
        ({"steady_s": None}, "steady_s"),
        ({"windows": []}, "windows"),
        ({"channels": [*DRAFT["channels"], {**DRAFT["channels"][0], "column": "m"}]}, "found two channels, 'n' and 'm'"),
        ({"channels": [{**DRAFT["channels"][0], "unit": "V", "calibration": {}}, *DRAFT["channels"][1:]]}, "'n' from V to"),
    ],
)  # fmt: skip
def test_what_is_missing_is_told_in_a_line(changes, told):
    with pytest.raises(InputError) as raised:
        trial_of(**changes)
    assert told in str(raised.value)
    assert "\n" not in str(raised.value)


def test_names_of_channels_may_be_anything(tmp_path):
    name = 'a "b" [c] # <script>\\ ü'
    train = {"column": name, "role": "train", "pulses_per_rev": 2, "shaft": "engine"}
    channels = [*DRAFT["channels"][:2], train]
    assert trial_of(channels=channels).channels.tachos[name].column == name


def test_roles_are_guessed_from_names_and_units():
    units = {"U_setpoint": "V", "Motor torque": "Nm", "PTM_4": "V", "encoder": "deg/s", "time": ""}
    found = guess(units)
    assert {one.column: one.role for one in found} == {
        "U_setpoint": "set_point",
        "Motor torque": "torque",
        "PTM_4": "train",
        "encoder": "speed",
    }
    assert found[1].calibration.scale == 1.0
    assert found[1].location == "brake"
    assert found[0].calibration.scale is None


def test_a_speed_is_a_role_and_what_the_page_does_not_edit_stays(tmp_path):
    speed = {"column": "n_e", "role": "speed", "unit": "1/min"}
    text = file_of(channels=[*DRAFT["channels"][:2], speed])
    assert checked(text, "TRIAL.toml").channels.tachos["n_e"].kind == "speed"
    load = '[channels.load]\ncolumn = "P"\nunit = "kW"\nquantity = "power"\n'
    encoder = '[channels.disc]\ncolumn = "angle"\nunit = "deg"\nshaft = "engine"\n'
    more = text + load + encoder
    assert written(read_back(tmp_path, more), more, "my.csv") == more


def test_what_is_to_be_given_is_read_as_not_given(tmp_path):
    text = '[channels.set_point]\ncolumn = "U"\nunit = "V"\ncalibration = "to be given"\n'
    (channel,) = read_back(tmp_path, text).channels
    assert (channel.column, channel.calibration.scale) == ("U", None)


def test_a_load_and_a_command_are_guessed_written_and_read_as_init_does(tmp_path):
    units = {"n_set": "rpm", "Generator power": "kW", "n_e": "rpm"}
    found = guess(units)
    assert [(one.column, one.role) for one in found] == [
        *zip(units, ("set_point", "load", "speed"), strict=True)
    ]
    text = file_of(channels=[one.model_dump() for one in found])
    load = checked(text, "TRIAL.toml").channels.load
    assert (load.quantity, load.calibration.scale) == ("power", 1000.0)
    assert written(read_back(tmp_path, text), text, "my.csv") == text
    units = {"torque command": "Nm", "n_e": "rpm"}
    found = guess(units)
    assert [one.role for one in found] == ["command", "speed"]
    trial = trial_of(channels=[one.model_dump() for one in found])
    assert trial.channels.command.column == "torque command"


def test_a_speed_in_per_cent_is_guessed_asked_for_its_calibration_and_written_as_init_does(tmp_path):
    units = {"POD1_SPEED_REF_PCT": "%", "POD1_SPEED_ACT_PCT": "%", "TORQUE_ACT_PCT": "%"}
    found = [one.model_dump() for one in guess(units)]
    assert [one["role"] for one in found] == ["set_point", "speed", "torque"]
    found[0]["calibration"] = found[2]["calibration"] = {"scale": 20.0}
    with pytest.raises(InputError, match="'POD1_SPEED_ACT_PCT' from % to rpm"):
        trial_of(channels=found)
    found[1]["calibration"] = {"scale": 20.0}
    text = file_of(channels=found)
    speed = checked(text, "TRIAL.toml").channels.tachos["POD1_SPEED_ACT_PCT"]
    assert (speed.kind, speed.unit, speed.calibration.scale) == ("speed", "%", 20.0)
    again = read_back(tmp_path, text)
    assert again.channels[1].calibration.scale == 20.0
    assert written(again, text, "my.csv") == text
    assert [unit for unit in ("%", "V", "rpm", "rad/s") if factors(unit)["speed"]["asks"]] == ["%", "V"]


@pytest.mark.parametrize(
    "keys", ['unit = "%"\ncalibration = "to be given"', 'unit = "V"\ncalibration = { scale = 2.0 }']
)
def test_a_speed_that_a_calibration_leads_to_is_edited_and_its_other_keys_stay(tmp_path, keys):
    given = f'[channels.n]\ncolumn = "x"\n{keys}\nstd = 1.0 # by hand\n'
    (channel,) = read_back(tmp_path, given).channels
    assert channel.role == "speed"
    changed = channel.model_copy(update={"calibration": DraftCalibration(scale=3.0)})
    text = written(Draft(channels=(changed,)), given, "x")
    assert tomllib.loads(text)["channels"]["n"]["calibration"] == {"scale": 3.0, "offset": 0.0}
    assert "std = 1.0 # by hand" in text


def test_a_train_has_no_pulses_and_no_shaft_until_somebody_gives_them(tmp_path):
    """One pulse a turn of the engine, taken for granted, made an inertia of 16 out of 62."""
    (train,) = guessed([Channel("Shaft pulses", "V", 2000.0, 1)])
    assert (train.role, train.pulses_per_rev, train.shaft) == ("train", None, "")
    text = file_of(channels=[*DRAFT["channels"][:2], train.model_dump()])
    with pytest.raises(InputError, match="to be given"):
        checked(text, "TRIAL.toml")
    assert read_back(tmp_path, text).channels[-1] == train.model_copy(update={"name": "Shaft pulses"})


def test_all_that_is_missing_is_told_at_once_at_its_field_and_without_toml():
    channels = [
        {"column": "M", "role": "torque", "unit": "V"},
        {"column": "P", "role": "train"},
        {"column": "Q", "role": "train", "pulses_per_rev": 4, "shaft": "propeller"},
    ]
    wrong = draft(
        channels=channels, vessel="", steady_s=None, windows=[{"name": "A", "start_s": 9, "stop_s": 3}]
    )
    told = problems(written(wrong, None, "my.csv"), "TRIAL.toml")
    assert [one["at"] for one in told] == [
        "",
        "mark the steady stretch",
        "calibration of M",
        "pulses a turn of P",
        "shaft of P",
        "ship",
        "end of A",
    ]
    said = " ".join(one["text"] for one in told)
    assert "No channel is the set point yet." in said
    assert [part for part in ("[", "=", "_", ".toml", "found") if part in said] == []
    assert problems(OWN, "TRIAL.toml") == []  # keys that the page does not know count, too
    assert problems(file_of(), "TRIAL.toml") == []


def test_a_set_point_in_a_unit_of_speed_needs_no_calibration():
    (asked,) = guessed([Channel("n_set", "rev/s", 100.0, 1)])
    assert (asked.role, asked.calibration.scale) == ("set_point", 60.0)
    assert factors("rpm")["set_point"]["factor"] == 1.0
