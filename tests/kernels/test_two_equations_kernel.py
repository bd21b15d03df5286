"""The two equations' kernel against its NumPy reference, known answers and its own symmetries."""

from functools import cache
from math import comb

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from tests.twins import ship
from tests.twins import two_equations as twin

NAMES = _core.EQUATION_PARAMETERS
INDEX = {name: index for index, name in enumerate(NAMES)}
OFF = {"v": 1.0, "s_M": 1.0, "s_B": 1.0}
LOOP = {
    "tau_n": 1.5,
    "g": -0.583,
    "vK_p": 6.3,
    "vK_i": 1.6,
    "p": 2.17,
    "tau_prop": 0.6,
    "c_2": 0.1,
    "damping": 0.05,
}
LATE = {
    "T_d": 0.12,
    "T_set": 0.035,
    "tau_act": 0.06,
    "T_f": 0.04,
    "tau_eng": 0.11,
    "T_M": 0.03,
    "T_n": 0.02,
    "u_0": 0.002,
    "s_M": 1.03,
    "m_0": 0.004,
    "T_B": 0.025,
    "s_B": 0.98,
}
RATE_HZ, SAMPLES = 8.0, 512
SPACING = 2.0 * np.pi * RATE_HZ / SAMPLES


def vector(**values):
    found = np.zeros(len(NAMES))
    for name, value in {**OFF, **values}.items():
        found[INDEX[name]] = value
    return found


SIN_8 = [(k - 4, comb(8, k) * (-1) ** k / 256.0) for k in range(9)]
"""Harmonics of the taper sin^8 and their weights."""


def tapers(samples=SAMPLES, rate_hz=RATE_HZ):
    """The taper and its time derivatives, exactly."""
    turn, at = 2.0 * np.pi * rate_hz / samples, 2.0 * np.pi * np.arange(samples) / samples
    return np.array(
        [
            sum(weight * ((1j * turn * k) ** order * np.exp(1j * k * at)).real for k, weight in SIN_8)
            for order in range(twin.ORDERS)
        ]
    )


def spectra(signal, count, late=0.0):
    """A signal late by a time, as the kernel takes it, (ORDERS, 2, count)."""
    samples = len(signal)
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE_HZ)
    moved = np.fft.irfft(np.fft.rfft(signal) * np.exp(-2j * np.pi * frequency * late), samples)
    signs = (-1.0) ** np.arange(twin.ORDERS)[:, None]
    found = (np.fft.rfft(moved * tapers(samples), axis=-1) * signs)[:, :count] / np.sqrt(0.5 * samples)
    return np.ascontiguousarray(np.stack([found.real, found.imag], axis=1))


@cache
def record(seed=0, count=64, samples=SAMPLES):
    """Signals without a law between them, and the late ones at delays of a grid."""
    rng = np.random.default_rng(seed)
    speed, torque, rack, load, set_point, brake = (
        0.05 * np.convolve(rng.normal(size=samples), np.hanning(9) / 4.0, "same") for _ in range(6)
    )
    rows = [speed, torque, rack, load, speed**2, speed**3, np.ones(samples), brake]
    signals = np.array([spectra(row, count) for row in rows])
    late = spectra(speed, count, 0.1), spectra(set_point, count, 0.15), spectra(torque, count, 0.05)
    return signals, *late


def arguments(parameters, data, outputs, gauge=False, open_loop=False, propeller=False):
    signals, speed, set_point, torque = data
    dead, both = parameters[INDEX["T_d"]], parameters[INDEX["T_d"]] + parameters[INDEX["T_set"]]
    return (
        parameters,
        signals,
        SPACING,
        [(speed, dead - 0.1), (set_point, both - 0.15), *([(torque, dead - 0.05)] if propeller else [])],
        outputs,
        gauge,
        open_loop,
    )


