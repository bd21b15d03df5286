"""The thesis's plant as a ship with a method of one's choice: its NumPy twin, a solution of high order, and physics."""

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.vessel.drive_train import PLANT_PARAMETERS
from tests.twins import plant as twin
from tests.twins.plant import M_B, N_E, UNLIMITED, vector
from tests.twins.ship import vector as ship_vector

METHODS = ["euler", "heun", "rk4"]
HOLDS = ["zero", "first"]
AT_REST = np.array([N_E / 3.0, 0.0])
SEVEN_POINTS = (
    np.array([10.0, 15.0, 18.0, 21.0, 23.0, 26.0, 30.0]),
    np.array([100.0, 220.0, 260.0, 300.0, 280.0, 330.0, 200.0]),
)
TEN_POINTS = (np.linspace(12.0, 30.0, 10), 250.0 + 60.0 * np.sin(np.arange(10.0)))
ENVELOPES = {
    "unlimited": UNLIMITED,
    "constant": (np.array([20.0]), np.array([1.3 * M_B])),
    "seven points": SEVEN_POINTS,
    "ten points": TEN_POINTS,
}
REFERENCE = Path(__file__).parents[1] / "data" / "reference_steps.csv"


def wander(samples, seed=804, scale=0.06):
    """A set point that wanders about the operating point."""
    return N_E * (1.0 + scale * np.random.default_rng(seed).normal(size=samples).cumsum() / np.sqrt(samples))


def simulate(parameters, envelope, n_set, dt=0.01, substeps=1, method="rk4", hold="first", initial=AT_REST):
    """Rows n_s, E_n, X_f, M_b of the plant, divided by its steady state at N_E for the kernel."""
    q = dict(zip(PLANT_PARAMETERS, parameters.tolist(), strict=True))
    n_s, ratio = N_E / q["gear_ratio"], q["gear_ratio"] * q["transmission_efficiency"]
    torque = q["torque_coefficient"] * n_s ** q["torque_exponent"] / ratio
    rack = (torque - q["A2"] * N_E - q["A3"]) / q["A1"]
    # A rack that is not the steady one without an error is a sum that is not zero.
    sum_of_rack = (q["X_0"] - rack) / q["Ki_abs"] if q["Ki_abs"] else 0.0
    ship = ship_vector(
        tau_n=2.0 * np.pi * q["inertia"] * n_s / (torque * ratio),
        g=q["A2"] * N_E / torque,
        v=q["A1"] * rack / torque,
        K_p=q["Kp_abs"] * N_E / rack,
        K_i=q["Ki_abs"] * N_E / rack,
        p=q["torque_exponent"],
        M_min=q["minimum_torque"] / torque,
    )
    start = np.array([initial[0] / n_s, (initial[1] + sum_of_rack) / N_E])
    limit = np.array([envelope[0] / N_E, envelope[1] / torque])
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dE", "dX", "dM_b")]
    rows = _core.simulate_ship_by(ship, n_set / N_E, dt, substeps, method, hold, start, outputs, limit)
    scale = np.array([[n_s], [N_E], [rack], [torque]])
    shift = np.array([[n_s], [-sum_of_rack], [rack], [torque]])
    return rows * scale + shift


def assert_close(found, expected, tolerance=1e-12):
    """Equal to a part of each row's own size, since a torque may pass through zero."""
    size = np.abs(expected).max(axis=-1, keepdims=True)
    np.testing.assert_array_less(np.abs(found - expected), np.broadcast_to(tolerance * size, found.shape))


def similar_ship(seed):
    """A launch of which each parameter but the exponent lies up to a fifth from the launch's."""
    parameters = vector() * (1.0 + 0.2 * np.random.default_rng(seed).uniform(-1.0, 1.0, 12))
    parameters[PLANT_PARAMETERS.index("torque_exponent")] = 2.0
    return parameters


VARIANTS = [
    (1, {}),
    (3, {}),
    (1, {"torque_exponent": 2.17, "torque_coefficient": 8.7, "minimum_torque": 150.0, "A3": 5.0}),
]
"""Steps a sample and changed parameters; each method, hold and envelope meets one, every two of them meet all."""


