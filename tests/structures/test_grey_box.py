"""The plant of a vessel fitted to its own logs: what comes back, what can't, and what a wrong model shows."""

from unittest.mock import patch

import numpy as np
import pytest

from shipfp_rs import Fingerprint, Structure, Vessel, identify, signals, simulate
from shipfp_rs.errors import InputError
from shipfp_rs.identification import search
from shipfp_rs.optimise import least_squares
from shipfp_rs.structures.plant import PlantEquations

LAUNCH = Vessel.load("stan-launch-804")
SEVEN = ["inertia", "A1", "A2", "Kp_abs", "Ki_abs", "torque_exponent", "propeller_torque"]
OUTPUTS = ("dn", "dM", "dX")
NOISE = {"n_e": 0.02, "M_b": 0.02, "X_f": 0.02}


def chirp(duration_s=80.0, amplitude_rpm=40.0, rate_hz=40.0):
    return signals.chirp(0.02, 2.0, duration_s, amplitude_rpm, rate_hz=rate_hz)


def away(structure, **factors):
    """The same structure with other starts than the ship's own values."""
    factors = {parameter.name: 1.15 for parameter in structure.free} | factors
    return structure.with_start(**{name: structure[name].start * factor for name, factor in factors.items()})


def truth(structure):
    return {parameter.name: parameter.start for parameter in structure.free}


def test_seven_parameters_come_back_from_a_record_without_noise():
    structure = Structure.grey_box(LAUNCH, SEVEN, outputs=OUTPUTS)
    found = identify(
        simulate(LAUNCH, chirp()), away(structure), noise="white", offsets=False, weighting="variance"
    )
    assert found.identifiability.rank == 7
    for name, value in truth(structure).items():
        assert found[name].value == pytest.approx(value, rel=1e-6), name


def test_without_the_rack_the_engine_gain_and_the_governor_are_known_only_together():
    found = identify(
        simulate(LAUNCH, chirp(), noise=NOISE, seed=1), Structure.grey_box(LAUNCH, SEVEN), noise="white"
    )
    assert found.identifiability.rank == 6
    for name in ("A1", "Kp_abs", "Ki_abs"):
        assert found[name].value is None
        assert "only known together with" in found[name].reason
    assert found["inertia"].value == pytest.approx(21.2, rel=0.01)


def test_the_analytic_slopes_are_those_of_the_structure_in_linear_terms():
    experiment = simulate(LAUNCH, chirp(20.0))
    structure = Structure.plant(LAUNCH, free_exponent=True, dead_time_set_point=True, torque="gauge")
    values = {p.name: p.start for p in structure.parameters} | {
        "initial dn": 0.01,
        "initial dE": 0.02,
        "T_set": 0.043,
    }
    names = [*structure.names, "initial dn", "initial dE"]
    _, slopes = structure.equations.sensitivities(values, experiment, names)
    for name, slope in zip(names, slopes, strict=True):
        if name == "limit":
            continue
        step = 1e-5 * abs(values[name])
        ahead, behind = (
            structure.equations.simulate({**values, name: values[name] + side * step}, experiment)
            for side in (1.0, -1.0)
        )
        expected = (ahead - behind) / (2.0 * step)
        assert np.abs(slope - expected).max() < 1e-6 * np.abs(expected).max(), name


def test_intervals_hold_the_truth_as_often_as_they_say():
    structure = Structure.grey_box(LAUNCH, ["inertia", "A2", "Kp_abs", "Ki_abs"])
    inside = []
    for seed in range(15):
        log = simulate(LAUNCH, chirp(30.0, rate_hz=20.0), noise={"n_e": 0.1, "M_b": 0.1}, seed=seed)
        found = identify(log, structure, noise="white")
        inside += [
            found[name].ci95[0] <= value <= found[name].ci95[1] for name, value in truth(structure).items()
        ]
    # 60 intervals of 95 %: fewer than 51 happen once in a thousand times, all of them once in twenty.
    assert sum(inside) >= 51