def noise(outputs, count, knots=5, seed=1):
    """A noise's root, shapes and hats."""
    rng = np.random.default_rng(seed)
    lower = np.tril(np.ones((outputs, outputs)))[:, :, None, None]
    root = rng.normal(size=(outputs, outputs, 2, count)) * lower
    shapes = rng.normal(size=(outputs, outputs, 2, count)) * lower
    at = np.linspace(0.0, knots - 1.0, count)
    hats = np.maximum(0.0, 1.0 - np.abs(at - np.arange(knots)[:, None]))
    return root, shapes, hats


def whole(found):
    return found[..., 0, :] + 1j * found[..., 1, :]


def told(parameters):
    """Parameters that have a derivative at these: a governor that begins to sample has a kink, and so has its lag."""
    samples, lag = parameters[INDEX["T_s"]], parameters[INDEX["tau_act"]] + parameters[INDEX["tau_eng"]]
    kinks = samples and not lag
    off = {"T_s": not samples, "tau_act": kinks, "tau_eng": kinks, "t_1": True}
    return [index for index, name in enumerate(NAMES) if not off.get(name)]


def compare(found, expected, tolerance=1e-6):
    scale = np.abs(expected).max(axis=(1, 2)) + 1e-4 * np.abs(expected).max()
    assert (np.abs(found - expected).max(axis=(1, 2)) / scale).max() < tolerance


TWIST = {"tau_twist": 0.02, "zeta_twist": 0.7}
EVERY = {**TWIST, "vK_d": 0.2, "T_s": 0.19, "k_L": 0.4, "x_0": 0.01, "t_1": 0.8}
CASES = {
    "speed": ([0], {}),
    "speed and torque": ([0, 1], {}),
    "torque and speed": ([1, 0], {}),
    "speed and rack": ([0, 2], {}),
    "speed, torque, rack": ([0, 1, 2], {}),
    "rack, speed, torque": ([2, 0, 1], {}),
    "sampling": ([0, 1], {"T_s": 0.19}),
    "derivative": ([0, 1], {"vK_d": 0.2}),
    "droop": ([0, 1], {"droop": 0.04}),
    "droop and rack, twist": ([0, 1, 2], {"droop": 0.04, **TWIST}),
    "derivative and rack": ([0, 1, 2], {"vK_d": 0.2, "T_s": 0.17}),
    "twist": ([0, 1], TWIST),
    "twist and all": ([1, 2, 0], EVERY),
    "measured load": ([0, 1], {"k_L": 0.4}),
    "measured load, speed alone": ([0], {"k_L": 0.4}),
    "both torques": ([0, 1, 3], {}),
    "both torques, twist": ([3, 2, 1, 0], TWIST),
    "both torques, all": ([0, 1, 3], EVERY),
    "all torques and rack, all": ([3, 2, 1, 0], EVERY),
}


