"""Shafts that slow down to rest, run up from it or turn round: pulses at times that are known without noise."""

import numpy as np
import pytest

from shipfp_rs import tacho
from shipfp_rs.tacho import PulseFlag

STD_S = 1e-6
RATED_RPS = 20.0


def run_down(pulses_per_rev, law, phase):
    """Return times of pulses [s] under a torque that is constant or goes with speed; rest is `phase` of a pulse ahead."""
    left = (np.arange(60 * (10 if pulses_per_rev > 1 else 1)) + phase) / pulses_per_rev
    if law == "constant":
        before_rest = np.sqrt(left * left[-1]) * 2.0 / RATED_RPS
    else:
        before_rest = np.log(left / left[0]) * left[-1] / RATED_RPS
    return (before_rest[-1] - before_rest)[::-1]


def errors(speed, times, pulses_per_rev):
    """Return relative errors of the mean speeds over the intervals, and those over the stated deviations."""
    turned = np.arange(len(times)) / pulses_per_rev
    half = speed.duration_s / 2
    ends = [np.interp(speed.time_s + side, times, turned) for side in (-half, half)]
    truth = (ends[1] - ends[0]) / speed.duration_s
    return speed.speed_rps / truth - 1, (speed.speed_rps - truth) / speed.std_rps


@pytest.fixture(params=["down", "up"])
def way(request):
    """Return what makes a run-down's times those of the wanted way."""
    return (lambda times: times) if request.param == "down" else (lambda times: (times[-1] - times)[::-1])


@pytest.mark.parametrize("phase", [0.02, 0.3, 0.9])
@pytest.mark.parametrize("law", ["constant", "with speed"])
@pytest.mark.parametrize("pulses_per_rev", [1, 60])
def test_no_pulse_is_put_in_or_removed_next_to_rest(pulses_per_rev, law, phase, way):
    times = way(run_down(pulses_per_rev, law, phase))
    speed = tacho.speed_from_pulses(times, pulses_per_rev, time_std_s=STD_S)
    error, over_stated = errors(speed, times, pulses_per_rev)
    # Of a shaft that creeps to rest the last interval may be called a stop and left out.
    assert len(times) - 2 <= len(error) < len(times)
    assert not speed.flags.any()
    assert np.abs(error).max() < 1e-5
    assert np.abs(over_stated).max() < 1.0


@pytest.mark.parametrize("phase", [0.02, 0.3, 0.9])
@pytest.mark.parametrize("pulses_per_rev", [1, 60])
@pytest.mark.parametrize("before_rest", [2, 3, 5, 8, 20])
def test_real_faults_next_to_rest_are_repaired(before_rest, pulses_per_rev, phase, way):
    whole = run_down(pulses_per_rev, "constant", phase)
    times, lost = way(whole), way(np.delete(whole, -1 - before_rest))
    speed = tacho.speed_from_pulses(lost, pulses_per_rev, time_std_s=STD_S)
    error, over_stated = errors(speed, times, pulses_per_rev)
    assert len(error) == len(times) - 1
    assert np.count_nonzero(speed.flags & PulseFlag.MISSED) == 2
    assert np.abs(error).max() < 0.15  # halves of an interval have one speed
    assert np.abs(over_stated).max() < 1.0

    first = len(times) - 1 - before_rest if times[1] - times[0] < times[-1] - times[-2] else before_rest - 1
    for share in (0.05, 0.5):
        doubled = np.insert(times, first + 1, times[first] + share * (times[first + 1] - times[first]))
        speed = tacho.speed_from_pulses(doubled, pulses_per_rev, time_std_s=STD_S)
        error, _ = errors(speed, times, pulses_per_rev)
        assert len(error) == len(times) - 1
        assert np.count_nonzero(speed.flags & PulseFlag.EXTRA) == 1
        assert np.abs(error).max() < 1e-5


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
@pytest.mark.parametrize("least_rps", [0.2, 0.5, 1.0, 1.5, 3.0])
def test_a_shaft_that_nearly_stops_between_has_its_pulses_counted(least_rps, phase):
    fine = np.linspace(-30.0, 30.0, 600_001)
    rps = least_rps + 2.0 * np.abs(fine)
    angle = np.append(0.0, np.cumsum(0.5 * (rps[1:] + rps[:-1]) * np.diff(fine))) + phase
    times = np.interp(np.arange(1, int(angle[-1])), angle, fine)
    times = times[np.abs(times) < 8.0]
    speed = tacho.speed_from_pulses(times, 1, time_std_s=STD_S)
    assert not speed.flags.any()
    assert np.abs(errors(speed, times, 1)[0]).max() < 1e-5


@pytest.mark.parametrize("pulses_per_rev", [1, 60])
def test_a_pulse_missed_at_an_end_may_as_well_be_a_stop(pulses_per_rev, way):
    times = way(np.delete(np.arange(100) * 0.01 / pulses_per_rev, [50, 98]))
    speed = tacho.speed_from_pulses(times, pulses_per_rev, time_std_s=1e-8)
    assert np.count_nonzero(speed.flags & PulseFlag.MISSED) == 4
    unsure = np.flatnonzero(speed.std_rps > 0.4 * speed.speed_rps).tolist()
    assert unsure in ([0, 1], [97, 98])
    assert speed.speed_rps[unsure] == pytest.approx(100.0)
