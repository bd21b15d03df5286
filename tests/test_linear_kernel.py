"""The linear structure's kernels against their NumPy reference and against known answers."""

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError

from .twins import linear as twin

ALL = list(range(5))
CASES = {
    "launch": twin.vector(),
    "dead times": twin.vector(T_d=0.12, T_set=0.3, p=2.17, tau_prop=0.4),
    "slow tug": twin.vector(tau_n=0.4, g=-0.3, v=1.2, K_p=0.8, K_i=2.0, p=2.17, tau_prop=0.43, T_d=0.05),
}


@pytest.fixture(params=CASES)
def parameters(request):
    return CASES[request.param]


class TestResponse:
    frequency = np.concatenate([[0.0], np.geomspace(1e-4, 50, 40)])

    def test_agrees_with_the_loop_equations(self, parameters):
        found = _core.linear_response(parameters, self.frequency, ALL)
        np.testing.assert_allclose(found, twin.response(parameters, self.frequency), rtol=1e-11, atol=1e-13)

    def test_static_gains(self, parameters):
        _, g, v, _, K_i, p, *_ = parameters
        found = _core.linear_response(parameters, np.zeros(1), ALL)[:, 0]
        np.testing.assert_allclose(found, [1, (p - g) / (v * K_i), p, p, (p - g) / v], rtol=1e-14)

    def test_high_frequency_gains(self, parameters):
        """Far above the corner speed stands still: torque follows v K_p, the gauge its share of the inertia."""
        tau_n, _, v, K_p, _, _, tau_prop, *_ = parameters
        found = np.abs(_core.linear_response(parameters, np.array([1e6]), ALL)[:, 0])
        np.testing.assert_allclose(
            found, [0, 0, v * K_p, v * K_p * tau_prop / tau_n, K_p], rtol=1e-4, atol=1e-4
        )

    def test_low_frequency_delay(self):
        """(p - g)/(v K_i) + T_set; the dead time inside the loop does not add to it."""
        parameters = CASES["dead times"]
        _, g, v, _, K_i, p, _, _, T_set = parameters
        frequency = np.array([1e-6])
        n = _core.linear_response(parameters, frequency, [0])[0]
        delay = -np.angle(n) / (2 * np.pi * frequency)
        np.testing.assert_allclose(delay, (p - g) / (v * K_i) + T_set, rtol=1e-6)

    def test_derivatives(self, parameters):
        wrt = list(range(9))
        values, derivatives = _core.linear_response_sensitivities(parameters, self.frequency, ALL, wrt)
        np.testing.assert_array_equal(values, _core.linear_response(parameters, self.frequency, ALL))
        for index in wrt:
            step = 1e-4 * max(abs(parameters[index]), 0.1)
            expected = richardson(lambda x: twin.response(x, self.frequency), parameters, index, step)
            np.testing.assert_allclose(derivatives[index], expected, rtol=1e-7, atol=1e-7)

    def test_rows_are_the_outputs_asked_for(self, parameters):
        every = _core.linear_response(parameters, self.frequency, ALL)
        np.testing.assert_array_equal(
            _core.linear_response(parameters, self.frequency, [3, 0]), every[[3, 0]]
        )

    def test_no_integral_action_has_no_static_response(self):
        with pytest.raises(InputError, match=r"frequency_hz\[1\].*0 Hz.*K_i"):
            _core.linear_response(twin.vector(K_i=0.0), np.array([1.0, 0.0]), [0])

    def test_refuses_a_bad_frequency(self, parameters):
        with pytest.raises(InputError, match=r"frequency_hz\[1\]: found -1"):
            _core.linear_response(parameters, np.array([1.0, -1.0]), [0])

    def test_has_no_initial_state_to_differentiate_by(self, parameters):
        with pytest.raises(InputError, match="wrt: found index 9, expected 0 to 8"):
            _core.linear_response_sensitivities(parameters, self.frequency, ALL, [9])


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (twin.vector(tau_n=0.0), "tau_n = 0 s, expected a time constant above 0"),
        (twin.vector(T_d=-0.1), r"T_d = -0.1 s, expected a dead time of 0 or more"),
        (twin.vector(v=np.nan), "v = NaN, expected a finite number"),
        (twin.vector()[:8], "found 8 values, expected 9 in the order"),
        (
            twin.vector().astype(np.float32),
            r"found float32 of shape \[9\], expected a C-contiguous float64",
        ),
        (np.repeat(twin.vector(), 2)[::2], "not C-contiguous"),
        (list(twin.vector()), "parameters: found <class 'list'>"),
    ],
)
def test_parameters_are_checked(bad, message):
    with pytest.raises(InputError, match=message):
        _core.linear_response(bad, np.ones(1), [0])


@pytest.mark.parametrize(
    ("outputs", "message"), [([], "outputs is empty"), ([0, 5], "outputs: found index 5")]
)
def test_outputs_are_checked(outputs, message):
    with pytest.raises(InputError, match=message):
        _core.linear_response(twin.vector(), np.ones(1), outputs)


def richardson(function, point, index, step):
    """Central difference of order four by one entry of `point`."""

    def central(h):
        shift = h * np.eye(point.size)[index]
        return (function(point + shift) - function(point - shift)) / (2 * h)

    return (4 * central(step / 2) - central(step)) / 3
