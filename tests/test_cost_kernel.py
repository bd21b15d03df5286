"""The cost kernel against sums formed from the sensitivities, sample by sample, and against differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError

from .twins import linear as twin

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


@pytest.fixture(params=DEAD_TIMES)
def dead_times(request):
    return DEAD_TIMES[request.param]


@pytest.mark.parametrize("samples", [3, 100, 511, 512, 1013])
@pytest.mark.parametrize("outputs", [(0, 2), (3, 0), (1, 4)])
def test_agrees_with_sums_over_the_sensitivities(samples, outputs, dead_times):
    dn_set = record(samples)
    values = measured(dn_set, outputs, **dead_times)
    parameters = twin.vector(**NEAR | dead_times)
    found = _core.linear_cost(
        parameters, dn_set, **COST, outputs=outputs, measured=values, weight=WEIGHT, wrt=EVERYTHING
    )
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
        return _core.linear_cost(
            x, dn_set, **COST, outputs=[0, 2], measured=values, weight=WEIGHT, wrt=list(wrt)
        )

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
    cost, gradient, gauss_newton, scatter, count = _core.linear_cost(
        truth, dn_set, **COST, outputs=outputs, measured=exact, weight=np.eye(3), wrt=[0, 1, 2]
    )
    assert count == 600
    assert cost < 1e-20
    assert np.abs(scatter).max() < 1e-20
    assert np.abs(gradient).max() < 1e-10 * np.abs(gauss_newton).max()


def test_one_gauss_newton_step_lands_on_linear_parameters():
    """The initial state enters linearly: from anywhere, one step finds it."""
    dn_set = record(200)
    exact = _core.simulate_linear(twin.vector(), dn_set, DT, "first", np.array([0.3, -0.2]), [0, 2])
    _, gradient, gauss_newton, *_ = _core.linear_cost(
        twin.vector(), dn_set, DT, "first", np.zeros(2), [0, 2], exact, np.eye(2), [9, 10]
    )
    np.testing.assert_allclose(-np.linalg.solve(gauss_newton, gradient), [0.3, -0.2], rtol=1e-10)


def test_masked_samples_leave_no_trace():
    """Whatever stands in the other output where one is masked, nothing of the sample counts."""
    dn_set = record(700)
    values = measured(dn_set)
    other = np.where(np.isnan(values).any(axis=0), [[np.nan], [1e6]], values)
    other[:, 0] = np.inf
    values[:, 0] = np.nan
    call = {"outputs": [0, 2], "weight": WEIGHT, "wrt": [0, 1]}
    one = _core.linear_cost(twin.vector(**NEAR), dn_set, **COST, **call, measured=values)
    two = _core.linear_cost(twin.vector(**NEAR), dn_set, **COST, **call, measured=other)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("wrt", [[], [0, 1, 3, 4], EVERYTHING])
def test_batch_is_its_members_on_any_number_of_threads(wrt):
    dn_set = record(900)
    values = measured(dn_set)
    vectors = twin.vector() * np.random.default_rng(3).uniform(0.9, 1.1, size=(7, 9))
    vectors[3:, 7] = 0.07
    call = {"outputs": [0, 2], "measured": values, "weight": WEIGHT, "wrt": wrt}
    *batch, count = _core.linear_cost_batch(vectors, dn_set, **COST, **call, threads=1)
    for threads in (0, 2, 3):
        *again, _ = _core.linear_cost_batch(vectors, dn_set, **COST, **call, threads=threads)
        for one, other in zip(batch, again, strict=True):
            np.testing.assert_array_equal(one, other)
    for member, vector in enumerate(vectors):
        *single, single_count = _core.linear_cost(vector, dn_set, **COST, **call)
        assert single_count == count
        for one, other in zip(batch, single, strict=True):
            np.testing.assert_array_equal(one[member], other)


def test_a_diverging_vector_is_an_error_alone_and_infinitely_bad_in_a_batch():
    dn_set = np.ones(5000)
    vectors = np.array([twin.vector(), twin.vector(K_p=-20.0)])
    call = {"outputs": [0], "measured": np.ones((1, 5000)), "weight": np.eye(1), "wrt": [0, 1]}
    with pytest.raises(SimulationError, match=r"diverged at sample \d+ .*dn is not finite"):
        _core.linear_cost(vectors[1], dn_set, **COST, **call)
    cost, gradient, gauss_newton, scatter, _ = _core.linear_cost_batch(
        vectors, dn_set, **COST, **call, threads=1
    )
    assert np.isfinite(cost[0])
    assert cost[1] == np.inf
    for values in (gradient, gauss_newton, scatter):
        assert np.isfinite(values[0]).all()
        assert np.isnan(values[1]).all()


def test_a_sum_of_squares_beyond_the_numbers_says_so():
    with pytest.raises(SimulationError, match="the sum of squares is not finite"):
        _core.linear_cost(
            twin.vector(),
            np.zeros(4),
            **COST,
            outputs=[0],
            measured=np.full((1, 4), 1e200),
            weight=np.eye(1),
            wrt=[],
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"measured": np.ones((2, 9))},
            r"measured: found .* shape \[2, 9\], expected \[2, 10\] \(outputs, samples\)",
        ),
        ({"measured": np.ones(20)}, "measured: found float64 of shape .*array of 2 axes"),
        ({"measured": np.full((2, 10), np.nan)}, "no sample where every output is finite"),
        ({"weight": np.eye(3)}, r"weight: found .* shape \[3, 3\], expected \[2, 2\]"),
        (
            {"weight": np.array([[1.0, 2.0], [0.0, 1.0]])},
            r"weight\[1, 0\] is 0 and weight\[0, 1\] 2, .*symmetric",
        ),
        ({"weight": np.full((2, 2), np.nan)}, "finite symmetric matrix"),
        ({"parameters": np.ones((3, 8))}, r"parameters: found .* shape \[3, 8\], expected \[3, 9\]"),
        ({"parameters": -np.ones((3, 9))}, r"parameters\[0\]: found tau_n = -1 s"),
        ({"wrt": [12]}, "wrt: found index 12"),
    ],
)
def test_arguments_are_checked(change, message):
    arguments = {
        "parameters": np.ones((3, 9)),
        "dn_set": np.ones(10),
        **COST,
        "outputs": [0, 2],
        "measured": np.ones((2, 10)),
        "weight": np.eye(2),
        "wrt": [0],
        "threads": 1,
    }
    with pytest.raises(InputError, match=message):
        _core.linear_cost_batch(**arguments | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"filters": np.ones((2, 33))}, "filters has 66 values, expected 2 rows of 1 to 32"),
        ({"filters": np.ones((3, 1))}, r"filters: found .* shape \[3, 1\], expected \[2, 1\]"),
        ({"filters": np.full((2, 1), np.nan)}, "filters holds a value that is not finite"),
        ({"offsets": np.ones(3)}, r"offsets is \[1\.0, 1\.0, 1\.0\], expected 2 finite numbers"),
    ],
)
def test_arguments_of_the_products_are_checked(change, message):
    arguments = {"outputs": [0, 2], "measured": np.ones((2, 10)), "wrt": [0]}
    arguments |= {"offsets": np.zeros(2), "filters": np.ones((2, 1))} | change
    with pytest.raises(InputError, match=message):
        _core.linear_products(twin.vector(), np.ones(10), **COST, **arguments)


@given(st.floats(0.1, 10), st.integers(2, 600))
def test_scales_with_the_weight(factor, samples):
    dn_set = record(samples)
    values = measured(dn_set)
    values[:, 0] = 0.1
    call = {"outputs": [0, 2], "measured": values, "wrt": [0, 3]}
    one = _core.linear_cost(twin.vector(**NEAR), dn_set, **COST, **call, weight=WEIGHT)
    two = _core.linear_cost(twin.vector(**NEAR), dn_set, **COST, **call, weight=factor * WEIGHT)
    for a, b in zip(one[:3], two[:3], strict=True):
        np.testing.assert_allclose(factor * np.asarray(a), b, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(one[3], two[3])
