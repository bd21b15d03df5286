"""The state-space kernels against their NumPy reference, SciPy and known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from tests.twins import statespace as twin


def model(order, outputs, seed):
    """A stable model with rates of about 1 per second."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(order, order)) - 3 * np.eye(order)
    return A, random.normal(size=order), random.normal(size=(outputs, order)), random.normal(size=outputs)


def run(model, u, dt=0.1, hold="first", initial=None):
    A, B, C, D = (np.array(part, dtype=float) for part in model)
    start = np.zeros(len(B)) if initial is None else np.array(initial, dtype=float)
    return _core.simulate_statespace(A, B, C, D, np.array(u, dtype=float), dt, hold, start)


LAG = ([[-2.0]], [2.0], [[1.0]], [0.0])


class TestSimulation:
    @pytest.mark.parametrize("hold", ["zero", "first"])
    @pytest.mark.parametrize("order", [1, 2, 5, 8, 9, 20])
    def test_agrees_with_the_differential_equation(self, order, hold):
        A, B, C, D = model(order, 3, seed=order)
        random = np.random.default_rng(order)
        u, initial = random.normal(size=12), random.normal(size=order)
        found = _core.simulate_statespace(A, B, C, D, u, 0.3, hold, initial)
        expected = twin.simulate(A, B, C, D, u, 0.3, hold, initial)
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)

    @settings(max_examples=25)
    @given(
        order=st.integers(1, 10),
        seed=st.integers(0, 2**32 - 1),
        dt=st.floats(1e-4, 10),
        hold=st.sampled_from(["zero", "first"]),
    )
    def test_agrees_with_scipy_discretisation(self, order, seed, dt, hold):
        A, B, C, D = model(order, 2, seed)
        u = np.random.default_rng(seed).normal(size=40)
        method = {"zero": "zoh", "first": "foh"}[hold]
        phi, gamma, c, d, _ = cont2discrete((A, B[:, None], C, D[:, None]), dt, method)
        # SciPy's first-order hold has another state, x less a multiple of u; from 0 both start at 0.
        u[0] = 0.0
        rows, state = [], np.zeros(order)
        for value in u:
            rows.append(c @ state + d[:, 0] * value)
            state = phi @ state + gamma[:, 0] * value
        found = run((A, B, C, D), u, dt, hold)
        scale = max(1.0, np.max(np.abs(rows)))
        np.testing.assert_allclose(found, np.array(rows).T, atol=1e-9 * scale, rtol=1e-9)

    def test_step_of_a_lag(self):
        t = 0.1 * np.arange(50)
        np.testing.assert_allclose(
            run(LAG, np.ones(50), hold="zero")[0], 1 - np.exp(-2 * t), rtol=1e-13, atol=1e-15
        )

    def test_ramp_of_an_integrator_is_exact(self):
        t = 0.1 * np.arange(50)
        found = run(([[0.0]], [1.0], [[1.0]], [0.0]), t)[0]
        np.testing.assert_allclose(found, t**2 / 2, rtol=1e-13)

    def test_initial_state_decays(self):
        t = 0.1 * np.arange(50)
        np.testing.assert_allclose(run(LAG, np.zeros(50), initial=[3.0])[0], 3 * np.exp(-2 * t), rtol=1e-12)

    def test_output_at_a_step_is_its_right_hand_limit(self):
        assert run(([[-1.0]], [0.0], [[0.0]], [5.0]), [0.0, 1.0, 1.0], hold="zero").tolist() == [
            [0.0, 5.0, 5.0]
        ]

    def test_slow_mode_beside_a_fast_one_keeps_its_digits(self):
        """Rates of 1e-6 and 1e7 per second, sampled at 1 Hz: the slow one loses 1e-6 of itself a sample."""
        slow = run(
            ([[-1e-6, 0.0], [0.0, -1e7]], [0.0, 0.0], [[1.0, 0.0]], [0.0]),
            np.zeros(3),
            1.0,
            initial=[1.0, 1.0],
        )
        np.testing.assert_allclose(slow[0] - 1, np.expm1(-1e-6 * np.arange(3)), rtol=1e-9)

    def test_unstable_model_diverges_with_the_sample(self):
        with pytest.raises(SimulationError, match=r"diverged at sample \d+ .*an output is not finite"):
            run(([[100.0]], [1.0], [[1.0]], [0.0]), np.ones(1000))

    def test_overflowing_rates_diverge(self):
        with pytest.raises(SimulationError, match="diverged at sample 1 "):
            run(([[1e308]], [1.0], [[1.0]], [0.0]), np.ones(3), dt=1e3)


class TestResponse:
    frequency = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 50)])

    @pytest.mark.parametrize("order", [1, 2, 7, 15])
    def test_agrees_with_the_eigenvectors(self, order):
        A, B, C, D = model(order, 3, seed=order)
        found = _core.statespace_response(A, B, C, D, self.frequency)
        np.testing.assert_allclose(found, twin.response(A, B, C, D, self.frequency), rtol=1e-9, atol=1e-11)

    def test_of_a_lag(self):
        found = _core.statespace_response(*(np.array(part) for part in LAG), self.frequency)
        np.testing.assert_allclose(found[0], 2 / (2j * np.pi * self.frequency + 2), rtol=1e-14)

    def test_is_refused_at_a_pole(self):
        integrator = (np.zeros((1, 1)), np.ones(1), np.ones((1, 1)), np.zeros(1))
        with pytest.raises(InputError, match=r"frequency_hz\[1\]: the response is infinite at 0 Hz"):
            _core.statespace_response(*integrator, np.array([1.0, 0.0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": np.eye(3)}, r"A has shape \[3, 3\], expected \[2, 2\] with 2 states in B and 1 outputs in D"),
        ({"C": np.ones((2, 2))}, r"C has shape \[2, 2\], expected \[1, 2\]"),
        ({"A": np.full((2, 2), np.nan)}, "A holds NaN, expected finite numbers"),
        ({"A": np.zeros((0, 0)), "B": np.zeros(0), "C": np.zeros((1, 0))}, "expected at least one state"),
        ({"B": np.ones((2, 1))}, r"B: found float64 of shape \[2, 1\], expected a C-contiguous float64"),
        ({"u": np.array([0.0, np.nan])}, r"u\[1\] is NaN, expected a finite number"),
        ({"u": np.zeros(0)}, "u has no samples"),
        ({"dt": 0.0}, "dt is 0, expected a positive sample time"),
        ({"hold": "second"}, "hold is 'second', expected 'zero' or 'first'"),
        ({"initial": np.zeros(3)}, "expected 2 finite numbers, one a state"),
    ],
)
def test_arguments_are_checked(changes, message):
    good = {"A": -np.eye(2), "B": np.ones(2), "C": np.ones((1, 2)), "D": np.zeros(1), "u": np.ones(4)}
    good |= {"dt": 0.1, "hold": "first", "initial": np.zeros(2)}
    with pytest.raises(InputError, match=message):
        _core.simulate_statespace(**(good | changes))