# Each case with every option on and off, one of both at night; four cases in a row meet all eight ways of late, gauge
# and open loop.
@pytest.mark.parametrize(
    ("case", "late"),
    [
        pytest.param(case, late, marks=pytest.mark.slow if (index + late) % 2 else ())
        for index, case in enumerate(CASES)
        for late in (False, True)
    ],
)
def test_residuals_derivatives_and_products_are_those_of_the_twin(case, late):
    outputs, values = CASES[case]
    place = [*CASES].index(case)
    gauge, open_loop = bool(place & 1) ^ late, bool(place & 2) ^ late
    parameters, data = vector(**LOOP, **(LATE if late else {}), **values), record()
    asked = arguments(parameters, data, outputs, gauge or 3 in outputs, open_loop)
    wrt = told(parameters)
    rows = whole(_core.equation_residuals(*asked, wrt))
    # With all three lags the polynomials are of the sixth degree; see the propeller's speed below.
    compare(rows, twin.rows(*asked, wrt), 1e-5)
    units = noise(len(outputs), data[0].shape[3])
    for found, expected in zip(
        _core.equation_products(*asked, wrt, *units), twin.products(rows, *units), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize(("late", "open_loop"), [(False, True), (True, False)])
@pytest.mark.parametrize("outputs", [[0, 1], [3, 2, 1, 0]])
@pytest.mark.parametrize("more", [{}, TWIST, EVERY])
@pytest.mark.parametrize("gauge", [True, False])
def test_a_propellers_speed_is_that_of_the_twin(gauge, more, outputs, open_loop, late):
    parameters = vector(**LOOP, **(LATE if late else {}), **more)
    asked = arguments(parameters, record(), outputs, gauge or 3 in outputs, open_loop, propeller=True)
    wrt = told(parameters)
    # Polynomials of the fifth degree: the taper's fourth derivative, which neither has, differs in delays' derivatives.
    compare(whole(_core.equation_residuals(*asked, wrt)), twin.rows(*asked, wrt), 1e-5)


def test_mixtures_of_both_equations_are_the_same_linear_ship():
    """Where the load's law is a straight line and the engine has no lag, no noise tells what a set point can't."""
    data = record()
    data[0][[_core.EQUATION_SIGNALS.index(name) for name in ("N2", "N3")]] = 0.0
    asked = arguments(vector(**LOOP, **(LATE | {"tau_eng": 0.0}), t_1=0.7), data, [0, 1], gauge=True)
    rows = whole(_core.equation_residuals(*asked, []))
    q = dict(zip(NAMES, asked[0], strict=True))
    more = 0.1
    mixed = {name: (1.0 + more) * q[name] for name in ("vK_p", "vK_i")}
    mixed["tau_n"] = q["tau_prop"] + (1.0 + more) * (q["tau_n"] - q["tau_prop"]) + more * q["tau_prop"]
    mixed["g"] = (1.0 + more) * q["g"] - more * (q["p"] + q["damping"])
    there = asked[0].copy()
    for name, value in mixed.items():
        there[INDEX[name]] = value
    other = whole(_core.equation_residuals(there, *asked[1:], []))
    np.testing.assert_allclose(other[0], rows[0], atol=1e-12 * np.abs(rows[0]).max())


SHIP = vector(**LOOP, **LATE, k_L=0.3)
MOVING = [
    INDEX[name] for name in ("tau_n", "g", "vK_p", "p", "k_L", "T_d", "T_set", "tau_act", "T_M", "u_0", "s_M")
]


class TestSymmetries:
    @settings(max_examples=30, deadline=None)
    @given(
        seed=st.integers(0, 2**32 - 1),
        outputs=st.sampled_from([[0], [0, 1], [1, 0], [0, 2], [2, 0, 1], [1, 3, 0], [0, 3, 1, 2]]),
        wrt=st.lists(st.integers(0, len(NAMES) - 1), max_size=24),
        knots=st.integers(2, 9),
        bent=st.booleans(),
    )
    def test_products_are_those_of_whitened_rows(self, seed, outputs, wrt, knots, bent):
        data = record(seed)
        asked = arguments(SHIP, data, outputs, gauge=True)
        root, shapes, hats = noise(len(outputs), data[0].shape[3], knots, seed)
        units = root, shapes if bent else np.zeros((0, 0, 2, 0)), hats
        rows = whole(_core.equation_residuals(*asked, wrt))
        for found, expected in zip(
            _core.equation_products(*asked, wrt, *units), twin.products(rows, *units), strict=True
        ):
            assert found.shape == expected.shape
            scale = np.abs(expected).max(initial=1e-300)
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * scale)

    @settings(max_examples=20, deadline=None)
    @given(seed=st.integers(0, 2**32 - 1), order=st.permutations([0, 1, 2, 3]))
    def test_the_order_of_outputs_is_that_of_rows(self, seed, order):
        data = record(seed)
        found, other = (
            _core.equation_residuals(*arguments(SHIP, data, outputs, gauge=True), MOVING)
            for outputs in ([0, 1, 2, 3], order)
        )
        np.testing.assert_array_equal(found[:, order], other)

    def test_columns_stand_alone(self):
        asked = arguments(SHIP, record(), [0, 1])
        found = _core.equation_residuals(*asked, MOVING)
        for place, by in enumerate(MOVING):
            np.testing.assert_array_equal(_core.equation_residuals(*asked, [by])[1], found[1 + place])
        np.testing.assert_array_equal(_core.equation_residuals(*asked, []), found[:1])

    def test_an_absent_signal_has_no_derivative(self):
        data = record()
        data[0][_core.EQUATION_SIGNALS.index("load")] = 0.0
        asked = arguments(SHIP, data, [0, 1])
        wrt = [INDEX[name] for name in ("k_L", "x_0", "T_s", "tau_n", "tau_twist")]
        found = _core.equation_residuals(*asked, wrt)
        assert not found[1:4].any()
        assert found[4].any()
        assert found[5].any()

    def test_any_number_of_blocks_gives_the_same_rows(self):
        long = record(count=160)
        short = [np.ascontiguousarray(part[..., :32]) for part in long]
        found, other = (
            _core.equation_residuals(*arguments(SHIP, part, [0, 1]), MOVING) for part in (long, short)
        )
        np.testing.assert_array_equal(found[..., :32], other)


