"""Intervals between bounds: one-sided on a bound, wide where a bound hides a valley, skewed where the cost is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import t as student

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.coordinates import Coordinates, Itself
from shipfp_rs.identification.identify import fingerprint_of, identify, posed
from shipfp_rs.identification.likelihood import Products
from shipfp_rs.identification.profiles import RISE, Profiles, _spread
from shipfp_rs.identification.question import Options
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support.arrays import Array
from tests.launch import TRUTH, noisy_record

TIME = np.arange(400) / 20.0


def line_through(
    columns: dict[str, np.ndarray],
    bounds: dict[str, tuple[float, float]],
    measured: np.ndarray,
    **options,
):
    """Fit measured dn as a sum of columns, each with a factor between bounds, white noise; no offset."""
    parameters = [Parameter(name, "-", *np.clip([1.0], *bound), *bound) for name, bound in bounds.items()]
    structure = Structure.from_function(
        lambda q, _: sum(q[name] * column for name, column in columns.items())[None, :],
        parameters,
        ["dn"],
        name="sum",
    )
    experiment = Experiment(
        "made", 20.0, {"n_set": 0.0 * TIME + 1.0, "n_e": 1.0 + measured}, {"n_set": 1.0, "n_e": 1.0}
    )
    return fingerprint_of(posed([experiment], structure, Options("white", at_rest=True, **options)))


def quantile_and_std(measured, residual, unknown):
    freedom = len(measured) - unknown
    return student.ppf(0.975, freedom), np.sqrt(residual @ residual / freedom)


SLOW = np.cos(0.3 * TIME)
"""What the second parameter of the next tests explains, so that the fit is one."""


@pytest.mark.parametrize("beyond", [0.0, 0.002, 0.006])
def test_on_a_light_bound_the_interval_reaches_as_far_as_the_likelihood_allows(beyond):
    shape = np.sin(TIME)
    columns = np.column_stack([shape, SLOW])
    noise = np.random.default_rng(5).normal(size=len(TIME)) * 0.1
    noise -= columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    measured = noise + SLOW - beyond * shape  # the best factor without a bound lies beyond it
    found = line_through({"a": shape, "b": SLOW}, {"a": (0.0, 10.0), "b": (0.0, 10.0)}, measured)["a"]
    residual = measured - SLOW * (SLOW @ measured) / (SLOW @ SLOW)
    quantile, std = quantile_and_std(measured, residual, 1)
    spread = std * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0])
    assert beyond < quantile * spread
    assert (found.value, found.status, found.std) == (0.0, "at_bound", None)
    # (a + beyond)^2 - beyond^2 = (t spread)^2
    assert found.ci95[0] == 0.0
    assert found.ci95[1] == pytest.approx(-beyond + np.hypot(beyond, quantile * spread), rel=1e-2)
    assert "the data allow up to" in found.reason


def test_a_parameter_pressed_hard_against_its_bound_has_no_interval():
    shape = np.sin(TIME)
    measured = SLOW - shape + np.random.default_rng(5).normal(size=len(TIME)) * 0.1
    found = line_through({"a": shape, "b": SLOW}, {"a": (0.0, 10.0), "b": (0.0, 10.0)}, measured)["a"]
    assert (found.value, found.status, found.ci95) == (0.0, "at_bound", None)
    assert "pressed" in found.reason


def test_a_light_bound_does_not_make_its_partner_well_known():
    # Two columns that are nearly the same: only the sum of the factors is well known.
    one, other = np.sin(TIME), np.sin(TIME) + 0.05 * np.cos(TIME)
    measured = 1.0 * one + np.random.default_rng(3).normal(size=len(TIME)) * 0.05
    columns = {"a": one, "b": other}
    free, *_ = np.linalg.lstsq(np.column_stack([one, other]), measured, rcond=None)
    measured -= other * (free[1] + 0.01) - one * (free[1] + 0.01)  # b would go to -0.01 without its bound
    fingerprint = line_through(columns, {"a": (-10.0, 10.0), "b": (0.0, 10.0)}, measured)
    a = fingerprint["a"]
    assert fingerprint["b"].status == "at_bound"

    def best_cost(value):
        rest = measured - value * one
        return np.sum((rest - max(0.0, rest @ other / (other @ other)) * other) ** 2)

    quantile, std = quantile_and_std(measured, measured - a.value * one, 1)
    grid = np.linspace(a.value - 1.0, a.value + 1.0, 20001)
    inside = [value for value in grid if best_cost(value) - best_cost(a.value) <= (quantile * std) ** 2]
    assert a.ci95 == pytest.approx((inside[0], inside[-1]), abs=2e-3 * (inside[-1] - inside[0]))
    # With b held on its bound the interval would be twenty times too narrow.
    assert a.value - a.ci95[0] > 5 * quantile * std / np.linalg.norm(one)


def test_symmetric_intervals_are_the_covariances_cut_by_the_bounds():
    one, other = np.sin(TIME), np.sin(TIME) + 0.5 * np.cos(TIME)
    measured = one + 0.5 * other + np.random.default_rng(3).normal(size=len(TIME)) * 0.2
    columns, wide = {"a": one, "b": other}, {"a": (0.0, 10.0), "b": (0.0, 10.0)}
    profile = line_through(columns, wide, measured)["a"]
    plain = line_through(columns, wide, measured, intervals="symmetric")
    half = student.ppf(0.975, len(TIME) - 2) * np.sqrt(plain.covariance["matrix"][0][0])
    assert plain["a"].ci95 == pytest.approx((profile.value - half, profile.value + half), rel=1e-9)
    assert plain["a"].ci95 == pytest.approx(profile.ci95, rel=1e-3), "a sum has a quadratic cost"
    near = profile.value - 0.3 * half
    cut = line_through(columns, wide | {"a": (near, 10.0)}, measured, intervals="symmetric")["a"]
    assert cut.ci95 == pytest.approx((near, profile.value + half), rel=1e-9)
    with pytest.raises(InputError, match="intervals 'wide', expected one of profile, symmetric"):
        line_through(columns, wide, measured, intervals="wide")


def test_a_skewed_likelihood_gives_a_skewed_interval():
    truth = 2.0
    measured = np.exp(-truth * TIME) + np.random.default_rng(2).normal(size=len(TIME)) * 0.15
    structure = Structure.from_function(
        lambda q, _: np.exp(-q["rate"] * TIME)[None, :],
        [Parameter("rate", "1/s", 1.0, 1e-3, 1e3)],
        ["dn"],
        name="decay",
    )
    experiment = Experiment(
        "made", 20.0, {"n_set": 0.0 * TIME + 1.0, "n_e": 1.0 + measured}, {"n_set": 1.0, "n_e": 1.0}
    )
    rate = fingerprint_of(posed([experiment], structure, Options("white", at_rest=True)))["rate"]

    def cost(value):
        return np.sum((measured - np.exp(-value * TIME)) ** 2)

    quantile, std = quantile_and_std(measured, measured - np.exp(-rate.value * TIME), 1)
    grid = np.linspace(0.2, 20.0, 40001)
    inside = [value for value in grid if cost(value) - cost(rate.value) <= (quantile * std) ** 2]
    # An end follows from the root of the rise nearby, which runs nearly straight.
    assert rate.ci95 == pytest.approx((inside[0], inside[-1]), rel=5e-3)
    assert rate.ci95[1] - rate.value > 1.2 * (rate.value - rate.ci95[0])


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1))])
def test_one_sine_that_leaves_a_gain_on_its_bound_does_not_pin_the_others(seed):
    sine = signals.sine_sequence([0.5], 30, 13.0, rate_hz=50.0)
    fingerprint = identify(noisy_record(sine, 0.01, 0.9, seed), Structure.linear(products=True))
    for name, truth in TRUTH.items():
        estimate = fingerprint[name]
        if estimate.ci95 is not None:
            low, high = estimate.ci95
            assert low - 0.5 * (high - low) <= truth <= high + 0.5 * (high - low), name


@pytest.mark.parametrize("seed", range(5))
def test_what_is_on_a_bound_goes_inward_only(seed):
    random = np.random.default_rng(seed)
    rows, slope = random.normal(size=(9, 5)), random.normal(size=5)
    rows[:, 1] = rows[:, 0] + 1e-6 * rows[:, 1]  # two delays that are off are alike
    matrix, inward = rows.T @ rows, np.array([1, 1, 0, -1, 0])
    most = 0.0
    for held in itertools.product([False, True], repeat=3):
        free = np.delete(np.arange(5), np.array([0, 1, 3])[list(held)])
        step = np.linalg.solve(matrix[np.ix_(free, free)], slope[free])
        if np.all(step * inward[free] >= 0.0):
            most = max(most, slope[free] @ step)
    assert _spread(matrix, slope, inward) == pytest.approx(most, rel=1e-4)


class Wall:
    """Deviance of a dead time that hardly rises from 0 to 0.11 s and steeply from there, far from the bound 0.6 s."""

    coordinates = Coordinates({"T_d": (0.0, 0.6)}, {}, ((),))

    def near(self, vector):
        return self

    def products(self, vector: Array) -> Products:
        apart = (vector[0] - 0.11) / 0.002
        residuals = (0.09 - vector[0]) / 0.3, -np.logaddexp(0.0, apart)
        slopes = 1.0 / 0.3, 1.0 / (1.0 + np.exp(-apart)) / 0.002
        gram = np.array([residuals, slopes]) @ np.array([residuals, slopes]).T
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:])

    def each(self, jobs):
        return [job() for job in jobs]


def test_a_profile_that_stops_short_of_a_bound_ends_at_the_deviance():
    minimum = descend(Wall(), np.array([0.09]))
    interval = Profiles(Wall(), [minimum]).interval(Itself("T_d"), within=(0.0, 0.6))
    apart = brentq(
        lambda x: np.logaddexp(0.0, (x - 0.11) / 0.002) ** 2 + ((x - 0.09) / 0.3) ** 2 - RISE, 0.1, 0.2
    )
    assert interval.high == pytest.approx(apart, abs=5e-4)
    assert (interval.low, interval.kinds) == (0.0, ("bound", "data"))
