"""The linear structure's equations against their NumPy reference and against known answers."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs.errors import SimulationError
from shipfp_rs.structures.state_space import LinearEquations
from tests.twins import linear as twin

ALL = list(range(5))
K_P, T_D, T_SET = 3, 7, 8
CASES = {
    "launch": twin.vector(),
    "dead times": twin.vector(T_d=0.12, T_set=0.3, p=2.17, tau_prop=0.4),
    "slow tug": twin.vector(tau_n=0.4, g=-0.3, v=1.2, K_p=0.8, K_i=2.0, p=2.17, tau_prop=0.43, T_d=0.05),
}


@pytest.fixture(params=CASES)
def parameters(request):
    return CASES[request.param]


STATES = ("initial dn", "initial dE")
NAMES = (*twin.DEFAULTS, *STATES)
BRAKE = LinearEquations(("dn", "dE", "dM", "dX"), gauge=False)
GAUGE = LinearEquations(("dM",), gauge=True)


def rows_of(brake, gauge):
    """Speed, integral, both torques and rack, as the reference has them."""
    return np.concatenate([brake[..., :3, :], gauge, brake[..., 3:, :]], axis=-2)


def sensitivities(parameters, dn_set, dt, hold, initial, wrt):
    """Outputs (5, N) and derivatives (W, 5, N) by places in the reference's parameters, 9 and 10 the initial states."""
    values = dict(zip(NAMES, [*parameters, *initial], strict=True))
    run, names = SimpleNamespace(dn_set=dn_set, rate_hz=1.0 / dt, hold=hold), [NAMES[i] for i in wrt]
    both = [equations.sensitivities(values, run, names) for equations in (BRAKE, GAUGE)]
    return tuple(rows_of(*parts) for parts in zip(*both, strict=True))


def simulate(parameters, dn_set, dt, hold, initial):
    return sensitivities(parameters, dn_set, dt, hold, initial, ())[0]


def response(parameters, frequency, wrt=()):
    values, names = dict(zip(NAMES, parameters, strict=False)), [NAMES[i] for i in wrt]
    both = [equations.response(values, frequency, names) for equations in (BRAKE, GAUGE)]
    return tuple(rows_of(*parts) for parts in zip(*both, strict=True))


def richardson(function, point, index, step):
    """Central difference of order four by one entry of `point`."""

    def central(h):
        shift = h * np.eye(point.size)[index]
        return (function(point + shift) - function(point - shift)) / (2 * h)

    return (4 * central(step / 2) - central(step)) / 3


class TestResponse:
    frequency = np.geomspace(1e-4, 50, 40)

    @staticmethod
    def expected(parameters, frequency):
        """The rack as it follows the governor, after the dead time."""
        rows = twin.response(parameters, frequency)
        rows[4] *= np.exp(-2j * np.pi * frequency * parameters[T_D])
        return rows

    def test_agrees_with_the_loop_equations(self, parameters):
        found, _ = response(parameters, self.frequency)
        np.testing.assert_allclose(found, self.expected(parameters, self.frequency), rtol=1e-11, atol=1e-13)

    def test_derivatives(self, parameters):
        wrt = list(range(9))
        _, derivatives = response(parameters, self.frequency, wrt)
        for index in wrt:
            step = 1e-4 * max(abs(parameters[index]), 0.1)
            expected = richardson(lambda x: self.expected(x, self.frequency), parameters, index, step)
            np.testing.assert_allclose(derivatives[index], expected, rtol=1e-7, atol=1e-7)