@pytest.mark.parametrize(
    ("most", "options"),
    [
        (25, {"noise": "white", "initial_state": "zero"}),
        (42, {"noise": "white"}),
        (52, {"noise": "ar"}),
    ],
    ids=["from rest", "initial state", "noise models"],
)
def test_few_passes_over_the_record_lead_to_the_minimum(most, options, monkeypatch):
    log = simulate(LAUNCH, signals.chirp(0.002, 2.0, 500.0, 26.0, rate_hz=20.0), noise=NOISE, seed=1)
    structure = away(Structure.grey_box(LAUNCH, SEVEN, outputs=OUTPUTS))
    counted = PlantEquations.products
    with patch.object(PlantEquations, "products", autospec=True, side_effect=counted) as passes:
        found = identify(log, structure, **options)
    # Fourteen ends of intervals take a pass each at least.
    assert passes.call_count <= most
    monkeypatch.setattr(least_squares, "DEVIATIONS", 0.0)
    monkeypatch.setattr(search, "CRITERION_TOLERANCE", 1e-12)
    exact = identify(log, structure, **options)
    for name in SEVEN:
        assert abs(found[name].value - exact[name].value) < 1e-6 * exact[name].std, name


LIMITED = LAUNCH.replace({"engine.torque_rate_Nm_s": 110.0})


def limited_log():
    slow = signals.chirp(0.02, 0.8, 60.0, 26.0, rate_hz=25.0)
    return simulate(LIMITED, slow, noise=NOISE, seed=7)


def test_a_rate_limit_that_acts_is_found_with_the_rest():
    free = ["inertia", "A2", "Kp_abs", "Ki_abs", "torque_rate"]
    structure = Structure.grey_box(LIMITED, free)
    found = identify(limited_log(), away(structure, inertia=1.05, Kp_abs=1.05, torque_rate=0.9))
    for name, value in truth(structure).items():
        assert abs(found[name].value - value) < 4.0 * found[name].std, name
        assert found[name].std < 0.05 * abs(value), name
    assert not any("contradict" in line for line in found.verdict)


def test_a_plant_without_the_rate_limit_is_flagged():
    structure = Structure.grey_box(LAUNCH, ["inertia", "A2", "Kp_abs", "Ki_abs"])
    found = identify(limited_log(), structure)
    assert any("contradict" in line for line in found.verdict)


def test_a_dead_time_and_the_gauge_side_come_out_of_a_noisy_record():
    ship = LAUNCH.replace(
        {"governor.set_point_dead_time_s": 0.137, "shaft.propeller_side_inertia_kg_m2": 8.0}
    )
    structure = Structure.grey_box(
        ship, ["propeller_inertia", "Kp_abs", "Ki_abs", "torque_exponent", "T_set"], torque="gauge"
    )
    log = simulate(ship, chirp(), noise={"n_e": 0.02, "M_g": 0.02}, seed=2)
    found = identify(log, away(structure), starts=1)
    for name, value in truth(structure).items():
        assert abs(found[name].value - value) < 4.0 * found[name].std, name
        assert found[name].std < 0.1 * value, name


def test_priors_fixed_values_and_several_logs_work_as_with_any_structure(tmp_path):
    structure = Structure.grey_box(LAUNCH, SEVEN).with_prior(A1=(27.0, 0.5)).with_fixed(torque_exponent=2.0)
    logs = [
        simulate(LAUNCH, chirp(40.0), noise=NOISE, seed=1),
        simulate(LAUNCH, signals.steps([0.0, 40.0, -40.0], 10.0, rate_hz=40.0), noise=NOISE, seed=2),
    ]
    found = identify(logs, structure, noise="white")
    assert (found["A1"].status, found["torque_exponent"].status) == ("prior", "fixed")
    assert found["A1"].value == pytest.approx(27.0, abs=1.5)
    assert found["Kp_abs"].std > 0.01 * found["Kp_abs"].value
    found.save(tmp_path / "fingerprint.json")
    again = Fingerprint.load(tmp_path / "fingerprint.json")
    assert again["inertia"] == found["inertia"]
    assert again.structure["kind"] == "grey box"


