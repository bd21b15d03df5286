"""What a user types first: a channel by name, a log or a frame as it is, a trial alone, a result printed."""

import inspect
import json
import re
import subprocess
import sys

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.parquet import experiment_of
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.simulation.raw_log import trial_toml
from shipfp_rs.support.hints import _guesses
from shipfp_rs.sweeps import Plan, Sweep
from shipfp_rs.sweeps.analysis import summarise

LAUNCH = fp.Vessel.load("stan-launch-804")
RATE_HZ = 100.0


@pytest.fixture(scope="module")
def experiment() -> fp.Experiment:
    return fp.simulate(LAUNCH, fp.signals.chirp(0.05, 5.0, 40.0, 13.0, rate_hz=RATE_HZ))


@pytest.fixture
def log() -> fp.Log:
    """Return a log of two loggers, of which one is slower and begins later."""
    fast = fp.Log.from_arrays({"tacho": np.arange(20.0)}, rate_hz=10.0, units={"tacho": "V"})
    slow = fp.Log.from_arrays({"torque": [5, 6]}, rate_hz=1.0, start_s=0.5, units={"torque": "kNm"})
    return fp.Log.merge(fast, slow, name="two loggers")


def test_a_log_gives_a_channel_by_its_name(log):
    np.testing.assert_array_equal(log["tacho"], log.read("tacho"))
    assert list(log) == ["tacho", "torque"]
    assert "tacho" in log
    with pytest.raises(InputError, match=r"no channel 'tocho'.*tacho"):
        log["tocho"]


def test_a_log_becomes_a_frame_at_the_times_of_all_channels(log):
    pytest.importorskip("pandas")
    frame = log.to_pandas()
    assert frame.index.name == "time_s"
    assert frame.attrs["units"] == {"tacho": "V", "torque": "kNm"}
    assert frame["torque"].dropna().to_dict() == {0.5: 5.0, 1.5: 6.0}
    np.testing.assert_array_equal(frame["tacho"], np.arange(20.0))
    assert log.to_pandas(["torque"])["torque"].dtype == np.int64
    with pytest.raises(InputError, match="no channel 'x'"):
        log.to_pandas(["x"])


def test_a_log_is_drawn_a_panel_a_channel(log):
    panels = fp.plot.log(log)
    assert [ax.get_ylabel() for ax in panels] == ["tacho [V]", "torque [kNm]"]
    np.testing.assert_array_equal(panels[1].lines[0].get_xdata(), [0.5, 1.5])
    long = fp.Log.from_arrays({"u_$": np.arange(3_000_000)}, rate_hz=1e4)
    (ax,) = fp.plot.log(long, ["u_$"])
    times, samples = ax.lines[0].get_data()
    assert len(times) < 10_000
    assert (times[0], times[-1], samples[-1]) == (0.0, 299.9999, 2_999_999)
    ax.figure.canvas.draw()
    with pytest.raises(InputError, match="1 axes given, expected 2"):
        fp.plot.log(log, axes=[ax])


def test_a_trial_alone_opens_its_own_log(tmp_path):
    chirp = fp.signals.chirp(0.05, 2.0, 30.0, 13.0, rate_hz=RATE_HZ)
    sensors = fp.Sensors()
    made, truth = fp.simulate_raw_log(LAUNCH, chirp, sensors=sensors, steady_s=10.0, pause_s=0.0, seed=1)
    made.write(tmp_path / "day.parquet")
    (tmp_path / "TRIAL.toml").write_text(trial_toml("stan-launch-804", "day.parquet", sensors, truth))
    trial = fp.Trial.load(tmp_path / "TRIAL.toml")
    assert fp.process(trial) == fp.process(trial.logs()[0], trial)
    assert (
        fp.process(tmp_path / "TRIAL.toml") == fp.process(str(tmp_path / "TRIAL.toml")) == fp.process(trial)
    )
    with pytest.raises(InputError, match="process: both arguments are trials"):
        fp.process(trial, trial)
    with pytest.raises(InputError, match="process: found no trial beside the log"):
        fp.process(made)


