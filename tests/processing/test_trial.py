"""TRIAL.toml says everything once; a slip in it is answered by one line that names the key."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.errors import InputError
from shipfp_rs.processing.trial import Identify, Trial
from shipfp_rs.runs.run import NO_TORQUE, run
from shipfp_rs.support.sentences import LANGUAGES
from shipfp_rs.support.toml import template, validated
from tests.cli.small_trial import SMALL, write_small_trial

TEMPLATE = template("TRIAL")


def load(tmp_path: Path, text: str) -> Trial:
    path = tmp_path / "TRIAL.toml"
    path.write_text(text)
    return Trial.load(path)


def test_the_template_is_valid_as_it_stands(tmp_path: Path) -> None:
    trial = load(tmp_path, TEMPLATE)
    assert list(trial.channels.tachos) == ["PTM_4", "PTM_e"]
    assert trial.trial.log == (str(tmp_path / "run.parquet"),)
    assert trial.operating_point.n_e_rpm is None


def test_the_templates_defaults_are_the_models_defaults(tmp_path: Path) -> None:
    stated = load(tmp_path, TEMPLATE)
    content = tomllib.loads(TEMPLATE)
    del content["processing"]
    assert Trial.model_validate(content).processing == stated.processing


def test_set_point_calibration_may_be_a_table(tmp_path: Path) -> None:
    text = TEMPLATE.replace(
        "{ scale = -251.38, offset = -85.29 }",
        "{ table = [[-3.0309, 676.74], [-4.035, 927.77], [-5.03475, 1184.4], [-6.0236, 1427.9]] }",
    )
    line = load(tmp_path, text).channels.set_point.calibration.calibration("rpm")
    assert line.scale == pytest.approx(-251.57, abs=0.005)


@pytest.mark.parametrize(("reference", "first"), [("log.parquet", "speed"), ("b/log.parquet", "load")])
def test_loggers_may_write_files_of_one_name(tmp_path: Path, reference: str, first: str) -> None:
    for folder, channel in (("a", "speed"), ("b", "load")):
        (tmp_path / folder).mkdir()
        log = fp.Log.from_arrays({channel: np.arange(50.0)}, rate_hz=10.0)
        log.write(tmp_path / folder / "log.parquet")
    text = TEMPLATE.replace('log = "run.parquet"  ', 'log = ["a/log.parquet", "b/log.parquet"]  ', 1)
    trial = load(tmp_path, f'{text}\n[align]\nreference = "{reference}"\n')
    (merged,) = trial.logs()
    assert list(merged.channels) == sorted(["speed", "load"], key=first.__ne__)


RESTING = "[channels.set_point]\nrpm = 1500.0\n\n"
LOAD = '[channels.load]\ncolumn = "P"\nunit = "kW"\nquantity = "power"\n\n'


def resting(text: str) -> str:
    """Return a template whose set point no logger recorded."""
    start, stop = text.index("[channels.set_point]"), text.index("# [channels.command]")
    return text[:start] + RESTING + LOAD + text[stop:]


def test_a_set_point_that_rests_is_as_long_as_the_load(tmp_path: Path) -> None:
    trial = load(tmp_path, resting(TEMPLATE))
    log = trial.completed(fp.Log.from_arrays({"P": np.arange(50.0)}, rate_hz=10.0))
    np.testing.assert_array_equal(log.read(trial.channels.driver.column, 1.0, 2.0), np.full(10, 1500.0))
    np.testing.assert_array_equal(log.read("P", 1.0, 2.0), np.arange(10.0, 20.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (LOAD, "", r"set_point\.rpm: found 1500.*\[channels\.load\]"),
        ("rpm = 1500.0", 'rpm = 1500.0\ncolumn = "n"', "rpm: found column as well"),
        ("rpm = 1500.0", "rpm = -1.0", "rpm: found -1"),
    ],
)
def test_a_set_point_rests_under_a_load_alone(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load(tmp_path, resting(TEMPLATE).replace(old, new))


def test_several_logs_share_the_windows(tmp_path: Path) -> None:
    text = TEMPLATE.replace('log = "run.parquet"  ', 'log = ["run1.parquet", "run2.parquet"]  ', 1)
    text = text.replace('n_e_rpm = "auto"', "n_e_rpm = 1183.8").replace('M_Nm = "auto"', "M_Nm = 1725.0")
    text += '\n[[windows]]\nname = "S2"\nlog = "run2.parquet"\nstart_s = 1\nstop_s = 2\n'
    trial = load(tmp_path, text)
    assert [w.name for w in trial.windows_of("elsewhere/run1.parquet")] == ["C11"]
    assert [w.name for w in trial.windows_of("run2.parquet")] == ["S2"]


def test_a_vessel_file_beside_the_trial_is_found(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("")
    trial = load(tmp_path, TEMPLATE.replace("stan-tug-1205", "mine.toml"))
    assert trial.trial.vessel == str(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[channels.set_point]",
            "[channels.setpoint]",
            r"channels\.setpoint: found an unknown table.*mean 'set_point'",
        ),
        ("scale = 1059.0, offset", "offset", r"channels\.torque\.calibration\.scale: found neither or both"),
        ("scale = 1059.0", "scale = 0.0", r"channels\.torque\.calibration\.scale: found 0"),
        ("stop_s = 600.0", "stop_s = 60.0", r"windows\.0\.stop_s: found 60, expected more than start_s, 100"),
        ("steady_s = [10.0, 70.0]", "", r"operating_point: found neither"),
        ("[10.0, 70.0]", "[70.0, 10.0]", r"operating_point\.steady_s: found \[70\.0, 10\.0\]"),
        ('n_e_rpm = "auto"', 'n_e_rpm = "automatic"', r"operating_point\.n_e_rpm: found 'automatic'"),
        ("start_s = 100.0", "start_s = 100.0\nlog = 'x.csv'", r"windows: found log 'x.csv' in 'C11'"),
        ('kind = "chirp"', 'kind = "chirp"\n[[windows]]\nname = "C11"', r"windows"),
        (
            'log = "run.parquet" ',
            'log = ["a.csv", "b.csv"] ',
            r'operating_point: found "auto" with several logs',
        ),
        (
            TEMPLATE[TEMPLATE.index("[channels.PTM_4]") : TEMPLATE.index("[operating_point]")],
            "",
            "no pulse train",
        ),
    ],
    ids=lambda text: text[:30],
)
def test_slips_are_named_by_their_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEMPLATE
    with pytest.raises(InputError, match=message) as caught:
        load(tmp_path, TEMPLATE.replace(old, new, 1))
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "TRIAL.toml") in str(caught.value)


def test_a_missing_trial_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"TRIAL\.toml"):
        Trial.load(tmp_path / "TRIAL.toml")


LOAD_ALONE = SMALL.replace("[channels.torque]", "[channels.load]").replace(
    'location = "gauge"', 'quantity = "torque"'
)


@pytest.mark.parametrize(
    ("told", "text", "said"),
    [
        ('torque = "brake"', SMALL,
         "torque: found 'brake' beside channels.torque.location = 'gauge', expected 'gauge'"),
        ('torque = "gauge"', LOAD_ALONE,
         "torque: found 'gauge' without a torque channel, expected a table [channels.torque]"),
        ('outputs = ["dn", "dM"]', LOAD_ALONE, "outputs: found 'dM' without a torque channel"),
    ],
)  # fmt: skip
def test_breakage_a5_a_trial_says_once_where_the_torque_was_measured(told, text, said):
    with pytest.raises(InputError) as caught:
        validated(tomllib.loads(text.replace("starts = 2", told)), Trial, "TRIAL.toml")
    assert f"identify.{said}" in str(caught.value)


def test_breakage_a5_a_run_without_a_torque_channel_says_so(tmp_path):
    write_small_trial(tmp_path)
    path = tmp_path / "TRIAL.toml"
    before, _, rest = SMALL.partition("[channels.torque]")
    path.write_text(before + rest[rest.index("[channels.speed]") :])
    found = run(path, tmp_path / "out")
    assert found.fingerprint.verdict[-1] == NO_TORQUE


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("windows.0.name", "", "windows.0.name: found an empty text, expected a text that is not empty"),
        ("windows.0.name", "x" * 100_000, "windows.0.name: found 100000 characters, expected at most 200 characters"),
        ("windows.0.kind", "chrip", "windows.0.kind: found 'chrip', expected one of steady, sine"),
        ("trial.log", "a\nb", "trial.log: found 'a\\nb', expected a text without control characters"),
        ("operating_point.steady_s", [1.0], "operating_point.steady_s: found [1.0], expected a list of more than 1"),
        (
            "operating_point.steady_s",
            [1.0, 2.0, 3.0],
            "operating_point.steady_s: found 3 values, expected a list of at most 2",
        ),
        ("channels.speed.pulses_per_rev", 10**20, "found 100000000000000000000, expected a number of at most 1e+15"),
        (
            "channels.speed.pulses_per_rev",
            10**9,
            "channels.speed.pulses_per_rev: found 1000000000, expected less than or equal",
        ),
        ("report.language", "fr", f"report.language: found 'fr', expected one of {', '.join(LANGUAGES)}"),
        ("trial.name", 3, "trial.name: found 3, expected a text in quotes"),
        ("identify.priors", {"g": []}, "identify.priors.g: found [], expected a list of more than 0"),
        ("channels.speed.threshold", 1e9, "channels.speed.threshold: found 1000000000.0, expected nothing: a"),
        ("channels.speed.level", "up", "channels.speed.level: found 'up', expected nothing: a source of kind"),
        ("trial.time_column", "t\u202e", "trial.time_column: found 't\\u202e', expected a text without control"),
        ("channels.a\tb", {}, "channels.a key: found 'a\\tb', expected a text without control"),
    ],
)  # fmt: skip
def test_breakage_d3_d4_values_beyond_sense_are_told_in_the_words_of_the_file(key, value, said):
    content = tomllib.loads(SMALL)
    owner = content
    *parts, last = key.split(".")
    for part in parts:
        owner = owner[int(part)] if isinstance(owner, list) else owner.setdefault(part, {})
    owner[last] = value
    with pytest.raises(InputError) as caught:
        validated(content, Trial, "TRIAL.toml")
    assert said in str(caught.value)
    assert "validation" not in str(caught.value)


KNOWN = """
[trial]
name = "Drive"
log = "log.parquet"
[channels.set_point]
column = "set point"
unit = "U/min"
[channels.torque]
column = "torque"
unit = "lbf ft"
location = "brake"
[channels.load]
column = "load"
unit = "kW"
quantity = "power"
[channels.rack]
column = "fuel"
unit = "%"
[channels.speed]
column = "speed"
unit = "rad/s"
[operating_point]
steady_s = [0.0, 9.0]
[[windows]]
name = "C1"
start_s = 10.0
stop_s = 60.0
"""


def test_units_of_speed_torque_and_power_need_no_calibration_and_one_speed_no_vessel(tmp_path):
    trial = load(tmp_path, KNOWN)
    channels = trial.channels
    lines = {channels.set_point: 1.0, channels.torque: 1.3558179, channels.load: 1e3, channels.rack: 1.0}
    assert {sensor.column: sensor.calibration.scale for sensor in lines} == {
        sensor.column: pytest.approx(scale) for sensor, scale in lines.items()
    }
    assert trial.trial.vessel == "direct-drive"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "U/min"', 'unit = "V"', "set_point.calibration: found nothing, expected channel 'set point' from V to rpm"),
        ('unit = "lbf ft"', 'unit = "mV"\ncalibration = "to be given"', "expected channel 'torque' from mV to Nm: {"),
        ('column = "torque"', 'column = "to be given"', "torque.column: found 'to be given', expected the name"),
        ('unit = "rad/s"', 'pulses_per_rev = "to be given"', "a whole number, the pulses in a turn, for channel 'speed'"),
        ('unit = "rad/s"', 'unit = "rad/s"\nshaft = "propeller"', "trial.vessel: found nothing beside channels.speed.shaft"),
        ('column = "load"', 'column = "torque"', "channels.load.column: found 'torque', which is channels.torque, too"),
        (KNOWN[KNOWN.index("[[windows]]") :], "", "windows: found none, expected one table [[windows]]"),
    ],
)  # fmt: skip
def test_what_no_unit_tells_is_asked_for_by_the_channel_s_name(tmp_path, old, new, words):
    assert old in KNOWN
    with pytest.raises(InputError, match=re.escape(words)) as raised:
        load(tmp_path, KNOWN.replace(old, new))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "written",
    [{"products": True}, {"starts": 1}, {"noise": "coloured"}, {"tied": {}}, {"seed": 0}],
    ids=lambda written: next(iter(written)),
)
def test_a_default_that_is_written_out_declares_no_structure(written):
    assert Identify.model_validate(written).chooses
    assert Identify.model_validate({"elements": {"twist": False}, **written}).chooses


@pytest.mark.parametrize(
    "written", [{"products": False}, {"starts": 2}, {"noise": "white"}, {"tied": {"vK_i": ["vK_p", 0.1]}}]
)
def test_what_the_full_ship_has_not_declares_the_structure(written):
    assert not Identify.model_validate(written).chooses