class TestSimulation:
    """dt 0.05 s, a rough set point and a start away from rest."""

    dt = 0.05
    initial = np.array([0.02, -0.03])
    rough = np.cumsum(np.random.default_rng(804).normal(size=560)) * 0.01

    @pytest.mark.parametrize("hold", ["zero", "first"])
    @pytest.mark.parametrize("T_set", [0.0, 0.3, 0.0125, 0.37 * dt, 5.9 * dt, 100.0])
    def test_agrees_with_the_matrix_exponential(self, hold, T_set):
        parameters = twin.vector(T_set=T_set)
        found = simulate(parameters, self.rough, self.dt, hold, self.initial)
        expected = twin.simulate(parameters, self.rough, self.dt, hold, self.initial)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())

    @pytest.mark.parametrize("samples", [1, 2, 3, 255, 256, 257, 511, 512, 513, 560])
    def test_any_length(self, samples):
        """Long records run in segments side by side: nobody may see where they meet."""
        parameters = twin.vector(T_d=0.12, T_set=0.37 * self.dt)
        whole = simulate(parameters, self.rough, self.dt, "first", self.initial)
        part = simulate(parameters, self.rough[:samples], self.dt, "first", self.initial)
        # The last sample's interval has no end yet, which no row up to it may see.
        np.testing.assert_allclose(part, whole[:, :samples], rtol=0, atol=1e-12 * np.abs(whole).max())

    def test_a_step_starts_with_v_K_p_and_ends_at_the_static_gains(self):
        _, g, v, K_p, K_i, p, *_ = parameters = twin.vector()
        step = np.concatenate([np.zeros(10), np.ones(4000)])
        found = simulate(parameters, step, 0.05, "zero", np.zeros(2))
        np.testing.assert_array_equal(found[:, :10], 0)
        at_once = [0, 0, v * K_p, v * K_p / 1.5, K_p]
        at_last = [1, (p - g) / (v * K_i), p, p, (p - g) / v]
        np.testing.assert_allclose(found[:, 10], at_once, rtol=1e-14, atol=1e-14)
        np.testing.assert_allclose(found[:, -1], at_last, rtol=1e-6)

    @pytest.mark.parametrize("hold", ["zero", "first"])
    def test_a_set_point_late_by_whole_samples_shifts_everything(self, parameters, hold):
        quiet = np.concatenate([np.zeros(30), self.rough[:200]])
        parameters = parameters.copy()
        parameters[T_SET] = 0.0
        prompt = simulate(parameters, quiet, self.dt, hold, np.zeros(2))
        parameters[T_SET] = 7 * self.dt
        late = simulate(parameters, quiet, self.dt, hold, np.zeros(2))
        np.testing.assert_allclose(late[:, 7:], prompt[:, :-7], rtol=0, atol=1e-12 * np.abs(prompt).max())

    @pytest.mark.parametrize("hold", ["zero", "first"])
    def test_half_a_sample_late_is_one_sample_late_at_twice_the_rate(self, parameters, hold):
        quiet = np.concatenate([np.zeros(30), self.rough[:200]])
        twice = np.repeat(quiet, 2)
        if hold == "first":
            twice[1:-1:2] = (twice[0:-2:2] + twice[2::2]) / 2
        parameters = parameters.copy()
        parameters[T_SET] = self.dt / 2
        coarse = simulate(parameters, quiet, self.dt, hold, np.zeros(2))
        fine = simulate(parameters, twice, self.dt / 2, hold, np.zeros(2))
        np.testing.assert_allclose(coarse, fine[:, ::2], rtol=0, atol=1e-11 * np.abs(fine).max())

    def test_a_record_that_starts_in_the_middle_of_a_signal(self, parameters):
        """In steady state with the set point off zero from the start, nothing moves, dead times or not."""
        _, g, v, _, K_i, p, *_ = parameters
        start = np.array([0.1, 0.1 * (p - g) / (v * K_i)])
        found = simulate(parameters, np.full(50, 0.1), self.dt, "first", start)
        expected = np.array([*start, 0.1 * p, 0.1 * p, 0.1 * (p - g) / v])
        np.testing.assert_allclose(found, np.repeat(expected[:, None], 50, axis=1), rtol=1e-12)

    @pytest.mark.parametrize("output", ALL)
    def test_steady_sine_is_the_frequency_response(self, parameters, output):
        """The first hold passes f with sinc^2(f dt) and adds images around multiples of the sampling rate."""
        dt, periods, per_period = 0.02, 40, 50
        f = 1 / (per_period * dt)
        k = np.arange(periods * per_period)
        images = f + np.arange(-200, 201) / dt
        gains = np.array([twin.response(parameters, np.abs(images))[output]])
        gains = np.where(images < 0, gains.conj(), gains)[0]
        expected = (gains * np.sinc(images * dt) ** 2).sum()
        sine = np.sin(2 * np.pi * f * k * dt)
        found = simulate(parameters, sine, dt, "first", np.zeros(2))[output]
        last = slice(-4 * per_period, None)
        basis = np.exp(2j * np.pi * f * k[last] * dt)
        amplitude = 2j * (found[last] * basis.conj()).mean()
        # The integrated error keeps a slow transient, exp(-t/10 s) of the launch.
        np.testing.assert_allclose(amplitude, expected, rtol=5e-4 if output == 1 else 1e-5)

    @pytest.mark.parametrize("hold", ["zero", "first"])
    def test_unstable_loops_simulate_until_they_leave_the_numbers(self, hold):
        unstable = twin.vector(K_p=-20.0)
        found = simulate(unstable, np.ones(100), 0.1, hold, np.zeros(2))[:1]
        assert found[0, -1] < -1e60
        with pytest.raises(SimulationError, match=r"diverged at sample \d+ .*an output is not finite"):
            simulate(unstable, np.ones(5000), 0.1, hold, np.zeros(2))[:1]
        np.testing.assert_array_equal(
            simulate(unstable, np.zeros(5000), 0.1, hold, np.zeros(2))[:1], np.zeros((1, 5000))
        )


