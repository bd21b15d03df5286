"""Identification from frequency responses: what it finds, and what it says it can't find."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse, sine_response
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure

FREQUENCY = np.geomspace(0.004, 5.0, 25)
LAUNCH = {"tau_n": 1.442, "g": -0.583, "v": 1.583, "K_p": 10.0, "K_i": 1.0, "p": 2.0}
TUG = {
    "tau_n": 1.17,
    "g": -0.6,
    "v": 1.2,
    "K_p": 3.5,
    "K_i": 5.0,
    "p": 2.17,
    "tau_prop": 0.43,
    "T_d": 0.12,
    "T_set": 0.25,
}


def response_of(
    structure: Structure, values: dict[str, float], signals: dict[str, str], **more: object
) -> FrequencyResponse:
    known = {p.name: p.start if p.fixed else values[p.name] for p in structure.parameters}
    clean, _ = structure.equations.response(known, FREQUENCY, [])
    return FrequencyResponse(
        "made",
        FREQUENCY,
        {signals[out]: row for out, row in zip(structure.outputs, clean, strict=True)},
        **more,
    )


@pytest.mark.parametrize(
    ("outputs", "options", "rank", "free", "known", "together"),
    [
        # Section 4.2.2 generalised: which parameters speed, torque and rack tell apart.
        (("dn",), {}, 3, 5, set(), {"vK_p/tau_n", "vK_i/tau_n"}),
        (("dn", "dM"), {}, 4, 5, {"tau_n", "g"}, {"vK_p", "vK_i"}),
        (("dn", "dM"), {"free_exponent": True}, 5, 6, {"tau_n", "g", "p"}, {"vK_p", "vK_i"}),
        (
            ("dn", "dM"),
            {"torque": "gauge", "free_exponent": True},
            5,
            7,
            {"p", "tau_prop"},
            {"(p-g)/tau_n", "vK_p/tau_n", "vK_i/tau_n"},
        ),
        (
            ("dn", "dM"),
            {"torque": "gauge", "free_exponent": True, "dead_time_loop": True},
            6,
            8,
            {"p", "tau_prop", "T_d"},
            {"(p-g)/tau_n", "vK_p/tau_n", "vK_i/tau_n"},
        ),
        (
            ("dn", "dM"),
            {"torque": "gauge", "free_exponent": True, "dead_time_loop": True, "dead_time_set_point": True},
            7,
            9,
            {"p", "tau_prop", "T_d", "T_set"},
            {"(p-g)/tau_n", "vK_p/tau_n", "vK_i/tau_n"},
        ),
        (
            ("dn", "dM", "dX"),
            {"torque": "gauge", "free_exponent": True, "dead_time_loop": True},
            7,
            8,
            {"p", "tau_prop", "T_d", "K_p", "K_i"},
            {"(p-g)/tau_n"},
        ),
        (
            ("dn", "dM", "dX"),
            {"free_exponent": True, "dead_time_loop": True},
            7,
            7,
            {"tau_n", "g", "v", "K_p", "K_i", "p", "T_d"},
            set(),
        ),
    ],
)
def test_what_each_set_of_measurements_tells(outputs, options, rank, free, known, together):
    if "dX" in outputs:  # the rack behind the dead time, which the linear structure has not
        side = options.get("torque", "brake")
        structure = Structure.ship(["dead_time_loop"], torque=side, outputs=outputs, products=False)
    else:
        structure = Structure.linear(outputs=outputs, **options)
    truth = LAUNCH | TUG
    torque = "M_g" if options.get("torque") == "gauge" else "M_b"
    data = response_of(structure, truth, {"dn": "n_e", "dM": torque, "dX": "X_f"})
    start = {name: truth[name] * 1.05 for name in structure.names if not structure[name].fixed}

    fingerprint = identify(data, structure.with_start(**start), noise="white")

    assert (fingerprint.identifiability.rank, fingerprint.identifiability.free) == (rank, free)
    for name in structure.names:
        estimate = fingerprint.parameters[name]
        if name in known:
            assert estimate.value == pytest.approx(truth[name], rel=1e-5)
        elif estimate.status != "fixed":
            assert estimate.status == "unidentifiable"
            assert estimate.value is None
            assert estimate.reason
    assert together <= set(fingerprint.derived)
    for name, estimate in fingerprint.derived.items():
        if name in ("vK_p", "vK_i"):
            assert estimate.value == pytest.approx(truth["v"] * truth[name[1:]], rel=1e-5)
    assert len(fingerprint.identifiability.null_space) == free - rank


def test_a_known_v_closes_the_gap():
    structure = Structure.linear().with_fixed(v=LAUNCH["v"])
    fingerprint = identify(
        response_of(structure, LAUNCH, {"dn": "n_e", "dM": "M_b"}),
        structure.with_start(K_p=9.0, K_i=1.1),
        noise="white",
    )
    assert fingerprint.identifiability.rank == fingerprint.identifiability.free == 4
    for name in ("tau_n", "g", "K_p", "K_i"):
        assert fingerprint[name].value == pytest.approx(LAUNCH[name], rel=1e-6)


def test_a_prior_is_a_measurement_with_its_own_deviation():
    structure = Structure.linear(torque="gauge", free_exponent=True, products=True)
    truth = {"tau_n": 1.17, "g": -0.6, "vK_p": 4.2, "vK_i": 6.0, "p": 2.17, "tau_prop": 0.43}
    data = response_of(structure, truth, {"dn": "n_e", "dM": "M_g"})
    deviation = np.full(len(FREQUENCY), 0.01)
    data = FrequencyResponse(
        data.name,
        data.frequency_hz,
        data.response,
        amplitude_std=dict.fromkeys(data.response, deviation),
        phase_std=dict.fromkeys(data.response, deviation),
    )
    without = identify(data, structure, noise="std")
    with_prior = identify(data, structure.with_prior(tau_n=(1.17, 0.05)), noise="std")

    assert without["tau_n"].value is None
    assert with_prior["tau_n"].status == "prior"
    assert with_prior["tau_n"].value == pytest.approx(1.17, rel=1e-6)
    assert with_prior["tau_n"].std == pytest.approx(0.05, rel=1e-3)
    assert with_prior["g"].value == pytest.approx(-0.6, rel=1e-5)


def test_intervals_from_known_deviations_cover_the_truth_as_often_as_they_say():
    structure = Structure.linear(products=True)
    truth = {"tau_n": 1.442, "g": -0.583, "vK_p": 15.83, "vK_i": 1.583}
    clean = response_of(structure, truth, {"dn": "n_e", "dM": "M_b"})
    random = np.random.default_rng(3)
    covered = np.zeros(4)
    draws, deviation = 80, 0.02
    for _ in range(draws):
        noisy = {
            name: values * np.exp(deviation * (random.normal(size=25) + 1j * random.normal(size=25)))
            for name, values in clean.response.items()
        }
        spread = dict.fromkeys(noisy, np.full(25, deviation))
        data = FrequencyResponse("noisy", FREQUENCY, noisy, amplitude_std=spread, phase_std=spread)
        fingerprint = identify(data, structure.with_start(**truth), noise="std")
        for index, (name, value) in enumerate(truth.items()):
            low, high = fingerprint[name].ci95
            covered[index] += low <= value <= high
    # 95 % of 80 draws, three binomial deviations below and above.
    assert (covered / draws > 0.87).all()
    assert covered.sum() / (4 * draws) < 0.99


def test_a_bound_that_presses_is_reported_and_one_that_only_touches_a_null_direction_is_not():
    structure = Structure.linear()
    data = response_of(structure, LAUNCH, {"dn": "n_e", "dM": "M_b"})
    pressed = identify(data, structure.with_bounds(tau_n=(1.6, 2.0, 3.0)), noise="white")
    assert pressed["tau_n"].status == "at_bound"
    assert pressed["tau_n"].value == 1.6
    touched = identify(
        data, structure.with_bounds(v=(0.02, 0.02, 10.0), K_p=(1e-4, 700.0, 1e3)), noise="white"
    )
    assert touched["v"].status == "unidentifiable"


def test_a_sine_response_has_the_phase_of_output_minus_input():
    time = np.arange(0, 100, 0.01)
    omega, lag = 2 * np.pi * 0.1, 0.4
    set_point = 1181 + 76 * np.sin(omega * time + 0.8)
    speed = 1180 + 70 * np.sin(omega * time + 0.8 - lag)
    table = []
    for signal, offset in ((speed, 1180.0), (set_point, 1181.0)):
        basis = np.column_stack([np.sin(omega * time), np.cos(omega * time), np.ones_like(time)])
        s, c, mean = np.linalg.lstsq(basis, signal, rcond=None)[0]
        assert mean == pytest.approx(offset)
        table.append((mean, np.hypot(s, c), np.arctan2(c, s)))
    assert np.angle(sine_response(*table)) == pytest.approx(-lag)
    assert np.abs(sine_response(*table)) == pytest.approx(70 / 1180 / (76 / 1181))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d, s: identify([], s), "no data given"),
        (lambda d, s: identify(3, s), "data is 3, expected an Experiment or"),
        (lambda d, s: identify(d, s, noise="best"), "noise is 'best', expected 'coloured'"),
        (lambda d, s: identify(d, s, noise="std"), "needs the standard deviations of 'n_e'"),
        (lambda d, s: identify(d, s, starts=0), "starts is 0, expected a whole number of 1 or more"),
        (lambda d, s: s.with_start(tau_n=20.0), "start 20 is outside its bounds 0.01 to 10"),
        (lambda d, s: s.with_bounds(tau_n=(2.0, 3.0)), "start 1.2 is outside its bounds 2 to 3"),
        (lambda d, s: s.with_fixed(tau=1.0), "no parameter 'tau'; it has tau_n, g"),
        (lambda d, s: Structure.linear(torque="shaft"), "torque is 'shaft', expected 'brake' or 'gauge'"),
        (lambda d, s: Structure.linear(outputs=("n",)), "output 'n', expected some of dn, dM, dE, dX"),
        (
            lambda d, s: identify(FrequencyResponse("half", [1.0], {"n_e": [1.0]}), s),
            "no signal for output 'dM'",
        ),
    ],
)
def test_each_misuse_gets_one_line_that_names_it(call, message):
    structure = Structure.linear()
    data = response_of(structure, LAUNCH, {"dn": "n_e", "dM": "M_b"})
    with pytest.raises((InputError, TypeError), match=message):
        call(data, structure)


def test_an_experiment_refuses_what_can_not_be_fitted():
    good = {"n_set": np.full(10, 1300.0), "n_e": np.full(10, 1300.0)}
    with pytest.raises(InputError, match="'n_set' is NaN at sample 3"):
        Experiment(
            "x", 10.0, good | {"n_set": np.where(np.arange(10) == 3, np.nan, 1300.0)}, {"n_set": 1300.0}
        )
    with pytest.raises(InputError, match="signal 'n_e' is infinite at sample 0"):
        Experiment("x", 10.0, good | {"n_e": np.full(10, np.inf)}, {"n_set": 1300.0})
    with pytest.raises(InputError, match=r"shape \(9,\), expected \(10,\)"):
        Experiment("x", 10.0, good | {"n_e": np.ones(9)}, {"n_set": 1300.0})
    with pytest.raises(InputError, match="operating point of 'n_set' is 0"):
        Experiment("x", 10.0, good, {"n_set": 0.0})
    with pytest.raises(InputError, match=r"window 3 to 0\.5 s is empty or outside"):
        Experiment("x", 10.0, good, {"n_set": 1300.0}).window(3, 0.5)