@pytest.mark.parametrize("gauge", [False, True])
def test_residuals_of_a_simulated_ship_vanish(gauge):
    """A ship by the stepper: what is left is the speed's fourth power, and the set point between its samples."""
    rate_hz, count, before, grid = 100.0, 6000, 600, 10
    time = np.arange(-before, count) / rate_hz
    set_point = 0.02 * np.sin(0.9 * time) + 0.01 * np.sin(2.3 * time + 1.0)
    told = {
        "tau_n": 1.5,
        "g": -0.583,
        "p": 2.17,
        "tau_prop": 0.6,
        "T_d": 0.12,
        "T_set": 0.035,
        "tau_act": 0.06,
        "T_f": 0.04,
        "tau_eng": 0.08,
    }
    parameters = ship.vector(**told, K_p=6.3, K_i=1.6, v=1.0)
    names = ("dn", *(("dM_g", "dX", "dM_b") if gauge else ("dM_b", "dX")))
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in names]
    rows = _core.simulate_ship(parameters, 1.0 + set_point, np.empty(0), 1.0 / rate_hz, 4, "first", outputs)

    def seen(signal, late=0):
        part = signal[before - late : before - late + count]
        found = np.fft.rfft(part * tapers(count, rate_hz), axis=-1)[:, :64] * (-1.0) ** np.arange(4)[:, None]
        return np.ascontiguousarray(np.stack([found.real, found.imag], axis=1))

    speed, torque, rack = rows[:3]
    signals = [speed, torque, rack, 0.0 * speed, speed**2, speed**3, np.ones(len(speed)), rows[-1]]
    kernel = vector(**told, vK_p=6.3, vK_i=1.6)
    late = [(seen(speed, grid), 0.12 - grid / rate_hz), (seen(set_point, grid), 0.155 - grid / rate_hz)]
    spectra_ = np.array([seen(row) for row in signals])
    found = _core.equation_residuals(
        kernel, spectra_, 2.0 * np.pi * rate_hz / count, late, [*range(len(rows))], gauge, False, []
    )
    size = np.abs(whole(spectra_[[0, 1, 2, 7][: len(rows)], 0])).max(axis=1)
    assert (np.abs(whole(found[0])).max(axis=1) < 3e-4 * size).all()


LOOPS = {
    "vK_p": st.floats(0.02, 12.0),
    "vK_i": st.floats(0.02, 12.0),
    "tau_n": st.floats(0.2, 5.0),
    "tau_act": st.one_of(st.just(0.0), st.floats(0.01, 1.0)),
    "T_f": st.one_of(st.just(0.0), st.floats(0.01, 1.0)),
    "tau_eng": st.one_of(st.just(0.0), st.floats(0.01, 1.0)),
    "droop": st.one_of(st.just(0.0), st.floats(5e-3, 0.5)),
}


