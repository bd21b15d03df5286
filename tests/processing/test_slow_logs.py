"""Windows, rests and faults of logs of 1 to 20 Hz, as historians and controllers keep them."""

import numpy as np
import pytest
from scipy.signal import chirp

from shipfp_rs.inspection import inspect_log
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.governor_clock import governor_clock
from shipfp_rs.processing.trial_template import moved
from shipfp_rs.processing.windows import find_windows


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


def test_inspect_finds_the_windows_of_init() -> None:
    log = slow_chirp(10.0, 0.02, 0.5, 160.0, "linear", 0.05)
    assert inspect_log(log).windows == tuple(moved(log, "Setpoint", None)[1])


def test_the_crest_of_a_slow_rounded_sine_is_neither_stuck_nor_clipped() -> None:
    """Steps of 0.05 %, some of them stored as 0.04 %."""
    values = slow_chirp(10.0, 0.03, 0.08, 90.0, "linear", 0.05).read("Setpoint")
    values -= (
        0.01 * (np.random.default_rng(2).random(len(values)) < 0.02) * (np.arange(len(values)) % 480 > 60)
    )
    log = Log.from_arrays({"Setpoint": values[400:-400]}, rate_hz=10.0, units={"Setpoint": "%"})
    assert not [fault for fault in inspect_log(log).faults if fault["kind"] in ("stuck", "clipped")]


def test_a_torque_too_slow_for_any_clock_shows_none() -> None:
    rng = np.random.default_rng(0)
    speed = 600.0 + 20.0 * np.sin(0.3 * np.arange(800))
    assert (
        governor_clock(np.repeat(speed, 2) + rng.normal(0.0, 1.0, 1600), speed, 2, 7.0, np.array([5.0]))
        is None
    )
