"""Pulse trains to speed: trains of known speed profiles, with the faults that real ones have."""

import doctest
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_lsq_spline

from shipfp_rs import tacho
from shipfp_rs.errors import InputError
from shipfp_rs.tacho import PulseFlag, fusion

RATE = 2000.0
SPEED = 5.165  # the tug's shaft at 1184 rpm of the engine
SWING, SWING_HZ = 0.06, 0.1
EVEN = np.full(4, 0.25)
UNEVEN = np.array([0.25, 0.255, 0.2475, 0.2475])  # one off by 2 %, the next two by 1 %


def speed_at(time):
    return SPEED * (1 + SWING * np.sin(2 * np.pi * SWING_HZ * time))


def turns_at(time):
    omega = 2 * np.pi * SWING_HZ
    return SPEED * (time + SWING / omega * (1 - np.cos(omega * time)))


def passages(duration, fractions=EVEN):
    """True times at which reflectors come by, by inversion of the turns."""
    marks = np.concatenate([[0.0], np.cumsum(fractions)[:-1]])
    angles = (np.arange(1, int(turns_at(duration)))[:, None] + marks).ravel()
    times = angles / SPEED
    for _ in range(20):
        times -= (turns_at(times) - angles) / speed_at(times)
    return times


def train(duration, fractions=EVEN, rise_s=0.0):
    """Samples of 0 to 5 V that are high for a thirteenth of a turn from each passage on; edges are steps or ramps."""
    time = np.arange(round(duration * RATE)) / RATE
    rises = passages(duration, fractions)
    last = np.searchsorted(rises, time, side="right") - 1
    since = np.where(last >= 0, time - rises[last], np.inf)
    width = 1 / (13 * SPEED)
    if rise_s == 0.0:
        return np.where(since < width, 5.0, 0.0)
    return np.clip(5.0 * np.minimum(since, width + rise_s - since) / rise_s, 0.0, 5.0) * (since < np.inf)


def mean_speed_error(speed):
    """Against the mean speed over each interval, which is what a period tells."""
    half = speed.duration_s / 2
    truth = (turns_at(speed.time_s + half) - turns_at(speed.time_s - half)) / speed.duration_s
    return speed.speed_rps / truth - 1


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def test_steps_are_timed_as_well_as_samples_allow():
    # A step between two samples lies evenly anywhere between them: sigma = Ts / sqrt(12) for each crossing, and
    # sqrt(2) of it for the period between two that are independent. 15 % allow for the scatter of the estimate.
    pulses = tacho.pulse_times(train(120), RATE)
    speed = tacho.speed_from_pulses(pulses.times_s, 4, time_std_s=pulses.time_std_s)
    expected = np.sqrt(2) / RATE / np.sqrt(12) * 4 * SPEED
    assert 0.85 * expected < rms(mean_speed_error(speed)) < 1.15 * expected
    assert np.median(speed.std_rps / speed.speed_rps) == pytest.approx(expected, rel=0.02)


def test_ramps_are_timed_a_hundred_times_better_than_steps():
    pulses = tacho.pulse_times(train(60, rise_s=4 / RATE).astype(np.float32), RATE)
    speed = tacho.speed_from_pulses(pulses.times_s, 4)
    assert rms(mean_speed_error(speed)) < 0.01 * np.sqrt(2) / RATE / np.sqrt(12) * 4 * SPEED


def test_a_given_threshold_times_the_ramp_where_it_crosses_it():
    rise = 4 / RATE
    times = tacho.pulse_times(train(20, rise_s=rise), RATE, threshold=2.0).times_s
    np.testing.assert_allclose(times, passages(20)[: len(times)] + rise * 2.0 / 5.0, atol=1e-9)


def test_noise_and_saw_tooth_edges_make_no_second_crossing():
    rng = np.random.default_rng(8)
    samples = train(60, rise_s=6 / RATE)
    noisy = samples + 0.2 * rng.standard_normal(samples.size)
    noisy += 0.4 * (-1.0) ** np.arange(samples.size)
    assert len(tacho.pulse_times(noisy, RATE).times_s) == len(tacho.pulse_times(samples, RATE).times_s)


