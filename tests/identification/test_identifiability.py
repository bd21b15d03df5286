"""What data can't tell gets no number: None and a reason, in the time domain and in the frequency domain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.identify import identify
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

POINT = {"n_set": 1300.0, "n_e": 1300.0, "M_b": 222.93, "M_g": 635.35, "X_f": 13.07}
VALUES = {
    "tau_n": 1.514,
    "g": -0.583,
    "v": 1.583,
    "K_p": 10.0,
    "K_i": 1.0,
    "vK_p": 15.83,
    "vK_i": 1.583,
    "p": 2.0,
    "tau_prop": 0.2,
    "T_d": 0.05,
    "T_set": 0.1,
    "tau_act": 0.05,
    "limit": 1.0,
}
CHIRP = signals.chirp(0.02, 5.0, 60.0, 13.0, rate_hz=25.0)
BAND = np.geomspace(0.01, 5.0, 12)


def signal_names(structure: Structure) -> dict[str, str]:
    torque = "M_g" if structure.settings["torque"] == "gauge" else "M_b"
    return {"dn": "n_e", "dM": torque, "dX": "X_f"}


def truth(structure: Structure) -> dict[str, float]:
    return {parameter.name: VALUES[parameter.name] for parameter in structure.parameters}


def started_near_truth(structure: Structure) -> Structure:
    return structure.with_start(
        **{parameter.name: 1.05 * VALUES[parameter.name] for parameter in structure.free}
    )


def experiment(
    structure: Structure, excitation: signals.Excitation = CHIRP, noise: float = 1e-3
) -> Experiment:
    """What the structure itself gives, with white noise relative to a deviation of 1 %."""
    set_point = {"n_set": 1300.0 + excitation.samples}
    bare = Experiment("made", excitation.rate_hz, set_point, POINT, hold=excitation.hold)
    clean = structure.equations.simulate(truth(structure), bare)
    noisy = clean + 0.01 * noise * np.random.default_rng(1).normal(size=clean.shape)
    measured = {
        signal_names(structure)[output]: POINT[signal_names(structure)[output]] * (1.0 + row)
        for output, row in zip(structure.outputs, noisy, strict=True)
    }
    return replace(bare, signals=set_point | measured)


def response(structure: Structure, frequency: np.ndarray = BAND) -> FrequencyResponse:
    """What the structure itself gives, with deviations of 0.1 % in amplitude and in phase."""
    clean, _ = structure.equations.response(truth(structure), frequency, ())
    random = np.random.default_rng(2)
    names = [signal_names(structure)[output] for output in structure.outputs]
    turned = clean * np.exp(1e-3 * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape)))
    spread = dict.fromkeys(names, np.full(len(frequency), 1e-3))
    return FrequencyResponse(
        "made", frequency, dict(zip(names, turned, strict=True)), amplitude_std=spread, phase_std=spread
    )


def assert_known_only(fingerprint, known: set[str]) -> None:
    for name, estimate in fingerprint.parameters.items():
        if name in known:
            assert abs(estimate.value - VALUES[name]) < 5 * estimate.std + 1e-6 * abs(VALUES[name])
        elif estimate.status != "fixed":
            assert (name, estimate.value, estimate.std, estimate.ci95) == (name, None, None, None)
            assert estimate.status == "unidentifiable"
            assert estimate.reason


CASES = {
    "only speed is measured": (Structure.linear(products=True, outputs=("dn",)), set()),
    "only torque at a gauge is measured": (
        Structure.linear(products=True, torque="gauge", outputs=("dM",)).with_fixed(p=2.0),
        {"tau_prop"},
    ),
    "rack factor and gains are only known as products": (Structure.linear(), {"tau_n", "g"}),
    "a gauge sees only part of the inertia": (
        Structure.linear(products=True, torque="gauge", free_exponent=True),
        {"p", "tau_prop"},
    ),
    "a gauge and both dead times": (
        Structure.linear(
            products=True,
            torque="gauge",
            free_exponent=True,
            dead_time_loop=True,
            dead_time_set_point=True,
        ),
        {"p", "tau_prop", "T_d", "T_set"},
    ),
}


@pytest.mark.parametrize(("domain", "noise"), [("time", 0.0), ("time", 1e-3), ("frequency", 1e-3)])
@pytest.mark.parametrize("case", CASES)
def test_what_the_structure_leaves_open_gets_no_number(case, domain, noise):
    structure, known = CASES[case]
    near = started_near_truth(structure)
    if domain == "time":
        options = {"noise": "white"} if noise == 0.0 else {}
        fingerprint = identify(experiment(structure, noise=noise), near, starts=1, **options)
    else:
        fingerprint = identify(response(structure), near, noise="std", starts=1)
    assert_known_only(fingerprint, known)
    assert fingerprint.identifiability.rank < fingerprint.identifiability.free
    assert fingerprint.identifiability.null_space


def test_a_constant_set_point_tells_nothing():
    structure = Structure.linear(products=True)
    still = replace(CHIRP, samples=np.zeros_like(CHIRP.samples))
    assert_known_only(identify(experiment(structure, still), structure), set())


def test_one_steady_sine_tells_the_time_constant_alone():
    structure = started_near_truth(Structure.linear(products=True))
    fingerprint = identify(response(structure, np.array([0.5])), structure, noise="std")
    assert_known_only(fingerprint, {"tau_n"})

    sine = signals.sine_sequence([0.5], 100, 13.0, rate_hz=25.0)
    settled = experiment(structure, sine, noise=1e-2).window(180.0, 200.0)
    for name, estimate in identify(settled, structure).parameters.items():
        if name in ("g", "vK_p", "vK_i") and estimate.ci95 is not None:
            # Noise beside the sine tells a little: then it is told as widely.
            low, high = estimate.ci95
            assert high - low > 0.3 * abs(estimate.value)


def test_two_frequencies_are_too_few_for_both_dead_times_behind_a_gauge():
    structure = CASES["a gauge and both dead times"][0]
    two = np.array([0.1, 1.0])
    fingerprint = identify(response(structure, two), started_near_truth(structure), noise="std", starts=1)
    assert_known_only(fingerprint, {"p", "tau_prop"})


@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_a_dead_time_beyond_its_bound_is_no_estimate(domain):
    structure = Structure.linear(products=True, dead_time_set_point=True)
    made = experiment(structure) if domain == "time" else response(structure)
    tight = structure.with_bounds(T_set=(0.0, 0.02, 0.04))
    options = {} if domain == "time" else {"noise": "std"}
    estimate = identify(made, tight, starts=1, **options)["T_set"]
    assert (estimate.status, estimate.value, estimate.std, estimate.ci95) == ("at_bound", 0.04, None, None)


def test_a_torque_limit_that_is_never_reached_stays_unknown():
    launch = Vessel.load("stan-launch-804")
    small = simulate(
        launch, signals.chirp(0.05, 2.0, 20.0, 13.0, rate_hz=25.0), noise={"n_e": 0.01, "M_b": 0.01}, seed=1
    )
    # From near the ship: a search from afar may end in another valley, in which one the processor's rounding decides.
    near = Structure.ship(["torque_limit"]).with_start(M_max=3.0, tau_n=1.4, g=-0.6, vK_p=15.0, vK_i=1.5)
    fingerprint = identify(small, near, starts=1)
    limit = fingerprint["M_max"]
    assert (limit.value, limit.status) == (None, "unidentifiable")
    assert limit.reason.startswith("no limit was reached in the data")
    assert " 0." not in limit.reason
    assert fingerprint["tau_n"].value == pytest.approx(1.514, rel=0.01)


def test_an_offset_that_is_estimated_takes_the_exponent_with_it_where_nothing_moves():
    structure = Structure.linear(free_exponent=True, products=True).with_fixed(
        tau_n=1.514, g=-0.583, vK_p=15.83, vK_i=1.583
    )
    ahead = replace(CHIRP, samples=np.full(5000, 13.0))
    steady = experiment(structure, ahead).window(180.0, 200.0)
    assert_known_only(identify(steady, structure), set())


def test_too_few_samples_tell_nothing():
    structure = Structure.linear(products=True)
    short = experiment(structure).window(0.0, 2.0 / CHIRP.rate_hz)
    assert_known_only(identify(short, structure, noise="white"), set())


def test_a_single_point_of_a_response_is_too_few_for_five_parameters():
    structure = Structure.linear(free_exponent=True)
    fingerprint = identify(response(structure, np.array([0.2])), started_near_truth(structure), noise="std")
    for name in ("v", "K_p", "K_i", "g"):
        assert fingerprint[name].value is None
