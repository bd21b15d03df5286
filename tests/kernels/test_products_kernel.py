"""Sums of products, and the cost made of them, against the sensitivities, sample by sample, and against differences."""

import numpy as np
import pytest
from scipy.signal import lfilter

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from tests.twins import linear as twin

DT = 0.05
INITIAL = np.array([0.02, -0.03])
EVERYTHING = list(range(11))
WEIGHT = np.array([[3.0, -0.4], [-0.4, 0.5]])
NEAR = {"tau_n": 1.3, "g": -0.5, "K_i": 1.2}
DEAD_TIMES = {"none": {}, "both": {"T_d": 0.12, "T_set": 0.02, "K_p": 3.0}}
COST = {"dt": DT, "hold": "first", "initial": INITIAL}


def record(samples, seed=1205):
    return np.cumsum(np.random.default_rng(seed).normal(size=samples)) * 0.01


def measured(dn_set, outputs=(0, 2), **parameters):
    """What the launch would have answered, with noise and two stretches that were not measured."""
    values = _core.simulate_linear(twin.vector(**parameters), dn_set, DT, "first", INITIAL, list(outputs))
    values += np.random.default_rng(5).normal(scale=0.01, size=values.shape)
    values[0, dn_set.size // 5 : dn_set.size // 4] = np.nan
    values[-1, dn_set.size // 2 :: 7] = np.nan
    return values


def naive_cost(parameters, dn_set, outputs, measured, weight, wrt):
    simulated, sensitivities = _core.linear_sensitivities(
        parameters, dn_set, DT, "first", INITIAL, outputs, wrt
    )
    residuals = measured - simulated
    valid = np.isfinite(measured).all(axis=0)
    e, S = residuals[:, valid], sensitivities[:, :, valid]
    return (
        np.einsum("ik,ij,jk", e, weight, e),
        -2 * np.einsum("wik,ij,jk->w", S, weight, e),
        2 * np.einsum("wik,ij,vjk->wv", S, weight, S),
        e @ e.T,
        valid.sum(),
    )


def cost_of(parameters, dn_set, outputs, measured, weight, wrt, initial=INITIAL):
    """Cost, gradient, Gauss-Newton matrix, scatter and count, as a search has them from the sums."""
    sums, count = _core.linear_products(
        parameters,
        dn_set,
        DT,
        "first",
        initial,
        outputs,
        measured,
        np.zeros(len(outputs)),
        np.ones((len(outputs), 1)),
        wrt,
    )
    by = slice(len(wrt))
    scatter = sums[:, -1, :, -1]
    return (
        np.vdot(weight, scatter),
        -2.0 * np.einsum("iwj,ij->w", sums[:, by, :, -1], weight),
        2.0 * np.einsum("iwjv,ij->wv", sums[:, by, :, by], weight),
        scatter,
        count,
    )


@pytest.fixture(params=DEAD_TIMES)
def dead_times(request):
    return DEAD_TIMES[request.param]


@pytest.mark.parametrize("samples", [3, 100, 511, 512, 1013])
@pytest.mark.parametrize("outputs", [(0, 2), (3, 0), (1, 4)])
def test_agrees_with_sums_over_the_sensitivities(samples, outputs, dead_times):
    dn_set = record(samples)
    values = measured(dn_set, outputs, **dead_times)
    parameters = twin.vector(**NEAR | dead_times)
    found = cost_of(parameters, dn_set, outputs, values, WEIGHT, EVERYTHING)
    expected = naive_cost(parameters, dn_set, outputs, values, WEIGHT, EVERYTHING)
    assert found[4] == expected[4] < samples or samples == 3
    for one, other in zip(found[:4], expected[:4], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * np.abs(other).max())


@pytest.mark.parametrize("order", [0, 3, 8])
@pytest.mark.parametrize("samples", [7, 255, 256, 1013])
def test_products_are_those_of_filtered_rows(samples, order, dead_times):
    """Segments run side by side must not show: nor at their seams, nor with gaps across them."""
    outputs, wrt, offsets = [0, 3], EVERYTHING, np.array([0.01, -0.02])
    dn_set = record(samples)
    values = measured(dn_set, outputs, **dead_times)
    values[:, -1] = np.nan
    parameters = twin.vector(**NEAR | dead_times)
    filters = np.column_stack([np.ones(2), np.random.default_rng(order).normal(scale=0.3, size=(2, order))])
    found, count = _core.linear_products(
        parameters,
        dn_set,
        **COST,
        outputs=outputs,
        measured=values,
        offsets=offsets,
        filters=filters,
        wrt=wrt,
    )
    simulated, slopes = _core.linear_sensitivities(parameters, dn_set, DT, "first", INITIAL, outputs, wrt)
    whole = np.isfinite(values).all(axis=0)
    residual = np.where(whole, values - simulated - offsets[:, None], 0.0)
    rows = np.concatenate([slopes, np.ones((1, 2, samples)), residual[None]])
    rows = np.array(
        [lfilter(taps, [1.0], row, axis=-1) for taps, row in zip(filters, rows.swapaxes(0, 1), strict=True)]
    )
    reached = np.array([k >= order and whole[k - order : k + 1].all() for k in range(samples)])
    rows *= reached
    size = np.linalg.norm(rows, axis=-1)
    assert count == reached.sum()
    np.testing.assert_allclose(
        found, np.einsum("iak,jbk->iajb", rows, rows), rtol=0, atol=1e-12 * size.max() ** 2
    )


def test_gradient_is_the_slope_of_the_cost(dead_times):
    dn_set = record(300)
    values = measured(dn_set, **dead_times)
    point = twin.vector(**NEAR | dead_times)
    wrt = [0, 1, 2, 3, 4, 5]

    def evaluate(x, wrt=()):
        return cost_of(x, dn_set, [0, 2], values, WEIGHT, list(wrt))

    gradient = evaluate(point, wrt)[1]
    for index in wrt:
        shift = 1e-4 * np.abs(point[index]) * np.eye(9)[index]

        def central(h, shift=shift):
            return (evaluate(point + h * shift)[0] - evaluate(point - h * shift)[0]) / (2 * h)

        slope = (4 * central(0.5) - central(1)) / 3 / shift[index]
        np.testing.assert_allclose(gradient[index], slope, rtol=1e-7)


def test_vanishes_at_the_truth():
    dn_set, outputs = record(600), [0, 3, 4]
    truth = twin.vector()
    exact = _core.simulate_linear(truth, dn_set, **COST, outputs=outputs)
    cost, gradient, gauss_newton, scatter, count = cost_of(
        truth, dn_set, outputs, exact, np.eye(3), [0, 1, 2]
    )
    assert count == 600
    assert cost < 1e-20
    assert np.abs(scatter).max() < 1e-20
    assert np.abs(gradient).max() < 1e-10 * np.abs(gauss_newton).max()


def test_one_gauss_newton_step_lands_on_linear_parameters():
    """The initial state enters linearly: from anywhere, one step finds it."""
    dn_set = record(200)
    exact = _core.simulate_linear(twin.vector(), dn_set, DT, "first", np.array([0.3, -0.2]), [0, 2])
    _, gradient, gauss_newton, *_ = cost_of(
        twin.vector(), dn_set, [0, 2], exact, np.eye(2), [9, 10], initial=np.zeros(2)
    )
    np.testing.assert_allclose(-np.linalg.solve(gauss_newton, gradient), [0.3, -0.2], rtol=1e-10)


def test_masked_samples_leave_no_trace():
    """Whatever stands in the other output where one is masked, nothing of the sample counts."""
    dn_set = record(700)
    values = measured(dn_set)
    other = np.where(np.isnan(values).any(axis=0), [[np.nan], [1e6]], values)
    other[:, 0] = np.inf
    values[:, 0] = np.nan
    one = cost_of(twin.vector(**NEAR), dn_set, [0, 2], values, WEIGHT, [0, 1])
    two = cost_of(twin.vector(**NEAR), dn_set, [0, 2], other, WEIGHT, [0, 1])
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_first_order_lag_costs_what_it_costs_on_paper():
    """Without a governor the speed decays as exp(-(p - g) t / tau_n), and its squares are a geometric series."""
    samples, n_0 = 400, 0.3
    rates = np.array([0.5, 1.0, 2.0, 7.0])
    vectors = [twin.vector(tau_n=1.0, K_p=0.0, K_i=0.0, g=2.0 - rate) for rate in rates]
    rest = (np.zeros(samples), [0, 2], np.zeros((2, samples)), np.eye(2), [])
    scatter = [cost_of(vector, *rest, initial=np.array([n_0, 0.0]))[3] for vector in vectors]
    q = np.exp(-2.0 * rates * DT)
    sums = n_0**2 * (1.0 - q**samples) / (1.0 - q)
    # Torque is g n here, as the rack does not move.
    g = 2.0 - rates
    expected = np.array([[sums, g * sums], [g * sums, g**2 * sums]]).transpose(2, 0, 1)
    np.testing.assert_allclose(scatter, expected, rtol=1e-13, atol=1e-15)


def test_a_diverging_vector_says_where():
    dn_set = np.ones(5000)
    with pytest.raises(SimulationError, match=r"diverged at sample \d+ .*dn is not finite"):
        cost_of(twin.vector(K_p=-20.0), dn_set, [0], np.ones((1, 5000)), np.eye(1), [0, 1])


def test_a_sum_of_squares_beyond_the_numbers_says_so():
    with pytest.raises(SimulationError, match="the sum of squares is not finite"):
        cost_of(twin.vector(), np.zeros(4), [0], np.full((1, 4), 1e200), np.eye(1), [])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"measured": np.ones((2, 9))},
            r"measured: found .* shape \[2, 9\], expected \[2, 10\] \(outputs, samples\)",
        ),
        ({"measured": np.ones(20)}, "measured: found float64 of shape .*array of 2 axes"),
        ({"wrt": [12]}, "wrt: found index 12"),
        ({"parameters": -np.ones(9)}, r"parameters: found tau_n = -1 s"),
        ({"filters": np.ones((2, 33))}, "filters has 66 values, expected 2 rows of 1 to 32"),
        ({"filters": np.ones((3, 1))}, r"filters: found .* shape \[3, 1\], expected \[2, 1\]"),
        ({"filters": np.full((2, 1), np.nan)}, "filters holds a value that is not finite"),
        ({"offsets": np.ones(3)}, r"offsets is \[1\.0, 1\.0, 1\.0\], expected 2 finite numbers"),
    ],
)
def test_arguments_of_the_products_are_checked(change, message):
    arguments = {"parameters": twin.vector(), "dn_set": np.ones(10), "outputs": [0, 2], "wrt": [0]}
    arguments |= {"measured": np.ones((2, 10)), "offsets": np.zeros(2), "filters": np.ones((2, 1))} | change
    with pytest.raises(InputError, match=message):
        _core.linear_products(**COST, **arguments)