@settings(max_examples=20)
@given(cuts=st.lists(st.integers(0, 20_000), max_size=8), levels=st.sampled_from([(None, None), (2.0, 1.0)]))
def test_the_pieces_in_which_a_log_is_read_do_not_matter(cuts, levels):
    threshold, hysteresis = levels
    samples = train(10, rise_s=3 / RATE).astype(np.float32)
    samples[7000:7100] = np.nan
    options = {"threshold": threshold, "hysteresis": hysteresis, "window_s": 1.7}
    whole = tacho.pulse_times(samples, RATE, **options)
    pieces = tacho.pulse_times(iter(np.split(samples, sorted(cuts))), RATE, **options)
    np.testing.assert_array_equal(pieces.times_s, whole.times_s)
    np.testing.assert_array_equal(pieces.gaps_s, [[3.5, 3.55]])


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, ">f4", np.float16])
def test_other_sample_types_are_converted(dtype):
    samples = train(5)
    expected = tacho.pulse_times(samples, RATE).times_s
    np.testing.assert_array_equal(tacho.pulse_times(samples.astype(dtype), RATE).times_s, expected)
    np.testing.assert_array_equal(tacho.pulse_times(np.repeat(samples, 2)[::2], RATE).times_s, expected)


def test_levels_follow_a_train_that_drifts():
    time = np.arange(round(600 * RATE)) / RATE
    samples = train(600) * (1 - 0.6 * time / 600) + 3.0 * np.sin(time / 150)
    assert len(tacho.pulse_times(samples, RATE).times_s) == len(tacho.pulse_times(train(600), RATE).times_s)


def test_the_noise_of_a_shaft_at_rest_gives_no_pulses():
    rng = np.random.default_rng(2)
    noise = np.round(rng.standard_normal(round(150 * RATE)))  # last bit of the converter
    running = 1000.0 * train(100)
    record = np.concatenate([noise, running, noise])
    times = tacho.pulse_times(record.astype(np.int16), RATE).times_s
    np.testing.assert_allclose(times, tacho.pulse_times(running, RATE).times_s + 150.0, atol=1.5 / RATE)


def test_one_disturbed_window_does_not_silence_the_rest():
    samples = train(200)
    samples[round(65 * RATE) : round(80 * RATE)] *= 50.0
    times = tacho.pulse_times(samples, RATE).times_s
    expected = tacho.pulse_times(train(200), RATE).times_s
    outside = (expected < 60) | (expected > 91)
    assert np.isin(np.round(expected[outside] * RATE), np.round(times * RATE)).all()


def test_unequal_reflectors_are_found_and_removed():
    pulses = tacho.pulse_times(train(300, UNEVEN), RATE)
    angles = tacho.reflector_angles(pulses.times_s, 4)
    assert angles.ok, angles.reason
    assert angles.fractions.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(angles.fractions, UNEVEN, atol=5 * angles.std.max())
    assert angles.std.max() < 1e-4
    timing = np.sqrt(2) / RATE / np.sqrt(12) * 4 * SPEED
    raw = tacho.speed_from_pulses(pulses.times_s, 4)
    true = tacho.speed_from_pulses(pulses.times_s, 4, angles=angles)
    assert rms(mean_speed_error(raw)) > 1.5 * timing
    assert rms(mean_speed_error(true)) < 1.15 * timing


def test_the_scatter_of_the_angles_is_what_their_std_says():
    found, std = [], []
    for draw in range(25):
        rng = np.random.default_rng(draw)
        times = passages(60, UNEVEN) + rng.normal(0.0, 1e-4, len(passages(60, UNEVEN)))
        angles = tacho.reflector_angles(times, 4)
        found.append(angles.fractions)
        std.append(angles.std)
    assert rms((np.array(found) - UNEVEN) / np.mean(std)) == pytest.approx(1.0, rel=0.3)


@pytest.mark.parametrize("first", range(4))
def test_angles_of_one_record_serve_another_that_begins_at_any_reflector(first):
    angles = tacho.reflector_angles(passages(60, UNEVEN), 4)
    speed = tacho.speed_from_pulses(passages(30, UNEVEN)[first:], 4, angles=angles)
    assert np.abs(mean_speed_error(speed)).max() < 1e-4