@pytest.mark.parametrize("envelope", ENVELOPES)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("method", METHODS)
def test_agrees_with_the_equations_as_they_stand(method, hold, envelope):
    place = METHODS.index(method) + HOLDS.index(hold) + [*ENVELOPES].index(envelope)
    substeps, changes = VARIANTS[place % 3]
    run = (wander(300), 0.02, substeps, method, hold, np.array([6.5, 0.8]))
    found = simulate(vector(**changes), ENVELOPES[envelope], *run)
    expected = twin.simulate(vector(**changes), *ENVELOPES[envelope], *run)
    limited = 0 < np.count_nonzero(expected[3] == expected[3].max()) < 300
    assert limited or envelope != "constant"
    assert_close(found, expected)


def test_euler_is_the_recursion_that_made_the_published_data():
    h, n_set = 0.01, wander(50)
    rows = simulate(vector(), UNLIMITED, n_set, dt=h, method="euler", hold="zero")
    n_s, E_n, X_f, M_b = rows[:, :-1]
    q = twin.LAUNCH
    M_s, M_p = M_b * 3.0 * 0.95, q["torque_coefficient"] * n_s**2
    expected = [n_s + h * (M_s - M_p) / (2 * np.pi * 21.2), E_n + h * (n_set[:-1] - 3.0 * n_s)]
    np.testing.assert_allclose(rows[:2, 1:], expected, rtol=1e-14)
    np.testing.assert_allclose(M_b, q["A1"] * X_f + q["A2"] * 3.0 * n_s, rtol=1e-13)


def test_a_sample_already_has_its_own_set_point():
    n_set = np.array([N_E, N_E, 1.1 * N_E, 1.1 * N_E])
    for hold in HOLDS:
        X_f = simulate(vector(), UNLIMITED, n_set, hold=hold)[2]
        assert X_f[1] == pytest.approx(13.07, rel=1e-12)
        assert X_f[2] - X_f[1] == pytest.approx(6.0323 * 0.1 * N_E, rel=0.01 if hold == "zero" else 0.1)