def test_an_experiment_is_read_as_a_dictionary_of_signals_and_written_as_csv(experiment, tmp_path):
    assert dict(experiment) == dict(experiment.items()) == experiment.signals
    assert [*experiment.keys()] == [*experiment]
    assert len(experiment.values()) == len(experiment.signals)
    assert experiment.get("M_load") is None
    assert experiment.get("n_e") is experiment["n_e"]
    pd = pytest.importorskip("pandas")
    read = pd.read_csv(experiment.to_csv(tmp_path / "signals.csv"), index_col=0)
    np.testing.assert_array_equal(read["n_e"], experiment["n_e"])
    assert (tmp_path / "signals.csv").read_text() == experiment.to_csv()


@pytest.mark.parametrize(("where", "guess"), [*_guesses()])
def test_a_name_of_another_package_is_refused_with_what_to_type_here(where, guess):
    owner = {"fp": fp, "Tabular": fp.Experiment, "Estimate": Estimate}.get(where) or getattr(fp, where)
    assert not hasattr(owner, guess)
    instead = _guesses()[where, guess].format(owner="experiment", name=guess)
    with pytest.raises(AttributeError) as caught:
        getattr(owner, guess)
    assert re.fullmatch(r".* has no attribute '\w+'; type .*", str(caught.value))
    owners = {"fp": fp, "experiment": fp.Experiment, "estimate": Estimate, "log": fp.Log}
    owners |= {"fingerprint": fp.Fingerprint, "vessel": fp.Vessel}
    for variable, names in re.findall(
        r'(?<!")\b(fp|experiment|fingerprint|estimate|log|vessel)((?:\.\w+)+)', instead
    ):
        thing = owners[variable]
        for name in names[1:].split(".")[: 1 if ".to_" in names else None]:
            fields = getattr(thing, "__dataclass_fields__", {})
            thing = fields[name] if name in fields else getattr(thing, name)


def test_a_misspelt_name_is_refused_with_the_nearest_one(experiment):
    for owner, name, near in (
        (fp, "idntify", "identify"),
        (LAUNCH, "inertias", "inertia"),
        (fp.Vessel, "name", "names"),
        (experiment, "durations", "duration"),
    ):
        with pytest.raises(AttributeError, match=f"has no attribute {name!r}; did you mean '{near}'"):
            getattr(owner, name)
    assert not hasattr(experiment, "_private")
    with pytest.raises(AttributeError, match=r'type experiment\["n_e"\]$'):
        experiment.n_e  # noqa: B018


@pytest.mark.parametrize("way", ["index", "time", "time_s", "spans"])
def test_a_frame_is_identified_by_the_names_of_its_columns(experiment, way):
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({name: experiment.signals[name] for name in ("n_set", "n_e", "M_s")})
    if way == "index":
        frame.index = experiment.time
    elif way == "spans":
        frame.index = pd.Timestamp("2024-05-01") + pd.to_timedelta(experiment.time, unit="s")
    else:
        frame[way] = experiment.time + 7.0
    read = experiment_of(frame)
    assert read.rate_hz == RATE_HZ
    assert list(read.signals) == ["n_set", "n_e", "M_s"]
    assert read.operating_point == {name: pytest.approx(frame[name].mean()) for name in read.signals}
    if way == "time":
        structure = fp.Structure.linear()
        assert fp.identify(frame, structure) == fp.identify(read, structure)


def test_a_frame_says_what_is_wrong_with_it(experiment):
    pd = pytest.importorskip("pandas")
    bare = pd.DataFrame({"n_set": experiment.signals["n_set"], "n_e": experiment.signals["n_e"]})
    with pytest.raises(InputError, match="a frame with neither a time as its index nor a column 'time'"):
        fp.identify(bare)
    with pytest.raises(InputError, match=r"signal 'M_S' is unknown, .*M_s"):
        fp.identify(bare.assign(time=experiment.time, M_S=1.0))
    with pytest.raises(InputError, match=r"expected an Experiment.*pandas\.DataFrame"):
        fp.identify(3.0)
    # What was written with its operating point keeps it.
    assert experiment_of(experiment.to_pandas()) == experiment


