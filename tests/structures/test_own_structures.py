"""A user's own structures run like the linear one: same estimates, same intervals, same reports."""

import doctest
import math

import numpy as np
import pytest
from scipy.signal import lfilter

from shipfp_rs import signals
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.identify import fingerprint_of, identify, posed
from shipfp_rs.identification.question import Options
from shipfp_rs.structures import structure
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support import derivatives
from shipfp_rs.support.derivatives import Differences
from tests.twins import linear as twin

LINEAR = Structure.linear(products=True).with_fixed(p=2.0)
PARAMETERS = [parameter for parameter in LINEAR.parameters if not parameter.fixed]
TRUTH = {"tau_n": 1.5, "g": -0.583, "vK_p": 15.83, "vK_i": 1.583}


def thesis_matrices(q):
    """States n* and E*, outputs n* and M_b*: eq. 3.46 to 3.54."""
    tau_n, g, vK_p, vK_i = q["tau_n"], q["g"], q["vK_p"], q["vK_i"]
    A = np.array([[-(2 - g + vK_p) / tau_n, vK_i / tau_n], [-1, 0]])
    return A, np.array([vK_p / tau_n, 1]), np.array([[1, 0], [g - vK_p, vK_i]]), np.array([0, vK_p])


def with_math(q):
    """The same, but through a function that takes no complex numbers."""
    return thesis_matrices({**q, "tau_n": math.exp(math.log(q["tau_n"]))})


@pytest.fixture(scope="module")
def experiment():
    """A noisy chirp of the launch that starts off balance."""
    excitation = signals.chirp(0.01, 5.0, 60.0, 13.0, rate_hz=50.0)
    dn_set = excitation.samples / 1300.0
    clean = twin.simulate(
        twin.vector(), dn_set, 1 / excitation.rate_hz, excitation.hold, np.array([0.004, 0.01])
    )[[0, 2]]
    random = np.random.default_rng(1)
    dn, dM = clean + random.normal(size=clean.shape) * clean.std(axis=1, keepdims=True) * 0.05
    return Experiment(
        "chirp",
        excitation.rate_hz,
        {"n_set": 1300 * (1 + dn_set), "n_e": 1300 * (1 + dn), "M_b": 220 * (1 + dM)},
        {"n_set": 1300.0, "n_e": 1300.0, "M_b": 220.0},
        hold=excitation.hold,
    )


def from_matrices(matrices=thesis_matrices):
    return Structure.from_matrices(matrices, PARAMETERS, ["dn", "dM"], name="own")