def test_missed_pulses_and_gaps_do_not_shift_the_reflectors():
    times = np.delete(passages(300, UNEVEN), [100, 555, 556, 1200, 2203, 4000])
    times = np.concatenate([times[:3000], times[3100:]])  # a long break: counting begins anew
    angles = tacho.reflector_angles(times, 4)
    assert angles.ok, angles.reason
    rotated = [np.roll(UNEVEN, -k) for k in range(4)]
    assert min(np.abs(angles.fractions - fractions).max() for fractions in rotated) < 1e-4
    speed = tacho.speed_from_pulses(times, 4, angles=angles)
    good = speed.flags == PulseFlag.GOOD
    assert np.abs(mean_speed_error(speed)[good]).max() < 1e-4


@pytest.mark.parametrize(
    ("times", "reason"),
    [
        (np.array([1.0]), "no two pulses in a row"),
        (passages(300, UNEVEN)[:60], "11 turns without a break .* at least 20"),
        (np.cumsum(1 / (4 * np.linspace(1, 6, 600))), None),
        (np.exp(np.arange(400) * 0.012), "0 turns .* changes by less than 2% a turn"),
        (np.cumsum(0.05 + 0.0015 * np.random.default_rng(0).standard_normal(400)), "spacings scatter by"),
    ],
)
def test_angles_are_refused_where_the_data_can_not_tell(times, reason):
    angles = tacho.reflector_angles(times, 4)
    assert angles.ok == (reason is None), angles.reason
    if reason is not None:
        np.testing.assert_array_equal(angles.fractions, EVEN)
        with pytest.raises(InputError, match=reason):
            tacho.speed_from_pulses(np.arange(10.0), 4, angles=angles)


def test_one_pulse_a_turn_has_no_geometry():
    assert tacho.reflector_angles(np.arange(3.0), 1).fractions.tolist() == [1.0]


def test_missed_and_double_pulses_are_repaired_and_flagged():
    true = passages(60)
    missed = [50, 200, 201, 500, 501, 502, 503]
    extra = np.concatenate([true[[300, 700]] + 0.004, true[[800]] - 0.004, [(true[900] + true[901]) / 2]])
    times = np.sort(np.concatenate([np.delete(true, missed), extra]))
    speed = tacho.speed_from_pulses(times, 4)
    assert len(speed.speed_rps) == len(true) - 1
    assert np.count_nonzero(speed.flags == PulseFlag.MISSED) == 2 + 3 + 5
    assert np.count_nonzero(speed.flags == PulseFlag.EXTRA) == 4
    assert np.abs(mean_speed_error(speed)[speed.flags != PulseFlag.MISSED]).max() < 1e-9
    # Within five periods the speed changes by 1 % at most.
    assert np.abs(speed.speed_rps / speed_at(speed.time_s) - 1).max() < 0.01


@settings(max_examples=30)
@given(st.data())
def test_no_spikes_remain_wherever_pulses_are_missed_or_doubled(data):
    true = passages(30)
    places = st.sets(st.integers(20, len(true) - 20), max_size=4)
    missed = data.draw(places)
    # More of them in a row, or with others, leave no median to be measured against.
    doubled = {k for k in data.draw(places) if all(abs(k - m) > 4 for m in missed)}
    # Two of them in the same place of successive turns look like irregular rotation.
    assume(not any(k + 3 in doubled for k in doubled))
    # An extra crossing right before an edge is taken for it.
    shift = data.draw(st.floats(0.02, 0.9))
    extra = [true[k] + shift * (true[k + 1] - true[k]) for k in doubled]
    times = np.sort(np.concatenate([np.delete(true, sorted(missed)), extra]))
    speed = tacho.speed_from_pulses(times, 4)
    np.testing.assert_allclose(speed.speed_rps, speed_at(speed.time_s), rtol=0.02)