class TestDeadTimeInTheLoop:
    """The delay network against the method of steps, at a loop gain of b T_d = 0.63."""

    dt, T_d = 0.02, 0.12
    # Errors allowed in n, E, M_b, M_g, X, as a share of each one's largest value.
    smooth = np.array([1e-5, 1e-6, 2e-4, 2e-4, 1e-5])
    rough = np.array([1e-3, 1e-5, 2e-2, 2e-2, 1e-3])

    def compare(self, dn_set, hold, T_set, allowed):
        parameters = twin.vector(T_d=self.T_d, T_set=T_set, K_p=5.0)
        start = np.zeros(2)
        expected = twin.simulate_delayed(parameters, dn_set, self.dt, hold)
        found = simulate(parameters, dn_set, self.dt, hold, start)
        largest = np.abs(expected).max(axis=1)
        np.testing.assert_array_less(np.abs(found - expected).max(axis=1), allowed * largest)

    @pytest.mark.parametrize("T_set", [0.0, 0.055])
    def test_chirp(self, T_set):
        """Up to omega T_d = 3, where the [5/6] Pade approximation is in error by 2.4e-6."""
        time = np.arange(0, 12, self.dt)
        chirp = 0.01 * np.sin(3 / self.T_d * time**2 / 2 / time[-1])
        self.compare(chirp, "first", T_set, self.smooth)

    @pytest.mark.parametrize("hold", ["zero", "first"])
    def test_step(self, hold):
        """A step holds all frequencies: the network blurs the echo of its corner over a fraction of T_d."""
        self.compare(np.repeat([0.0, 0.05], [20, 300]), hold, 0.055, self.rough)

    @pytest.mark.parametrize("hold", ["zero", "first"])
    def test_vanishes_with_the_dead_time(self, hold):
        """A network of a millionth of a sample changes nothing but the sample of a step itself."""
        rough = TestSimulation.rough
        start = TestSimulation.initial
        without = simulate(twin.vector(), rough, self.dt, hold, start)
        for share in (1e-10, 1e-8, 1e-7, 1e-6):
            parameters = twin.vector(T_d=share * self.dt)
            found = simulate(parameters, rough, self.dt, hold, start)
            # With a staircase, torque answers to a step one sample late as soon as there is a dead time.
            rows = [0, 1, 4] if hold == "zero" and share > 1e-9 else ALL
            np.testing.assert_allclose(found[rows], without[rows], rtol=0, atol=10 * share)