class TestStability:
    @settings(max_examples=400, deadline=None)
    @given(
        own=st.floats(-4.0, 4.0),
        **LOOPS,
        vK_d=st.one_of(st.just(0.0), st.floats(0.02, 5.0)),
        T_d=st.one_of(st.just(0.0), st.floats(0.01, 0.8)),
        share=st.one_of(st.just(0.0), st.floats(0.1, 1.0)),
    )
    def test_agrees_with_the_roots(self, own, share, **values):
        parameters = vector(p=2.0, g=2.0 - own, T_s=2.0 * share * values["T_d"], **values)
        dead = values["T_d"]
        # A late derivative keeps the gain vK_d / tau_n until the lag takes it off: before the approximated delay ends.
        lags = values["tau_act"], values["T_f"], values["tau_eng"]
        left = np.prod([np.hypot(1.0, 9.0 * one / dead) for one in lags]) if dead else np.inf
        assume(values["vK_d"] < 0.8 * values["tau_n"] * left)
        # The approximated delay must hold at the plant's own pole, and the loop must have a finite gain at rest.
        assume(abs(own) * dead < 8.0 * values["tau_n"])
        assume(abs(1.0 + values["droop"] * own) > 1e-3)
        roots = twin.loop_roots(parameters)
        roots = roots[np.abs(roots) * dead < 9.0]
        worst = (roots.real / np.abs(roots)).max()
        # At the margin neither tells, and the approximated delay holds as far as its order.
        assume(abs(worst) > 0.03)
        assert _core.loop_is_stable(parameters, False) == (worst < 0.0)

    @settings(max_examples=400, deadline=None)
    @given(
        g=st.floats(-3.0, 2.0),
        **LOOPS,
        share=st.floats(0.05, 0.95),
        T_d=st.one_of(st.just(0.0), st.floats(0.01, 0.4)),
        tau_twist=st.floats(0.01, 0.3),
        zeta_twist=st.one_of(st.just(0.0), st.floats(0.001, 6.0)),
    )
    @example(  # load and engine move the shaft's resonance from 18.1 to 16.0 rad/s, where its pole hardly fades
        g=0.994, vK_p=0.333, vK_i=5.11, tau_n=0.333, tau_act=0.0, T_f=0.082, tau_eng=0.0, droop=0.0,
        share=0.5723, T_d=0.0, tau_twist=0.03726, zeta_twist=0.0,
    )  # fmt: skip
    def test_a_shaft_that_twists_agrees_with_the_roots(self, share, tau_n, **values):
        parameters = vector(p=2.0, tau_n=tau_n, tau_prop=share * tau_n, **values)
        # The approximated delay holds as far as its order.
        swings = np.sqrt((1.0 / (share * (1.0 - share) * tau_n)) / values["tau_twist"])
        assume(swings * values["T_d"] < 6.0)
        roots = twin.loop_roots(parameters)
        roots = roots[np.abs(roots) * values["T_d"] < 9.0] if values["T_d"] else roots
        worst = (roots.real / np.abs(roots)).max()
        assume(abs(worst) > 1e-3)
        assert _core.loop_is_stable(parameters, False) == (worst < 0.0)

    def test_an_open_loop_has_its_own_pole(self):
        assert _core.loop_is_stable(vector(p=2.0, g=1.5), True)
        assert not _core.loop_is_stable(vector(p=2.0, g=2.5), True)

    def test_a_loop_that_grows_in_the_stepper_is_unstable(self):
        told = {"tau_n": 1.5, "g": -0.5, "p": 2.0, "tau_act": 0.05}
        for dead, runs_away in ((0.15, False), (0.6, True)):
            parameters = ship.vector(**told, tau_prop=0.0, K_p=6.0, K_i=2.0, v=1.0, T_d=dead)
            u = 1.0 + 1e-9 * (np.arange(4000) < 10)
            speed = _core.simulate_ship(parameters, u, np.empty(0), 0.01, 4, "zero", [0])[0]
            grows = np.abs(speed[-500:]).max() > np.abs(speed[500:1000]).max()
            assert grows == runs_away
            assert _core.loop_is_stable(vector(**told, vK_p=6.0, vK_i=2.0, T_d=dead), False) != runs_away

    def test_products_of_an_unstable_loop_are_refused(self):
        asked = arguments(vector(**LOOP, T_d=2.0), record(), [0])
        with pytest.raises(SimulationError, match="the loop is unstable at these parameters"):
            _core.equation_products(*asked, [], *noise(1, 64))