def test_pandas_is_not_loaded_before_it_is_asked_for():
    code = (
        "import sys, shipfp_rs as fp; fp.identify; fp.Log.from_arrays({'u': [1.0]}, rate_hz=1.0)['u']; "
        "assert 'pandas' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_sweep_prints_within_ten_lines(tmp_path):
    plan = Plan.load("duration")
    summary = summarise(plan, [])
    row = {"bias": 0.01, "spread": 0.1, "error_95": None, "coverage": 0.94}
    summary["parameters"] = {f"p_{k}": row for k in range(20)}
    text = str(Sweep(tmp_path, plan, summary))
    assert len(text.splitlines()) <= 10
    assert max(map(len, text.splitlines()[1:])) < 80
    assert "1 %" in text
    assert text.endswith("13 more in summary")
    summary["parameters"] = {"tau_n": row}
    assert len(repr(Sweep(tmp_path, plan, summary)).splitlines()) == 3


def test_a_fingerprint_gives_the_text_that_it_saves(experiment, tmp_path):
    fingerprint = fp.identify(experiment, fp.Structure.linear(), intervals="symmetric")
    text = fingerprint.to_json()
    assert fingerprint.save(tmp_path / "one.json").read_text() == text
    assert json.loads(text)["format"] == 1


def test_steps_fill_a_duration():
    told = fp.signals.steps([10.0, -20.0, 10.0], duration_s=31.0, lead_s=1.0, rate_hz=10.0)
    held = fp.signals.steps([10.0, -20.0, 10.0], 10.0, lead_s=1.0, rate_hz=10.0)
    np.testing.assert_array_equal(told.samples, held.samples)
    assert len(told.samples) == 310
    for arguments, said in [
        ({}, "found neither of hold_s and duration_s"),
        ({"hold_s": 1.0, "duration_s": 2.0}, "found both of hold_s and duration_s"),
        ({"duration_s": 1.0, "lead_s": 2.0}, "duration_s is 1 with lead_s = 2, expected longer"),
    ]:
        with pytest.raises(InputError, match=said):
            fp.signals.steps([10.0], **arguments)


def test_an_experiment_is_indexed_by_signal_and_by_seconds(experiment):
    assert experiment[10.0:20.0] == experiment.window(10.0, 20.0)
    assert len(experiment[:5.0]) + len(experiment[5.0:]) == len(experiment)
    assert "n_e" in experiment
    with pytest.raises(KeyError, match="no signal 'n'; found n_set, n_e"):
        experiment["n"]
    with pytest.raises(InputError, match="step 2"):
        experiment[0.0:10.0:2]


def test_experiments_and_excitations_draw_themselves(experiment):
    speed, _, torque, *_ = experiment.plot()
    assert speed.get_ylabel() == "speed [rpm]"
    assert torque.get_ylabel() == "torque [Nm]"
    (ax,) = fp.signals.steps([13.0], 10.0).plot()
    assert ax.get_ylabel() == "set-point deviation [rpm]"
    assert callable(fp.plot.signals)


def test_a_fingerprint_is_simulated_like_a_vessel(experiment):
    found = fp.identify(experiment, fp.Structure.linear(products=True), noise="white")
    step = fp.signals.steps([13.0], 20.0)
    assert fp.simulate(found, step)["n_e"].tolist() == found.simulate(step)["n_e"].tolist()
    noisy = fp.simulate(found, step, noise={"n_e": 0.1}, seed=1)
    assert noisy.provenance["seed"] == 1
    assert not np.array_equal(noisy["n_e"], found.simulate(step)["n_e"])
    with pytest.raises(InputError, match="expected them only for a vessel"):
        fp.simulate(found, step, method="euler")


def test_a_comparison_prints_as_a_table(experiment):
    found = fp.identify(experiment, fp.Structure.linear(products=True), noise="white")
    text = str(fp.compare(found, found))
    assert text.startswith("quantity")
    assert "No change beyond what the uncertainties allow" in text
    assert max(map(len, text.split("\n\n")[0].splitlines())) <= 80


def test_completion_offers_no_names_of_pydantic():
    assert {"load", "logs"} <= set(dir(fp.Trial))
    assert "name" in dir(LAUNCH)
    for thing in (fp.Trial, LAUNCH):
        assert [name for name in dir(thing) if name.startswith("model_")] == []


def test_signatures_spell_the_words_that_are_allowed():
    for function, word in (
        (fp.simulate, "euler"),
        (fp.design, "multisine"),
        (fp.signals.chirp, "logarithmic"),
        (fp.Experiment, "first"),
        (fp.sweep, "threads"),
    ):
        assert f"'{word}'" in str(inspect.signature(function)).replace('"', "'")