class TestSensitivities:
    initial = TestSimulation.initial
    dn_set = TestSimulation.rough[:80]
    dt = 0.05

    def simulate(self, point, hold):
        parameters, start = point[:9].copy(), point[9:].copy()
        return simulate(parameters, self.dn_set, self.dt, hold, start)

    def sensitivities(self, parameters, hold, wrt):
        return sensitivities(parameters, self.dn_set, self.dt, hold, self.initial, wrt)

    @staticmethod
    def assert_close(found, expected, share, what=""):
        scale = np.abs(expected).max(axis=1, keepdims=True)
        np.testing.assert_allclose((found - expected) / (scale + 1e-3), 0, atol=share, err_msg=what)

    @pytest.mark.parametrize("hold", ["zero", "first"])
    @pytest.mark.parametrize("T_set", [0.12, 3.6 * dt])
    def test_against_differences_of_the_reference(self, hold, T_set):
        parameters = twin.vector(T_set=T_set)
        point = np.concatenate([parameters, self.initial])
        wrt = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10]
        _, found = self.sensitivities(parameters, hold, wrt)

        def reference(x):
            return twin.simulate(x[:9], self.dn_set, self.dt, hold, x[9:])

        for row, index in zip(found, wrt, strict=True):
            step = 1e-3 if index == T_SET else 2e-3 * max(abs(point[index]), 0.1)
            self.assert_close(row, richardson(reference, point, index, step), 1e-6, str(index))

    @pytest.mark.parametrize("hold", ["zero", "first"])
    @pytest.mark.parametrize("T_d", [1e-3 * dt, 0.3 * dt, 2.4 * dt, 0.82])
    def test_against_differences_of_the_kernel(self, hold, T_d):
        parameters = twin.vector(T_d=T_d, T_set=1.35 * self.dt, K_p=min(3.0, 0.4 / T_d))
        point = np.concatenate([parameters, self.initial])
        wrt = list(range(11))
        values, found = self.sensitivities(parameters, hold, wrt)
        # Without sensitivities other instances of the same code run, so not to the bit.
        np.testing.assert_allclose(values, self.simulate(point, hold), rtol=0, atol=1e-12)
        for index in wrt:
            step = 1e-3 * max(abs(point[index]), 0.1)
            if index in (T_D, T_SET):
                step = min(0.1 * point[index], 2e-3 * self.dt)
            expected = richardson(lambda x: self.simulate(x, hold), point, index, step)
            self.assert_close(found[index], expected, 1e-6, str(index))

    def test_by_the_dead_time_where_there_is_none(self):
        """At T_d = 0 the derivative is the one-sided one, and asking for it leaves the outputs alone."""
        parameters = twin.vector(K_p=3.0, T_set=0.35 * self.dt)
        point = np.concatenate([parameters, self.initial])
        values, found = self.sensitivities(parameters, "first", [T_D])
        np.testing.assert_allclose(values, self.simulate(point, "first"), rtol=0, atol=1e-8)

        def forward(step):
            one, two = (self.simulate(point + k * step * np.eye(11)[T_D], "first") for k in (1, 2))
            return (4 * one - two - 3 * values) / (2 * step)

        self.assert_close(found[0], (4 * forward(5e-4) - forward(1e-3)) / 3, 1e-4)

    def test_by_the_dead_time_against_the_method_of_steps(self):
        dt, T_d = 0.02, 0.12
        time = np.arange(0, 6, dt)
        chirp = 0.01 * np.sin(2 / T_d * time**2 / 2 / time[-1])
        parameters = twin.vector(T_d=T_d, T_set=0.05, K_p=5.0)
        _, found = sensitivities(parameters, chirp, dt, "first", np.zeros(2), [T_D])

        def reference(x):
            return twin.simulate_delayed(x, chirp, dt, "first")

        self.assert_close(found[0], richardson(reference, parameters, T_D, 0.01), 1e-3)

    def test_segments_meet_unseen(self):
        """A long record, run in segments, begins like a short one, run in one piece."""
        parameters = twin.vector(T_d=0.12, T_set=0.02, K_p=3.0)
        rough, wrt = TestSimulation.rough, list(range(11))
        _, long = sensitivities(parameters, rough, self.dt, "first", self.initial, wrt)
        _, short = sensitivities(parameters, rough[:500], self.dt, "first", self.initial, wrt)
        np.testing.assert_allclose(short, long[:, :, :500], rtol=0, atol=1e-11 * np.abs(long).max())

    @pytest.mark.parametrize(("outputs", "rank"), [([0], 3), ([0, 2], 4), ([0, 2, 4], 5)])
    def test_rank_tells_what_can_be_identified(self, outputs, rank):
        """Of tau_n, g, v, K_p, K_i: three combinations by speed, four with torque, all with the rack."""
        _, found = sensitivities(twin.vector(), self.dn_set, self.dt, "first", np.zeros(2), [0, 1, 2, 3, 4])
        found = found[:, outputs]
        columns = found.reshape(5, -1).T
        singular = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
        assert (singular > 1e-9 * singular[0]).sum() == rank


unit = st.floats(-1, 1)
records = st.lists(unit, min_size=2, max_size=40).map(np.array)
cases = st.sampled_from(sorted(CASES))


class TestProperties:
    @staticmethod
    def run(parameters, dn_set, start=(0, 0)):
        return simulate(parameters, dn_set, 0.1, "first", np.array(start, dtype=float))

    @settings(max_examples=30)
    @given(records, records, unit, unit, cases)
    def test_superposition(self, one, other, factor, start, case):
        size = min(one.size, other.size)
        one, other, parameters = one[:size], other[:size], CASES[case]
        both = self.run(parameters, one + factor * other, (start, -start))
        parts = self.run(parameters, one, (start, -start)) + factor * self.run(parameters, other)
        np.testing.assert_allclose(both, parts, rtol=0, atol=1e-11)

    @settings(max_examples=30)
    @given(records, st.integers(1, 600), cases)
    def test_time_invariance(self, record, wait, case):
        record = np.concatenate([[0.0], record])
        late = self.run(CASES[case], np.concatenate([np.zeros(wait), record]))
        np.testing.assert_allclose(late[:, wait:], self.run(CASES[case], record), rtol=0, atol=1e-11)
        np.testing.assert_array_equal(late[:, :wait], 0)