GOOD = dict(
    zip(
        ("parameters", "signals", "spacing", "late"),
        arguments(SHIP, record(), [0, 1])[:4],
        strict=True,
    ),
    outputs=[0, 1],
    gauge=False,
    open_loop=False,
    wrt=[0],
)
LATE_OF_64 = np.zeros((4, 2, 64)), 0.0
UNITS = dict(zip(("root", "shapes", "hats"), noise(2, 64), strict=True))
BAD = [
    ({"parameters": SHIP[1:]}, "parameters: found 28 numbers, expected 29"),
    ({"parameters": vector(**LOOP, T_d=np.nan)}, "parameters: T_d is NaN, expected a number"),
    ({"parameters": vector(s_M=0.0)}, "parameters: s_M is 0, expected"),
    ({"parameters": vector(s_B=0.0)}, "parameters: s_B is 0, expected"),
    ({"parameters": vector(**LOOP, **TWIST), "outputs": [0]}, "tau_twist: .* needs a measured torque"),
    ({"signals": np.zeros((7, 4, 2, 64))}, r"signals: found an array of shape \[7, 4, 2, 64\]"),
    ({"signals": np.zeros((8, 4, 2, 40))}, "expected"),
    ({"spacing": 0.0}, "spacing: found 0, expected more than 0"),
    ({"late": [(np.zeros((4, 2, 32)), 0.0), LATE_OF_64]}, r"late speed: found an array of shape \[4, 2, 32\]"),
    ({"late": [LATE_OF_64, (np.zeros((3, 2, 64)), 0.0)]}, r"late set point: found an array of shape \[3, 2, 64\]"),
    ({"late": [LATE_OF_64, (np.zeros((4, 2, 64)), np.inf)]}, "late signals: .* rest inf"),
    ({"late": [LATE_OF_64]}, "late: found 1 signals, expected speed and set point"),
    ({"late": [LATE_OF_64] * 3, "outputs": [0]}, "late: .* by the torque, expected both"),
    ({"outputs": [1]}, r"outputs: found \[1\], expected the speed 0"),
    ({"outputs": [0, 0]}, r"outputs: found \[0, 0\]"),
    ({"outputs": [0, 4]}, r"outputs: found \[0, 4\]"),
    ({"outputs": [0, 1, 3]}, r"outputs: found \[0, 1, 3\], expected .* beside the torque 1 of a gauge only"),
    ({"wrt": [29]}, r"wrt: found \[29\], expected indices below 29"),
]  # fmt: skip
BAD_UNITS = [
    ({"root": np.zeros((1, 1, 2, 64))}, r"root: found an array of shape \[1, 1, 2, 64\]"),
    ({"shapes": np.zeros((2, 2, 2, 32))}, r"shapes: found an array of shape \[2, 2, 2, 32\]"),
    ({"hats": np.zeros((3, 32))}, r"hats: found an array of shape \[3, 32\]"),
]


@pytest.mark.parametrize(("changes", "message"), [*BAD, *BAD_UNITS])
def test_arguments_are_checked(changes, message):
    calls = [(_core.equation_products, GOOD | UNITS)]
    calls += [(_core.equation_residuals, GOOD)] if changes.keys() <= GOOD.keys() else []
    for call, good in calls:
        with pytest.raises(InputError, match=message) as raised:
            call(*(good | changes).values())
        assert "\n" not in str(raised.value)
