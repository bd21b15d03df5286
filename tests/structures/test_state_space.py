"""State spaces against their NumPy reference, SciPy and known answers, and the kernel that they run on."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.structures.custom import MatrixEquations


def simulate_finely(A, B, C, D, u, dt, hold, initial):
    """Sample by sample with an eighth-order Runge-Kutta method."""
    state = np.array(initial, dtype=float)
    states = [state]
    for now, after in pairwise(u):
        slope = (after - now) / dt if hold == "first" else 0.0

        def rate(t, x, now=now, slope=slope):
            return A @ x + B * (now + slope * t)

        state = solve_ivp(rate, (0, dt), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        states.append(state)
    return C @ np.array(states).T + np.outer(D, u)


def response_by_eigenvectors(A, B, C, D, frequency_hz):
    """C (s - A)^-1 B + D through the eigenvectors of A."""
    values, vectors = np.linalg.eig(A)
    inside = np.linalg.solve(vectors, B.astype(complex))
    return np.array([(C @ vectors) @ (inside / (2j * np.pi * f - values)) + D for f in frequency_hz]).T


def model(order, outputs, seed):
    """A stable model with rates of about 1 per second."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(order, order)) - 3 * np.eye(order)
    return A, random.normal(size=order), random.normal(size=(outputs, order)), random.normal(size=outputs)


def equations_of(model):
    return MatrixEquations(lambda q: model, (), tuple(f"y{row}" for row in range(len(model[3]))))


def response(*model_and_frequency):
    *model, frequency = model_and_frequency
    return equations_of(model).response({}, frequency, ())[0]


def run(model, u, dt=0.1, hold="first", initial=None):
    equations = equations_of(model)
    start = np.zeros(len(model[1])) if initial is None else initial
    values = dict(zip(equations.states, start, strict=True))
    return equations.simulate(
        values, SimpleNamespace(dn_set=np.array(u, dtype=float), rate_hz=1.0 / dt, hold=hold)
    )


LAG = ([[-2.0]], [2.0], [[1.0]], [0.0])


class TestSimulation:
    @pytest.mark.parametrize("hold", ["zero", "first"])
    @pytest.mark.parametrize("order", [1, 2, 5, 8, 9, 20])
    def test_agrees_with_the_differential_equation(self, order, hold):
        A, B, C, D = model(order, 3, seed=order)
        random = np.random.default_rng(order)
        u, initial = random.normal(size=12), random.normal(size=order)
        found = run((A, B, C, D), u, 0.3, hold, initial)
        expected = simulate_finely(A, B, C, D, u, 0.3, hold, initial)
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

    def test_ramp_of_an_integrator_is_exact(self):
        t = 0.1 * np.arange(50)
        found = run(([[0.0]], [1.0], [[1.0]], [0.0]), t)[0]
        np.testing.assert_allclose(found, t**2 / 2, rtol=1e-13)

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

    def test_overflowing_rates_are_a_failure_of_the_simulation(self):
        with pytest.raises(SimulationError, match="matrices: not finite over a sample of 1000 s"):
            run(([[1e308]], [1.0], [[1.0]], [0.0]), np.ones(3), dt=1e3)


class TestResponse:
    frequency = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 50)])

    @pytest.mark.parametrize("order", [1, 2, 7, 15])
    def test_agrees_with_the_eigenvectors(self, order):
        A, B, C, D = model(order, 3, seed=order)
        found = response(A, B, C, D, self.frequency)
        np.testing.assert_allclose(
            found, response_by_eigenvectors(A, B, C, D, self.frequency), rtol=1e-9, atol=1e-11
        )

    def test_is_refused_at_a_pole(self):
        integrator = (np.zeros((1, 1)), np.ones(1), np.ones((1, 1)), np.zeros(1))
        with pytest.raises(InputError, match=r"frequency_hz\[1\]: the response is infinite at 0 Hz"):
            response(*integrator, np.array([1.0, 0.0]))


GOOD = {
    "system": np.full((3, 3, 4), 0.1),
    "start": np.zeros((3, 2)),
    "signal": np.arange(4.0),
    "shifts": [0, 1],
    "dt": 0.1,
}


@pytest.mark.parametrize("directions", [0, 1, 3, 6, 7, 8, 20])
@pytest.mark.parametrize("states", [1, 2, 5])
def test_the_recursion_and_its_derivatives(states, directions):
    random = np.random.default_rng(directions)
    system = 0.3 * random.normal(size=(1 + directions, states + 2, states + 2))
    start, signal = random.normal(size=(1 + directions, states)), random.normal(size=150)
    found, slopes = _core.run_recursion(system, start, signal, [-3, 1], 0.1)
    padded = np.pad(signal, 3, mode="edge")
    x, expected = start.copy(), []
    for k in range(len(signal)):
        whole = np.concatenate([x[0], padded[[k, k + 4]]])
        step = system @ whole
        step[1:] += x[1:] @ system[0, :, :states].T
        x = step[:, :states]
        expected.append(step[:, states:])
    np.testing.assert_allclose([found, *slopes], np.moveaxis(expected, 0, 2), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": np.zeros((2, 2))}, r"system: found an array of shape \[3, 3, 4\], expected \[2, 3, 4\]"),
        ({"shifts": [0]}, r"system: found an array of shape \[3, 3, 4\], expected \[3, 3, 3\]"),
        (
            {"start": np.zeros((3, 3))},
            "3 systems of 3 rows, expected at least one, of more rows than the 3 states",
        ),
        ({"start": np.zeros((3, 0)), "shifts": [0] * 4}, "found 0 states, 3 outputs"),
        ({"start": np.full((3, 2), np.nan)}, "start holds what is not finite"),
        ({"system": np.full((3, 3, 4), np.inf)}, "system holds what is not finite"),
        ({"signal": np.array([0.0, np.nan])}, "signal holds what is not finite, .*bridge gaps before"),
        ({"signal": np.zeros(0)}, "0 samples, expected at least one"),
        ({"dt": 0.0}, "dt is 0, expected a positive sample time"),
    ],
)
def test_arguments_are_checked(changes, message):
    with pytest.raises(InputError, match=message):
        _core.run_recursion(**(GOOD | changes))


def test_derivatives_that_overflow_are_said_to():
    system = np.full((2, 2, 2), 0.1)
    system[1] = 1e308
    with pytest.raises(SimulationError, match="a sensitivity is not finite"):
        _core.run_recursion(system, np.zeros((2, 1)), np.full(9, 1e9), [0], 0.1)
