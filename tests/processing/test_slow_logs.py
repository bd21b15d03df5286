"""Windows, rests and faults of logs of 1 to 20 Hz, as historians and controllers keep them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.inspection import inspect_log
from shipfp_rs.logs.faults import Fault
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.roles import guess_roles
from shipfp_rs.processing.trial import Trial
from shipfp_rs.processing.trial_template import drafted, moved
from shipfp_rs.processing.windows import find_windows
from shipfp_rs.support.toml import template
from shipfp_rs.view.document import Document
from shipfp_rs.view.draft import checked


def slow_chirp(rate_hz: float, first: float, last: float, lasts_s: float, method: str, step: float) -> Log:
    time = np.arange(int(lasts_s * rate_hz)) / rate_hz
    rest = np.zeros(int(48 * rate_hz))
    moved_ = 4.5 * chirp(time, first, lasts_s, last, method=method, phi=-90)
    values = 71.35 + np.concatenate([rest, moved_, rest])
    values += np.random.default_rng(0).normal(0.0, 0.2 * step, len(values))
    return Log.from_arrays(
        {"Setpoint": np.round(values / step) * step}, rate_hz=rate_hz, units={"Setpoint": "%"}
    )


@pytest.mark.parametrize(
    ("rate_hz", "first", "last", "lasts_s", "method"),
    [(50.0, 0.0067, 5.0, 300.0, "logarithmic"), (10.0, 0.02, 0.5, 160.0, "linear"), (5.0, 0.0067, 0.5, 600.0, "logarithmic"),
     (2.0, 0.01, 0.2, 400.0, "linear"), (1.0, 0.15, 0.01, 480.0, "logarithmic")],
)  # fmt: skip
def test_rests_and_chirps_of_slow_logs_are_found_with_the_frequencies_that_are_there(
    rate_hz: float, first: float, last: float, lasts_s: float, method: str
) -> None:
    found = find_windows(slow_chirp(rate_hz, first, last, lasts_s, method, 0.01), "Setpoint")
    assert [window.kind for window in found] == ["steady", "chirp", "steady"]
    assert (found[0].stop_s, found[2].start_s) == pytest.approx(
        (48.0, 48.0 + lasts_s), abs=max(8.0 / rate_hz, 1.0)
    )
    assert found[1].frequency_hz == pytest.approx((first, last), rel=0.1)


@pytest.fixture
def stairs(tmp_path: Path) -> tuple[Log, Trial]:
    """Set point that is polled at 5 Hz, beside speed and torque at 50 Hz that follow its stairs; a gap, a short sine."""
    time = np.arange(150 * 5) / 5.0
    asked = 900.0 + 40.0 * np.sin(2.0 * np.pi * 0.1 * (time - 30.0)) * ((time >= 30.0) & (time < 110.0))
    asked += 40.0 * np.sin(np.pi * time) * ((time >= 125.0) & (time < 131.0))
    asked[400:405] = np.nan
    follows = np.repeat(np.where(np.isnan(asked), 900.0, asked), 10)
    noise = np.random.default_rng(0).normal(0.0, 0.1, (2, len(follows)))
    levels = {"speed": follows + noise[0], "torque": 2.0 * follows + noise[1]}
    units = {"speed": "rpm", "torque": "Nm"}
    Log.from_arrays({"set point": asked}, rate_hz=5.0, units={"set point": "rpm"}).write(
        tmp_path / "slow.parquet"
    )
    Log.from_arrays(levels, rate_hz=50.0, units=units).write(tmp_path / "fast.parquet")
    fast = Log.open(tmp_path / "fast.parquet")
    log = Log.merge(fast, Log.open(tmp_path / "slow.parquet"), name="log")
    roles = guess_roles(log)
    text = drafted(template("TRIAL"), log, [tmp_path / "log"], roles, moved(log, "set point", None)[1])
    return log, checked(text.replace("# held = true", "held = true"), "TRIAL.toml")


def test_inspect_with_and_without_a_trial_and_view_find_the_windows_of_init(
    stairs: tuple[Log, Trial], tmp_path: Path
) -> None:
    log, trial = stairs
    found = moved(log, "set point", None)[1]
    assert any(window.stop_s - window.start_s == pytest.approx(20.5) for window in found)
    assert inspect_log(log).windows == inspect_log(log, trial).windows == tuple(found)
    log.write(tmp_path / "log.parquet")
    told = Document(tmp_path / "log.parquet").within("set point", None, 0.0, 150.0)["found"]
    assert [(one["start_s"], one["stop_s"]) for one in told] == [(one.start_s, one.stop_s) for one in found]


def test_a_set_point_polled_slowly_is_held_at_the_rate_of_speed_and_torque(stairs: tuple[Log, Trial]) -> None:
    log, trial = stairs
    assert trial.processing.rate_hz == 50.0
    (first, *_) = process(log, trial)
    assert (first.rate_hz, first.hold) == (50.0, "zero")
    np.testing.assert_allclose(first.signals["n_set"], first.signals["n_e"], atol=1.0)


def test_a_slow_set_point_that_nobody_holds_is_joined_by_straight_lines(stairs: tuple[Log, Trial]) -> None:
    log, trial = stairs
    loose = trial.channels.set_point.model_copy(update={"held": False})
    channels = trial.channels.model_copy(update={"set_point": loose})
    (first, *_) = process(log, trial.model_copy(update={"channels": channels}))
    assert (first.rate_hz, first.hold) == (50.0, "first")
    time = trial.windows[0].start_s + np.arange(len(first)) / 50.0
    expected = 900.0 + 40.0 * np.sin(2.0 * np.pi * 0.1 * (time - 30.0))
    np.testing.assert_allclose(first.signals["n_set"][200:-200], expected[200:-200], atol=0.5)


@pytest.mark.parametrize(("of", "rate_hz"), [("set point", 5.0), ("speed", 50.0)])
def test_a_fault_of_the_clock_is_where_its_channel_has_it(
    stairs: tuple[Log, Trial], of: str, rate_hz: float
) -> None:
    log, trial = stairs
    start_s = trial.windows[0].start_s

    def experiment(kind: str, begin_s: float) -> Experiment:
        spans = np.round(rate_hz * (start_s + np.array([[begin_s, begin_s + 2.0]])))
        fault = Fault(kind, "clock", "masked", spans, of=of)
        return process(Log(log.name, [*log.channels.values()], log.raw_blocks, faults=(fault,)), trial)[0]

    (gap,) = [one for one in experiment("time_gap", 10.0).provenance["faults"] if one["kind"] == "time_gap"]
    np.testing.assert_allclose(gap["spans"], 50.0 * (start_s + np.array([[10.0, 12.0]])), atol=5.0)
    with pytest.raises(InputError, match=f"ends before {start_s + 10.0:.3g}"):
        experiment("time_jump", 10.0)


def test_the_crest_of_a_slow_rounded_sine_is_neither_stuck_nor_clipped() -> None:
    """Steps of 0.05 %, some of them stored as 0.04 %."""
    values = slow_chirp(10.0, 0.03, 0.08, 90.0, "linear", 0.05).read("Setpoint")
    values -= (
        0.01 * (np.random.default_rng(2).random(len(values)) < 0.02) * (np.arange(len(values)) % 480 > 60)
    )
    log = Log.from_arrays({"Setpoint": values[400:-400]}, rate_hz=10.0, units={"Setpoint": "%"})
    assert not [fault for fault in inspect_log(log).faults if fault["kind"] in ("stuck", "clipped")]