class TestMatrices:
    names = ("tau_n", "g", "vK_p", "vK_i")

    @pytest.mark.parametrize("matrices", [thesis_matrices, with_math])
    def test_sensitivities_are_those_of_the_linear_structure(self, experiment, matrices):
        own = from_matrices(matrices).equations
        expected = LINEAR.equations.sensitivities(
            {**TRUTH, "p": 2.0, "initial dn": 0.01, "initial dE": 0.02},
            experiment,
            (*self.names, "initial dn", "initial dE"),
        )
        found = own.sensitivities(
            {**TRUTH, "initial x1": 0.01, "initial x2": 0.02}, experiment, (*self.names, *own.states)
        )
        assert own.differences.complex_step == (matrices is thesis_matrices)
        for value, known in zip(found, expected, strict=True):
            np.testing.assert_allclose(value, known, rtol=1e-9, atol=1e-10 * np.abs(known).max())

    def test_frequency_response_is_that_of_the_linear_structure(self):
        frequency = np.geomspace(0.001, 10, 20)
        own = from_matrices().equations
        expected = LINEAR.equations.response({**TRUTH, "p": 2.0}, frequency, self.names)
        for value, known in zip(own.response(TRUTH, frequency, self.names), expected, strict=True):
            np.testing.assert_allclose(value, known, rtol=1e-9, atol=1e-11)

    def test_identification_gives_the_same_fingerprint(self, experiment):
        """The thesis's 2-state structure written as matrices."""
        own, linear = (identify(experiment, structure) for structure in (from_matrices(), LINEAR))
        for name in self.names:
            # In a wider band: nobody knows what an own structure answers to.
            assert own[name].value == pytest.approx(linear[name].value, abs=2.0 * linear[name].std)
            assert own[name].std == pytest.approx(linear[name].std, rel=0.1)
        assert own.identifiability.rank == 4
        assert own.fit["dM"]["nrmse_pct"] == pytest.approx(linear.fit["dM"]["nrmse_pct"], rel=1e-3)
        assert own.structure["kind"] == "matrices"

    def test_identification_from_a_frequency_response(self):
        frequency = np.geomspace(0.01, 5, 15)
        dn, dM = twin.response(twin.vector(), frequency)[[0, 2]]
        found = identify(FrequencyResponse("sines", frequency, {"n_e": dn, "M_b": dM}), from_matrices())
        for name, truth in TRUTH.items():
            assert found[name].value == pytest.approx(truth, rel=1e-6)

    def test_unidentifiable_parameters_are_named(self, experiment):
        """v, K_p and K_i show only as products."""

        def matrices(q):
            return thesis_matrices({**q, "vK_p": q["v"] * q["K_p"], "vK_i": q["v"] * q["K_i"]})

        linear = Structure.linear()
        parameters = [parameter for parameter in linear.parameters if not parameter.fixed]
        own = Structure.from_matrices(matrices, parameters, ["dn", "dM"], name="own")
        found = identify(experiment, own)
        assert found.identifiability.rank == 4
        assert {n for n, e in found.parameters.items() if e.status == "unidentifiable"} == {"v", "K_p", "K_i"}

    def test_derivative_by_a_parameter_of_the_outputs_only(self, experiment):
        def matrices(q):
            return [[-1.0]], [1.0], [[q["gain"]]], [0.0]

        own = Structure.from_matrices(matrices, [Parameter("gain", "-", 1, 0, 5)], ["dn"], name="gain")
        value, slope = own.equations.sensitivities({"gain": 2.0}, experiment, ["gain"])
        np.testing.assert_allclose(2.0 * slope[0], value, rtol=1e-12, atol=1e-15)

    @pytest.mark.parametrize(
        ("matrices", "message"),
        [
            (lambda q: (np.eye(2), [1, 0], [[1, 0]], [0]), r"C has shape \(1, 2\), expected \(2, 2\)"),
            (
                lambda q: (np.ones((2, 1)), [1, 0], np.eye(2), [0, 0]),
                r"A has shape \(2, 1\), expected \(2, 2\)",
            ),
            (
                lambda q: (np.eye(2), [1], np.eye(2), [0, 0]),
                r"B has shape \(1,\), expected \(2,\) or \(2, 1\)",
            ),
        ],
    )
    def test_shapes_are_checked_when_declared(self, matrices, message):
        with pytest.raises(InputError, match=message):
            Structure.from_matrices(matrices, PARAMETERS, ["dn", "dM"], name="own")

    @pytest.mark.parametrize("bad", [np.inf, np.nan])
    def test_values_that_make_no_matrix_are_failures_of_the_simulation(self, experiment, bad):
        def matrices(q):
            A, B, C, D = thesis_matrices(q)
            return A * (bad if q["tau_n"] > 2 else 1), B, C, D

        with pytest.raises(SimulationError, match="matrices: A is not finite with tau_n 3, g "):
            from_matrices(matrices).equations.simulate({**TRUTH, "tau_n": 3.0}, experiment)

    def test_division_by_zero_is_one_too(self, experiment):
        def matrices(q):
            return [[-1.0 / q["tau"]]], [1.0 / q["tau"]], [[1.0]], [0.0]

        own = Structure.from_matrices(matrices, [Parameter("tau", "s", 1, 0, 5)], ["dn"], name="lag")
        with pytest.raises(SimulationError, match=r"matrices: .*division by zero with tau 0"):
            own.equations.simulate({"tau": 0.0}, experiment)


def first_order_lag(q, experiment):
    """Gain and lag of the torque, the set point held between samples."""
    keep = np.exp(-1 / (q["tau"] * experiment.rate_hz))
    return q["gain"] * lfilter([0, 1 - keep], [1, -keep], experiment.normalised("n_set"))[None]


LAG = [Parameter("gain", "-", 1.0, 0.0, 10.0), Parameter("tau", "s", 1.0, 0.01, 10.0)]


@pytest.fixture(scope="module")
def lagging():
    dn_set = 0.01 * np.sign(np.sin(np.arange(2000) / 60))
    record = {"n_set": 1300 * (1 + dn_set), "M_b": np.zeros(2000)}
    bare = Experiment("steps", 50.0, record, {"n_set": 1300.0, "M_b": 220.0}, hold="zero")
    dM = first_order_lag({"gain": 2.2, "tau": 0.7}, bare)[0]
    noise = np.random.default_rng(2).normal(size=2000) * 1e-3
    return Experiment(
        "steps", 50.0, {**record, "M_b": 220 * (1 + dM + noise)}, bare.operating_point, hold="zero"
    )