def test_intervals_over_a_gap_are_left_out_and_not_bridged():
    samples = train(60).astype(np.float32)
    samples[round(20 * RATE) : round(23 * RATE)] = np.nan
    pulses = tacho.pulse_times(samples, RATE)
    speed = tacho.speed_from_pulses(pulses.times_s, 4, gaps=pulses.gaps_s)
    assert np.abs(mean_speed_error(speed)).max() < 0.03
    grid, masked = tacho.resample(speed, 50.0, 0.0, 60.0)
    time = np.arange(3000) / 50
    assert masked[(time > 20) & (time < 23)].all()
    assert not masked[((time > 1) & (time < 19.9)) | ((time > 23.1) & (time < 59))].any()
    assert np.isnan(grid[masked]).all()
    assert np.isfinite(grid[~masked]).all()


def test_a_stop_of_the_shaft_is_masked():
    times = passages(60)
    times[600:] += 10.0
    speed = tacho.speed_from_pulses(times, 4)
    _, masked = tacho.resample(speed, 10.0, times[600] - 9.0, times[600] - 1.0)
    assert masked.all()


def test_two_trains_agree_although_steps_make_the_median_of_each_another_level():
    """Half of the time at either of two speeds: a few pulses more or less decide which one the median is."""
    rng = np.random.default_rng(2)
    pulses = {}
    for pulses_per_rev, loses in ((1, 0.02), (4, 0.0)):
        rates = np.where(np.arange(400) // 20 % 2 == 0, 4.1, 3.8)
        turns = np.cumsum(np.append(0.0, np.repeat(1.0 / rates / pulses_per_rev, pulses_per_rev)))
        kept = np.append(True, rng.random(len(turns) - 1) > loses)
        times = turns[kept]
        lasted = np.diff(times)
        turned = np.diff(np.flatnonzero(kept)) / pulses_per_rev
        pulses[pulses_per_rev] = tacho.IntervalSpeed(
            time_s=times[:-1] + 0.5 * lasted,
            speed_rps=turned / lasted,
            std_rps=np.full(len(lasted), 1e-3),
            duration_s=lasted,
            flags=np.zeros(len(lasted), dtype=np.uint8),
            pulses_per_rev=pulses_per_rev,
        )
    assert pulses[1].times_as_fast_as(pulses[4]) == pytest.approx(1.0, abs=2e-3)
    assert pulses[4].times_as_fast_as(pulses[1]) == pytest.approx(1.0, abs=2e-3)
    early, late = pulses[1].part(slice(0, 50)), pulses[4].part(slice(1200, None))
    assert np.isnan(early.times_as_fast_as(late))


def test_the_grid_follows_the_speed_within_the_bandwidth():
    speed = tacho.speed_from_pulses(passages(60), 4)
    assert speed.bandwidth_hz == pytest.approx(2 * SPEED, rel=0.02)
    grid, masked = tacho.resample(speed, 100.0, 5.0, 55.0)
    assert not masked.any()
    np.testing.assert_allclose(grid, speed_at(5.0 + np.arange(5000) / 100), rtol=1e-4)


def swinging_passages(ripple_hz, mean, depth):
    """Return times of 2000 pulses, four a turn, at mean (1 + depth sin) rev/s, by Newton's method."""
    angles = np.arange(2000) / 4
    times = angles / mean
    for _ in range(30):
        turns = mean * (times - depth / (2 * np.pi * ripple_hz) * (np.cos(2 * np.pi * ripple_hz * times) - 1))
        times -= (turns - angles) / (mean * (1 + depth * np.sin(2 * np.pi * ripple_hz * times)))
    return times


@pytest.mark.parametrize(("share", "loss"), [(0.05, 3e-5), (0.1, 3e-4), (0.2, 6e-3)])
def test_the_grid_keeps_the_size_of_a_swing(share, loss):
    mean, depth = 5.0, 1e-3
    ripple_hz = share * 4 * mean
    speed = tacho.speed_from_pulses(swinging_passages(ripple_hz, mean, depth), 4)
    grid, _ = tacho.resample(speed, 200.0, 10.0, 90.0)
    sine = np.sin(2 * np.pi * ripple_hz * (10.0 + np.arange(len(grid)) / 200.0))
    amplitude = 2 * np.mean(sine * (grid / mean - 1))
    assert amplitude / depth == pytest.approx(1.0, abs=loss)


def test_ripple_is_reduced_by_the_gain_of_the_interval():
    ripple_hz, mean, depth = 6.0, 5.0, 1e-3
    speed = tacho.speed_from_pulses(swinging_passages(ripple_hz, mean, depth), 4)
    sine = np.sin(2 * np.pi * ripple_hz * speed.time_s)
    amplitude = np.linalg.lstsq(sine[:, None], speed.speed_rps / mean - 1)[0][0]
    assert amplitude / depth == pytest.approx(float(tacho.interval_gain(ripple_hz, 4, mean)), rel=2e-3)
    assert amplitude / depth < 0.9


@pytest.mark.parametrize(
    ("samples", "options", "said"),
    [
        (np.zeros(100), {}, "constant at 0, expected a train of pulses"),
        (np.full(100, np.nan), {}, "found no finite one"),
        (np.empty(0), {}, "found no finite one"),
        (train(2), {"threshold": 7.0}, "threshold: found 7.0, expected between the train's levels"),
        (train(2), {"hysteresis": 0.0}, "hysteresis: found 0.0, expected a positive number"),
        (train(2), {"window_s": 0.0}, "window_s: found 0.0"),
        (np.zeros((3, 2)), {}, r"samples: found shape \(3, 2\), expected one axis"),
        ([1.0, 2.0], {}, r"samples: found shape \(\)"),
    ],
)
def test_what_is_no_pulse_train_is_refused(samples, options, said):
    with pytest.raises(InputError, match=said):
        tacho.pulse_times(samples, RATE, **options)


def test_a_rate_that_is_none_is_refused():
    with pytest.raises(InputError, match="rate_hz: found nan"):
        tacho.pulse_times(train(1), float("nan"))
    with pytest.raises(InputError, match="rate_hz: found -1"):
        tacho.resample(tacho.speed_from_pulses(np.arange(9.0), 1), -1, 0, 1)
    with pytest.raises(InputError, match=r"stop_s: found 1 with start_s = 2"):
        tacho.resample(tacho.speed_from_pulses(np.arange(9.0), 1), 1, 2, 1)


@pytest.mark.parametrize(
    ("times", "pulses", "gaps", "said"),
    [
        ([0.0, 2.0, 1.0], 4, None, "1.0 follows 2.0 at index 2, expected ascending"),
        ([0.0, np.nan], 4, None, "nan follows 0.0 at index 1"),
        ([[0.0]], 4, None, r"times_s: found shape \(1, 1\)"),
        ([0.0], 0, None, "pulses_per_rev: found 0, expected 1 to 100000"),
        ([0.0], 10**15, None, f"pulses_per_rev: found {10**15}, expected 1 to 100000"),
        ([0.0], 4, [1.0, 2.0], r"gaps: found shape \(2,\), expected \(G, 2\)"),
    ],
)
def test_times_that_are_none_are_refused(times, pulses, gaps, said):
    with pytest.raises(InputError, match=said):
        tacho.speed_from_pulses(times, pulses, gaps=gaps)


def test_too_few_pulses_give_no_speed_and_a_masked_grid():
    for times in ([], [1.0]):
        speed = tacho.speed_from_pulses(times, 4)
        assert speed.speed_rps.size == 0
        assert speed.bandwidth_hz == 0.0
        assert tacho.resample(speed, 10.0, 0.0, 1.0)[1].all()


def test_a_spline_through_the_speed_is_matlab_s_tachorpm():
    """As on the page for users of MATLAB, with the knots that its `tachorpm` has by default."""
    folder = Path(__file__).parents[1] / "data" / "tachorpm"
    _, train = np.loadtxt(folder / "test_input.csv", delimiter=",", skiprows=1).T
    time, rpm = np.loadtxt(folder / "matlab_ref_output.csv", delimiter=",", skiprows=1).T
    speed = tacho.speed_from_pulses(tacho.pulse_times(train, 1000.0), 1)
    knots = np.pad(np.linspace(speed.time_s[0], speed.time_s[-1], 10), 3, mode="edge")
    found = make_lsq_spline(speed.time_s, 60.0 * speed.speed_rps, knots)(time)
    np.testing.assert_allclose(found, rpm, rtol=1e-3)


@pytest.mark.parametrize("module", [tacho.crossings, tacho.speed, fusion], ids=lambda module: module.__name__)
def test_the_examples_run(module):
    found = doctest.testmod(module)
    assert found.attempted
    assert not found.failed
