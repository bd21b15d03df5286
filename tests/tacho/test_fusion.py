"""Fusion of pulse trains: the shaft's speed and its variance from all of them, and word when they disagree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from shipfp_rs.errors import InputError
from shipfp_rs.tacho import Train, fuse, speed_from_pulses
from shipfp_rs.tacho.fusion import fit_angle_spline

SPEED, GEAR, SIGMA = 5.165, 3.82, 1e-4
SWINGS = ((0.02, 0.05), (0.004, 0.6))  # relative size and frequency [Hz]
DURATION = 60.0


def speed_at(time, swings=SWINGS):
    return SPEED * (1 + sum(size * np.sin(2 * np.pi * f * time) for size, f in swings))


def passages(pulses_per_rev, gear=1.0, seed=None, swings=SWINGS):
    """Times of evenly spaced pulses of a shaft that turns `gear` times as fast, with Gaussian timing errors."""
    angles = np.arange(1, int(0.95 * SPEED * DURATION * gear * pulses_per_rev)) / (gear * pulses_per_rev)
    times = angles / SPEED
    for _ in range(20):
        turned = SPEED * (
            times + sum(s * (1 - np.cos(2 * np.pi * f * times)) / (2 * np.pi * f) for s, f in swings)
        )
        times -= (turned - angles) / speed_at(times, swings)
    return times if seed is None else times + np.random.default_rng(seed).normal(0.0, SIGMA, len(times))


def train(name, times, pulses_per_rev=1, ratio=1.0):
    return Train(name, speed_from_pulses(times, pulses_per_rev, time_std_s=SIGMA), ratio)


def three_trains(seed, ratio=GEAR):
    return [
        train("PTM_1", passages(1, seed=[seed, 1])),
        train("PTM_4", passages(4, seed=[seed, 4]), 4),
        train("PTM_e", passages(1, GEAR, seed=[seed, 9]), ratio=ratio),
    ]


def fused(trains, bandwidth_hz=2.0, rate_hz=50.0):
    return fuse(trains, rate_hz, 2.0, 54.0, bandwidth_hz=bandwidth_hz)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_spline_and_its_variance_are_those_of_dense_least_squares():
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0.0, 10.0, 300))
    stretch = rng.integers(0, 3, 300)
    angle = (
        5.0 * time
        + 0.1 * np.sin(time)
        - np.array([0.0, 0.3, -2.0])[stretch]
        + 1e-3 * rng.standard_normal(300)
    )
    weight = rng.uniform(0.5, 2.0, 300) * 1e6
    fit = fit_angle_spline(time, angle, weight, stretch, 0.5)

    knots = fit.spline.t
    basis = BSpline.design_matrix(time, knots, 4).toarray()
    size = basis.shape[1]
    design = np.column_stack([basis, -(stretch == 1).astype(float), -(stretch == 2).astype(float)])
    normal = design.T @ (weight[:, None] * design)
    bend = np.diff(np.eye(size), 2, axis=0)
    normal[:size, :size] += 1e-6 * np.median(np.diag(normal)[:size]) * bend.T @ bend
    solution = np.linalg.solve(normal, design.T @ (weight * angle))
    np.testing.assert_allclose(fit.spline.c, solution[:size], rtol=1e-8)
    np.testing.assert_allclose(fit.offsets, [0.0, *solution[size:]], atol=1e-8)
    grid = np.linspace(0.1, 9.9, 50)
    slopes = np.array([BSpline(knots, row, 4)(grid, 1) for row in np.eye(size)]).T
    covariance = np.linalg.inv(normal)[:size, :size]
    np.testing.assert_allclose(fit.speed(grid), slopes @ solution[:size], rtol=1e-8)
    np.testing.assert_allclose(
        fit.speed_variance(grid), np.sum(slopes @ covariance * slopes, axis=1), rtol=1e-6
    )


def test_the_error_of_the_fused_speed_is_what_its_deviation_says():
    scores = []
    for seed in range(10):
        found = fused(three_trains(seed))
        scores.append((found.speed_rps - speed_at(found.time_s)) / found.std_rps)
        assert all(report.agrees for report in found.trains.values())
    assert rms(scores) == pytest.approx(1.0, rel=0.1)
    assert np.mean(np.abs(scores) < 1.96) == pytest.approx(0.95, abs=0.02)


def test_each_train_makes_the_speed_better():
    one, four, engine = three_trains(0)
    errors = {}
    for label, trains in {
        "one": [one],
        "four": [four],
        "one, four": [one, four],
        "all": [one, four, engine],
    }.items():
        errors[label] = [
            rms((f := fused([*trains], 0.8)).speed_rps / speed_at(f.time_s) - 1.0),
            np.median(f.std_rps) / SPEED,
        ]
        print(f"{label:10} error {100 * errors[label][0]:.4f} %, stated {100 * errors[label][1]:.4f} %")
    assert errors["all"][0] < errors["four"][0] < errors["one"][0]
    # Independent pulses: the variance falls with their number, 5.2, 20.7 and 19.7 a second.
    assert errors["all"][1] == pytest.approx(errors["four"][1] * np.sqrt(4 / (1 + 4 + GEAR)), rel=0.05)
    assert errors["one, four"][1] == pytest.approx(errors["four"][1] * np.sqrt(4 / 5), rel=0.05)


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_within_the_bandwidth_nothing_is_damped_or_delayed(share):
    band, depth = 2.0, 1e-3
    swings = ((depth, share * band),)
    found = fused([train("PTM_4", passages(4, swings=swings), 4)], band)
    angle = 2 * np.pi * share * band * found.time_s
    basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones(len(angle))])
    gain = np.linalg.lstsq(basis, found.speed_rps / SPEED)[0]
    assert gain[0] / depth == pytest.approx(1.0, abs=2e-3)
    assert gain[1] / depth == pytest.approx(0.0, abs=2e-3)


def test_an_unknown_gear_ratio_is_estimated():
    errors = []
    for seed in range(8):
        found = fused(three_trains(seed, ratio=None)).trains["PTM_e"]
        errors.append((found.ratio - GEAR) / found.ratio_std)
        assert found.ratio == pytest.approx(GEAR, rel=1e-6)
    assert 0.5 < rms(errors) < 1.6


def test_a_wrong_gear_ratio_shows():
    reports = fused(three_trains(0, ratio=1.001 * GEAR)).trains
    # The mean of all lies between them; the train that is off is furthest from it.
    assert not reports["PTM_e"].agrees
    assert abs(reports["PTM_e"].difference) > abs(reports["PTM_4"].difference)


@settings(max_examples=8)
@given(at=st.integers(40, 1000))
def test_a_slipped_count_is_outvoted_and_reported(at):
    one, _, engine = three_trains(1)
    times = passages(4, seed=[1, 4])
    # Two periods of one and a half where there were three of one: each is counted as one, and one pulse is gone.
    slipped = np.concatenate([times[:at], [0.5 * (times[at - 1] + times[at + 2])], times[at + 2 :]])
    found = fused([one, train("PTM_4", slipped, 4), engine])
    assert np.abs(found.speed_rps / speed_at(found.time_s) - 1.0).max() < 0.01
    assert found.trains["PTM_1"].agrees
    assert found.trains["PTM_e"].agrees
    assert not found.trains["PTM_4"].agrees
    (slip,) = found.trains["PTM_4"].slips_s
    assert slip == pytest.approx(times[at], abs=0.3)


def test_a_train_of_uneven_reflectors_weighs_less():
    one, _, engine = three_trains(2)
    bent = passages(4, seed=[2, 4]) + np.tile([0.0, 0.02, -0.01, 0.01], 400)[: len(passages(4))] / (4 * SPEED)
    found = fused([one, train("PTM_4", bent, 4), engine])
    assert found.trains["PTM_4"].scatter > 2.0
    without = fused([one, engine])
    score = (found.speed_rps - speed_at(found.time_s)) / found.std_rps
    assert rms(score) < 1.3
    assert np.median(found.std_rps) < np.median(without.std_rps)


def test_what_one_train_misses_another_bridges_and_what_all_miss_is_masked():
    one, four, engine = (passages(1, seed=1), passages(4, seed=2), passages(1, GEAR, seed=3))

    def without(times, start, stop):
        return times[(times < start) | (times > stop)]

    trains = [
        train("PTM_1", without(one, 30.0, 34.0)),
        train("PTM_4", without(without(four, 15.0, 20.0), 30.0, 34.0), 4),
        train("PTM_e", without(engine, 30.0, 34.0), ratio=GEAR),
    ]
    found = fused(trains)
    hole = (found.time_s > 30.5) & (found.time_s < 33.5)
    known = (found.time_s < 29.9) | (found.time_s > 34.1)
    bridged = (found.time_s > 15.5) & (found.time_s < 19.5)
    assert np.isnan(found.speed_rps[hole]).all()
    score = (found.speed_rps - speed_at(found.time_s)) / found.std_rps
    assert rms(score[known]) == pytest.approx(1.0, rel=0.25)
    assert np.median(found.std_rps[bridged]) > 1.2 * np.median(found.std_rps[found.time_s < 14.0])
    assert all(report.agrees for report in found.trains.values())


def test_a_long_log_with_a_break_in_all_trains_is_fused_on_both_sides_of_it():
    rng = np.random.default_rng(8)
    trains = []
    for name, pulses_per_rev, gear in (("PTM_1", 1, 1.0), ("PTM_4", 4, 1.0), ("PTM_e", 1, GEAR)):
        times = np.arange(1, int(3000.0 * SPEED * pulses_per_rev * gear)) / (SPEED * pulses_per_rev * gear)
        times = (times + rng.normal(0.0, SIGMA, len(times)))[(times < 1500.0) | (times > 1505.0)]
        times = np.delete(times, rng.integers(50, len(times) - 50, 300))
        trains.append(train(name, times, pulses_per_rev, gear))
    found = fuse(trains, 20.0, 1.0, 2990.0, bandwidth_hz=2.0)
    lost = np.isnan(found.speed_rps)
    np.testing.assert_array_equal(lost, (found.time_s >= 1500.0) & (found.time_s <= 1505.0) & lost)
    assert lost.sum() == pytest.approx(5.0 * 20.0, abs=10)
    score = ((found.speed_rps - SPEED) / found.std_rps)[~lost]
    assert rms(score) == pytest.approx(1.0, rel=0.05)
    assert np.abs(score).max() < 6.0
    assert all(report.agrees for report in found.trains.values())


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: fuse([], 10, 0, 9), "trains: found "),
        (lambda: fuse([train("a", passages(4), 4)] * 2, 10, 0, 9), r"found \['a', 'a'\], .*different names"),
        (lambda: fuse([train("a", passages(4), 4, None)], 10, 0, 9), "no ratio is known"),
        (lambda: fuse([train("a", passages(4), 4, -1.0)], 10, 0, 9), "train 'a', ratio: found -1.0"),
        (lambda: fuse([train("a", passages(4), 4)], 10, 9, 0), "stop_s: found 0 with start_s = 9"),
        (lambda: fuse([train("a", passages(4)[:5], 4)], 10, 0, 9), "train 'a': too few pulses"),
        (lambda: fuse([train("a", passages(1))], 10, 0, 9, bandwidth_hz=2.0), "at most 1.15"),
        (lambda: fuse([Train("a", speed_from_pulses(passages(4), 4))], 10, 0, 9), "give time_std_s"),
        (
            lambda: fuse([train("a", passages(4), 4), train("b", passages(4) + 99.0, 4, None)], 10, 0, 9),
            "a ratio can't be estimated",
        ),
    ],
)
def test_trains_that_can_not_be_fused_are_refused(call, said):
    with pytest.raises(InputError, match=said):
        call()
