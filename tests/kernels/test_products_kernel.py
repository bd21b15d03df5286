"""The cost kernel against sums formed from the sensitivities, sample by sample, and against differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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


@pytest.mark.parametrize("wrt", [[0, 1, 3, 4], EVERYTHING])
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


def assert_same_costs(batch, singles):
    """To what rounding leaves of them, the scatter as a part of its diagonal."""
    cost, _, _, scatter, count = batch
    for member, single in enumerate(singles):
        np.testing.assert_allclose(cost[member], single[0], rtol=1e-11)
        size = np.sqrt(np.diagonal(single[3]))
        np.testing.assert_array_less(np.abs(scatter[member] - single[3]), 1e-11 * np.outer(size, size))
        assert count == single[4]


@given(
    members=st.integers(1, 40),
    samples=st.integers(1, 1200),
    outputs=st.sampled_from([[0], [2], [3], [0, 2], [2, 0], [3, 2], [0, 0], [1, 0], [4], [0, 2, 3]]),
    hold=st.sampled_from(["first", "zero"]),
    late=st.sampled_from(["never", "some", "all"]),
    gaps=st.booleans(),
    seed=st.integers(0, 99),
)
@settings(max_examples=80)
def test_costs_of_a_batch_are_those_of_its_members(members, samples, outputs, hold, late, gaps, seed):
    """Whoever goes through the record side by side, whatever is left over, however late each set point is."""
    rng = np.random.default_rng(seed)
    dn_set = record(samples, seed)
    values = measured(dn_set, outputs) if gaps else rng.normal(size=(len(outputs), samples)) * 0.1
    values[:, 0] = 0.01
    vectors = twin.vector() * rng.uniform(0.8, 1.2, size=(members, 9))
    if late != "never":
        vectors[:: 1 + (late == "some"), 8] = rng.choice([0.05, 0.0123, 0.15, 0.31], size=members)[
            :: 1 + (late == "some")
        ]
    vectors[3::7, 7] = 0.07
    vectors[2::9, 4] = 0.0
    weight = np.eye(len(outputs)) + 0.1
    rest = (dn_set, DT, hold, INITIAL, outputs, values, weight, [])
    batch = _core.linear_cost_batch(vectors, *rest, 1)
    assert_same_costs(batch, [_core.linear_cost(vector, *rest) for vector in vectors])
    for threads in (2, 3):
        for one, other in zip(batch, _core.linear_cost_batch(vectors, *rest, threads), strict=True):
            np.testing.assert_array_equal(one, other)
    for one, other in zip(batch[:4], _core.linear_cost_batch(vectors[-1:], *rest, 1)[:4], strict=True):
        np.testing.assert_array_equal(one[-1:], other)


def test_a_first_order_lag_costs_what_it_costs_on_paper():
    """Without a governor the speed decays as exp(-(p - g) t / tau_n), and its squares are a geometric series."""
    samples, n_0 = 400, 0.3
    rates = np.array([0.5, 1.0, 2.0, 7.0])
    vectors = np.array([twin.vector(tau_n=1.0, K_p=0.0, K_i=0.0, g=2.0 - rate) for rate in rates])
    rest = (np.zeros(samples), DT, "first", np.array([n_0, 0.0]), [0, 2], np.zeros((2, samples)), np.eye(2))
    *_, scatter, _ = _core.linear_cost_batch(vectors, *rest, [], 1)
    q = np.exp(-2.0 * rates * DT)
    sums = n_0**2 * (1.0 - q**samples) / (1.0 - q)
    # Torque is g n here, as the rack does not move.
    g = 2.0 - rates
    expected = np.array([[sums, g * sums], [g * sums, g**2 * sums]]).transpose(2, 0, 1)
    np.testing.assert_allclose(scatter, expected, rtol=1e-13, atol=1e-15)


def test_a_loop_that_swings_half_a_turn_a_sample_goes_alone():
    """There the error's integral leaves no trace in the speed over a sample."""
    dt = 0.5
    frequency = np.pi / dt
    # a + b = 0.2 / s, c as the frequency asks for.
    vectors = np.array([twin.vector(tau_n=1.0, g=1.9, K_p=0.1 / 1.583, K_i=(frequency**2 + 0.01) / 1.583)])
    rest = (record(200), dt, "zero", INITIAL, [0, 2], np.full((2, 200), 0.1), np.eye(2), [])
    assert_same_costs(_core.linear_cost_batch(vectors, *rest, 1), [_core.linear_cost(vectors[0], *rest)])


def test_a_diverging_vector_is_an_error_alone_and_infinitely_bad_in_a_batch():
    dn_set = np.ones(5000)
    vectors = np.array([twin.vector(), twin.vector(K_p=-20.0)])
    call = {"outputs": [0], "measured": np.ones((1, 5000)), "weight": np.eye(1), "wrt": [0, 1]}
    lone = _core.linear_cost_batch(vectors, dn_set, **COST, **call | {"wrt": []}, threads=1)
    assert np.isfinite(lone[0][0])
    assert lone[0][1] == np.inf
    assert np.isnan(lone[3][1]).all()
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