@pytest.mark.parametrize(("limit", "tolerance"), [("none", 3e-9), ("2.0", 3e-6)])
@pytest.mark.parametrize("step", ["0.05", "0.20"])
def test_steps_agree_with_an_independent_solution(step, limit, tolerance):
    with REFERENCE.open() as file:
        rows = [
            [float(row[name]) for name in ("shaft_speed_rps", "integrated_error_rev", "shaft_torque_Nm")]
            for row in csv.DictReader(file)
            if (row["step_fraction"], row["torque_limit_over_Mb0"]) == (step, limit)
        ]
    reference = np.array(rows).T
    envelope = UNLIMITED if limit == "none" else (np.array([10.0]), np.array([2.0 * M_B]))
    n_set = np.full(reference.shape[1], N_E * (1.0 + float(step)))
    n_s, E_n, _, M_b = simulate(vector(), envelope, n_set, dt=0.1, substeps=200)
    assert_close(np.array([n_s, E_n, M_b * 3.0 * 0.95]), reference, tolerance)


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("heun", 2), ("rk4", 4)])
def test_error_falls_with_the_order_of_the_method(method, order):
    n_set = N_E * (1.0 + 0.05 * np.sin(np.linspace(0.0, 2.0, 21)))

    def run(substeps, method=method):
        return simulate(
            vector(torque_exponent=2.17), UNLIMITED, n_set, dt=0.1, substeps=substeps, method=method
        )

    exact = run(2000, "rk4")
    errors = [np.abs(run(substeps) - exact)[0].max() for substeps in (8, 16, 32)]
    orders = [np.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert orders == pytest.approx([order, order], abs=0.15)


@given(
    ratio=st.floats(1.0, 6.0),
    n_s=st.floats(0.5, 30.0),
    p=st.sampled_from([2.0]) | st.floats(1.5, 3.0),
    method=st.sampled_from(METHODS),
    rack_speed=st.floats(-10.0, 0.0),
)
@settings(max_examples=60)
def test_a_steady_state_stays(ratio, n_s, p, method, rack_speed):
    M_b = 12.18 * n_s**p / (ratio * 0.95)
    X_0 = (M_b - rack_speed * ratio * n_s) / 27.0
    parameters = vector(
        gear_ratio=ratio, torque_exponent=p, torque_coefficient=12.18, A1=27.0, A2=rack_speed, X_0=X_0
    )
    rows = simulate(
        parameters, UNLIMITED, np.full(200, ratio * n_s), method=method, initial=np.array([n_s, 0.0])
    )
    np.testing.assert_allclose(rows[[0, 2, 3]].T, np.tile([n_s, X_0, M_b], (200, 1)), rtol=1e-9)


@pytest.mark.parametrize("envelope", ["constant", "seven points", "ten points"])
@given(seed=st.integers(0, 999))
@settings(max_examples=15)
def test_the_envelope_is_never_exceeded(envelope, seed):
    parameters = similar_ship(seed)
    parameters[-1] = -500.0
    run = simulate(parameters, ENVELOPES[envelope], wander(200, seed, scale=0.5))
    allowed = np.interp(parameters[1] * run[0], *ENVELOPES[envelope])
    assert np.all(run[3] <= allowed * (1.0 + 1e-13))
    assert np.all(run[3] >= -500.0 * (1.0 + 1e-13))


def test_standing_still_and_turning_astern():
    """The propeller's torque is odd in the speed: the plant mirrored runs mirrored, through zero as well."""
    mirrored = {"X_0": -13.07, "A3": 0.0}
    for exponent in (2.0, 2.17):
        n_set = np.linspace(-N_E, N_E, 300)
        ahead, astern = (
            simulate(
                vector(torque_exponent=exponent, **changes),
                UNLIMITED,
                sign * n_set,
                dt=0.02,
                initial=np.zeros(2),
            )
            for sign, changes in ((1.0, {}), (-1.0, mirrored))
        )
        assert ahead[0].min() < 0.0 < ahead[0].max()
        np.testing.assert_allclose(astern, -ahead, rtol=0, atol=1e-12)


@pytest.mark.parametrize("exponent", [2.0, 2.17])
@pytest.mark.parametrize("envelope", ENVELOPES)
def test_divergence_names_sample_and_time(envelope, exponent):
    """Euler with steps far beyond the stable 2/12 s, and no lower limit to the torque."""
    unstable = {"dt": 5.0, "method": "euler"}
    n_set = np.full(5000, 2.0 * N_E)
    expected = r"simulation diverged at sample \d+ \(t = \d+\.\d+ s\): \w+ is not finite"
    with pytest.raises(SimulationError, match=expected) as raised:
        simulate(vector(torque_exponent=exponent), ENVELOPES[envelope], n_set, **unstable)
    sample = int(str(raised.value).split("sample ")[1].split()[0])
    shorter = simulate(
        vector(torque_exponent=exponent), ENVELOPES[envelope], n_set[:sample].copy(), **unstable
    )
    assert np.isfinite(shorter).all()


GOOD = {
    "parameters": ship_vector(),
    "u": np.ones(10),
    "dt": 0.01,
    "substeps": 1,
    "method": "rk4",
    "hold": "zero",
    "initial": np.array([1.0, 0.0]),
    "outputs": [0],
    "envelope": np.array([[0.5, 1.0, 1.5], [1.0, 2.0, 1.5]]),
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parameters": np.ones(11)}, "parameters: found 11 values, expected 40"),
        ({"parameters": ship_vector(tau_n=0.0)}, "found tau_n = 0, expected a positive number"),
        ({"parameters": ship_vector(T_d=0.1)}, "found T_d, expected a ship without it"),
        ({"parameters": ship_vector(anti_windup=1.0)}, "found anti_windup, expected a ship without it"),
        ({"parameters": ship_vector(M_max=1.1)}, "found M_max beside an envelope"),
        ({"envelope": np.ones((3, 4))}, r"envelope: found an array of shape \[3, 4\], expected \[2, 4\]"),
        (
            {"envelope": np.array([[1.0, 1.0], [2.0, 2.0]])},
            r"limit_speed\[1\] is 1 after 1, expected ascending",
        ),
        ({"envelope": np.array([[1.0], [np.nan]])}, r"limit_torque\[0\] is NaN, expected a finite"),
        ({"u": np.array([1.0, np.nan])}, r"u\[1\] is NaN, expected a finite number"),
        ({"u": np.empty(0)}, "u has no samples, expected at least 1"),
        ({"u": [1.0, 2.0]}, "u: found .*list.*, expected"),
        ({"dt": 0.0}, "dt is 0, expected a positive sample time"),
        ({"substeps": 0}, "substeps is 0, expected 1 to"),
        ({"method": "rk45"}, "method is 'rk45', expected 'rk4', 'heun' or 'euler'"),
        ({"hold": "second"}, "hold is 'second', expected 'zero' or 'first'"),
        ({"initial": np.array([1.0])}, r"initial is \[1.0\], expected two finite numbers"),
        ({"outputs": [9]}, "outputs: found 9, expected 0 to 5"),
    ],
)
def test_bad_arguments_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        _core.simulate_ship_by(*(GOOD | changes).values())