@pytest.mark.parametrize(
    ("free", "message"),
    [
        (["inertai"], "did you mean 'inertia'"),
        (["torque_rate"], "engine.torque_rate_Nm_s"),
        (["rack_rate"], "actuator.rate_mm_s"),
        ([], "found no name"),
    ],
)
def test_what_a_vessel_has_not_is_named(free, message):
    with pytest.raises(InputError, match=message):
        Structure.grey_box(LAUNCH, free)


def test_a_ship_that_moves_is_refused_rather_than_fitted_as_if_it_lay_still():
    moving = LAUNCH.replace({"ship": {"mass_kg": 8e3, "resistance_N_s2_m2": 500.0}})
    with pytest.raises(InputError, match="has a ship that moves, which a grey box has not"):
        Structure.grey_box(moving, ["inertia"])


TUG = Vessel.load("stan-tug-1205-full")


def test_all_elements_of_the_tug_come_back_from_what_is_below_2_hz():
    """Firing, a governor that samples once a firing, a swinging shaft, dead times: from starts 5 % off to 0.1 %."""
    free = ["inertia", "A1", "Kp_abs", "Ki_abs", "propeller_torque", "T_set", "fuel_dead_time"]
    structure = Structure.grey_box(TUG, free, outputs=OUTPUTS, pass_hz=2.0)
    log = simulate(TUG, signals.chirp(0.02, 1.0, 100.0, 60.0, rate_hz=50.0))
    signs = np.random.default_rng(11).choice([-1.0, 1.0], len(free))
    start = {name: 1.0 + 0.05 * sign for name, sign in zip(free, signs, strict=True)}
    found = identify(
        log, away(structure, **start), starts=1, noise="white", offsets=False, initial_state="zero"
    )
    for name, value in truth(structure).items():
        assert found[name].value == pytest.approx(value, rel=1e-3), name


def test_what_lies_above_the_pass_band_does_not_count():
    """Cylinders that differ in strength, which the structure is not told, shift the phase and size of the ripple alone."""
    other = TUG.replace({"engine.firing.strength": [0.98, 1.04, 0.98, 0.98, 1.04, 0.98]})
    log = simulate(other, signals.chirp(0.02, 1.0, 60.0, 60.0, rate_hz=50.0))
    far = {}
    for pass_hz in (None, 2.0):
        structure = Structure.grey_box(TUG, ["inertia"], pass_hz=pass_hz)
        values = {p.name: p.start for p in structure.parameters}
        rows = structure.measured(log) - structure.equations.simulate(values, log)
        far[pass_hz] = np.nanstd(rows, axis=1)
    assert (far[2.0] < 0.1 * far[None]).all()


def test_a_pass_band_leaves_slow_motion_as_it_is_and_masks_what_its_filter_does_not_fill():
    log = simulate(LAUNCH, signals.chirp(0.05, 0.5, 30.0, 40.0, rate_hz=50.0))
    plain, passed = (Structure.grey_box(LAUNCH, ["inertia"], pass_hz=hz) for hz in (None, 3.0))
    inside = np.isfinite(passed.measured(log)).all(axis=0)
    assert 0.8 < inside.mean() < 1.0
    np.testing.assert_allclose(
        passed.measured(log)[:, inside],
        plain.measured(log)[:, inside],
        atol=5e-4 * np.ptp(plain.measured(log)),
    )


def test_a_pass_band_holds_for_measured_outputs_behind_ties_too():
    log = simulate(LAUNCH, signals.chirp(0.05, 0.5, 30.0, 40.0, rate_hz=50.0))
    structure = Structure.grey_box(LAUNCH, ["inertia", "A1"], pass_hz=3.0)
    tied = structure.with_tied(A1=("inertia", 1.0, 0.0))
    np.testing.assert_array_equal(tied.measured(log), structure.measured(log))


@pytest.mark.parametrize(
    ("pass_hz", "message"), [(0.0, "expected a positive frequency"), (20.0, "expected less than 12 at 40 Hz")]
)
def test_a_pass_band_out_of_range_is_named(pass_hz, message):
    with pytest.raises(InputError, match=message):
        identify(simulate(LAUNCH, chirp(20.0)), Structure.grey_box(LAUNCH, ["inertia"], pass_hz=pass_hz))