class TestFunction:
    def test_a_lag_of_the_torque_is_identified(self, lagging):
        structure = Structure.from_function(first_order_lag, LAG, {"dM": "M_b"}, name="lag")
        found = identify(lagging, structure)
        for name, truth in {"gain": 2.2, "tau": 0.7}.items():
            assert abs(found[name].value - truth) < 4 * found[name].std
            assert found[name].std < 0.01 * truth
        assert found.identifiability.rank == 2
        assert found.fit["dM"]["nrmse_pct"] > 90

    def test_it_agrees_with_the_matrices(self, lagging):
        def matrices(q):
            return [[-1 / q["tau"]]], [1 / q["tau"]], [[q["gain"]]], [0]

        function = Structure.from_function(first_order_lag, LAG, {"dM": "M_b"}, name="lag")
        model = Structure.from_matrices(matrices, LAG, {"dM": "M_b"}, name="lag")
        first, second = (
            fingerprint_of(posed([lagging], s, Options(at_rest=True))) for s in (function, model)
        )
        for name in ("gain", "tau"):
            assert first[name].value == pytest.approx(second[name].value, rel=1e-7)
            assert first[name].std == pytest.approx(second[name].std, rel=1e-5)

    def test_frequency_response(self):
        def response(q, frequency_hz):
            return (q["gain"] / (1 + 2j * np.pi * frequency_hz * q["tau"]))[None]

        structure = Structure.from_function(first_order_lag, LAG, ["dM"], name="lag", response=response)
        frequency = np.geomspace(0.01, 5, 12)
        value, slopes = structure.equations.response({"gain": 2.2, "tau": 0.7}, frequency, ("gain", "tau"))
        s = 2j * np.pi * frequency
        np.testing.assert_allclose(
            slopes[:, 0], [1 / (1 + 0.7 * s), -2.2 * s / (1 + 0.7 * s) ** 2], atol=1e-10
        )
        found = identify(FrequencyResponse("sines", frequency, {"M_b": value[0]}), structure)
        assert found["tau"].value == pytest.approx(0.7, rel=1e-6)

    def test_without_a_frequency_response_says_so(self):
        structure = Structure.from_function(first_order_lag, LAG, ["dM"], name="lag")
        with pytest.raises(InputError, match=r"no frequency response; give Structure\.from_function"):
            structure.equations.response({"gain": 1, "tau": 1}, np.ones(1), ())

    @pytest.mark.parametrize(
        ("returned", "error", "message"),
        [
            (
                np.zeros(2000),
                InputError,
                r"returned shape \(2000,\), expected \(1, 2000\), a row for each of dM",
            ),
            (
                np.full((1, 2000), np.nan),
                SimulationError,
                "returned values that are not finite with gain 1, tau 1",
            ),
        ],
    )
    def test_what_it_returns_is_checked(self, lagging, returned, error, message):
        structure = Structure.from_function(lambda q, e: returned, LAG, {"dM": "M_b"}, name="lag")
        with pytest.raises(error, match=message):
            structure.equations.simulate({"gain": 1, "tau": 1}, lagging)

    @pytest.mark.parametrize(
        ("outputs", "message"),
        [
            (["thrust"], "output 'thrust', expected some of dn, dM, dE, dX, or a mapping"),
            (["dn", "dn"], "expected at least one and each once"),
            ({}, "expected at least one"),
        ],
    )
    def test_outputs_are_checked(self, outputs, message):
        with pytest.raises(InputError, match=message):
            Structure.from_function(first_order_lag, LAG, outputs, name="lag")


class TestDifferences:
    """Derivatives of x0 exp(-x1 t) sin(x2 t) against the written-out ones."""

    t = np.linspace(0, 5, 200)
    point = np.array([2.0, 0.3, 4.0])

    def function(self, x):
        return x[0] * np.exp(-x[1] * self.t) * np.sin(x[2] * self.t)

    def exact(self):
        a, b, c = self.point
        decay = np.exp(-b * self.t)
        sine = decay * np.sin(c * self.t)
        return np.array([sine, -a * self.t * sine, a * self.t * decay * np.cos(c * self.t)])

    def check(self, slopes, digits):
        exact = self.exact()
        error = np.abs(slopes - exact).max(axis=1) / np.abs(exact).max(axis=1)
        assert error.max() < 10.0**-digits

    def test_by_complex_step_to_rounding(self):
        differences = Differences()
        self.check(differences(self.function, self.point, np.ones(3))[1], 14)
        assert differences.complex_step

    def test_by_differences(self):
        self.check(Differences(complex_step=False)(self.function, self.point, np.ones(3))[1], 9)

    @pytest.mark.parametrize("side", [-1, 1])
    def test_on_a_bound(self, side):
        seen = []

        def function(x):
            seen.append(np.array(x))
            return self.function(x)

        bounds = {"lower": self.point} if side > 0 else {"upper": self.point}
        self.check(Differences(complex_step=False)(function, self.point, np.ones(3), **bounds)[1], 7)
        assert all((side * (x - self.point) >= 0).all() for x in seen)

    @pytest.mark.parametrize(
        "spoil",
        [
            pytest.param(np.abs, id="abs"),
            pytest.param(np.real, id="drops the imaginary part"),
            pytest.param(lambda x: np.array([float(v) for v in x]), id="raises"),
        ],
    )
    def test_a_function_that_is_not_analytic_is_found_out(self, spoil):
        differences = Differences()
        self.check(differences(lambda x: self.function(spoil(x)), self.point, np.ones(3))[1], 9)
        assert differences.complex_step is False

    def test_step_shrinks_where_the_function_is_wilder_than_its_parameter(self):
        wild = np.array([1e5])
        _, slope = Differences(complex_step=False)(np.sin, wild, np.ones(1))
        np.testing.assert_allclose(slope[0], np.cos(wild), atol=1e-8)


@pytest.mark.parametrize("module", [structure, derivatives])
def test_examples_run(module):
    result = doctest.testmod(module)
    assert result.attempted
    assert not result.failed
