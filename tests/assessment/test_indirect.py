"""A structure's estimates led back to the ship by simulating it: what the structure lacks is taken off."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import signals
from shipfp_rs.assessment.indirect import Binding, bind, indirect_inference
from shipfp_rs.assessment.ship_parameters import parameters_of, with_parameters
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.identify import identify
from shipfp_rs.simulation.replay import answered
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

LAUNCH = Vessel.load("stan-launch-804")
LAGGING = LAUNCH.replace({"actuator.lag_s": 0.015})
"""Its fuel actuator takes a time that no structure below knows of."""
FREE = ("tau_n", "vK_p", "vK_i")
STRUCTURE = Structure.linear(products=True).with_fixed(g=parameters_of(LAUNCH)["g"])
OPTIONS = {"noise": "white", "initial_state": "zero", "starts": 1}


def trial(vessel: Vessel, rate_hz: float = 100.0, noise: float = 0.0, seed: int = 0) -> Experiment:
    excitation = signals.chirp(0.05, 2.0, 60.0, 10.0, rate_hz=rate_hz)
    levels = {"n_e": noise, "M_b": noise, "M_g": noise} if noise else None
    return simulate(vessel, excitation, noise=levels, seed=seed)


@given(
    st.fixed_dictionaries(
        {
            "tau_n": st.floats(0.9, 1.5),
            "tau_prop": st.floats(0.2, 0.6),
            "g": st.floats(-0.9, -0.3),
            "vK_p": st.floats(3.0, 8.0),
            "vK_i": st.floats(8.0, 20.0),
            "p": st.floats(1.9, 2.4),
            "T_d": st.floats(0.06, 0.2),
            # A file of a vessel takes no time that is next to nothing.
            "T_set": st.just(0.0) | st.floats(1e-9, 0.5),
            "tau_act": st.just(0.0) | st.floats(1e-9, 0.1),
            "tau_twist": st.floats(1e-4, 1e-3),
        }
    )
)
@settings(max_examples=10, deadline=None)
def test_a_ship_with_given_parameters_has_them(values: dict[str, float]) -> None:
    found = parameters_of(with_parameters(Vessel.load("stan-tug-1205-full"), values))
    for name, value in values.items():
        assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-9), name


def test_a_parameter_that_no_ship_has_is_named() -> None:
    with pytest.raises(InputError, match="found parameters misread, expected some of K_i, K_p"):
        with_parameters(LAUNCH, {"misread": 0.1})


def test_of_its_own_plant_a_structure_finds_what_the_ship_has() -> None:
    binding = bind(trial(LAUNCH), STRUCTURE, LAUNCH, **OPTIONS)
    assert binding.names == FREE
    assert binding.slopes == pytest.approx(np.eye(3), abs=0.02)
    assert binding.found == pytest.approx(binding.ship, rel=2e-3)


def test_what_a_structure_lacks_is_taken_off_its_estimates() -> None:
    record, truth = trial(LAGGING, noise=0.02, seed=3), parameters_of(LAGGING)
    found = indirect_inference(record, STRUCTURE, LAGGING, **OPTIONS)
    alone = found.settings["indirect"]
    off = [
        abs(alone["of_the_structure"][name] - truth[name]) / alone["std_of_the_structure"][name]
        for name in FREE
    ]
    assert max(off) > 10.0, "the lag is felt"
    for name in FREE:
        estimate = found.parameters[name]
        assert estimate.ci95[0] < truth[name] < estimate.ci95[1], name
    assert alone["off"] < 0.2
    assert found.verdict[0].startswith(
        "Led back to the ship by simulating it; the structure alone finds tau_n"
    )


def test_the_residual_tests_are_those_of_the_simulated_ship() -> None:
    record = trial(LAGGING, noise=0.02, seed=3)
    assert identify(record, STRUCTURE, **OPTIONS).model_adequate is False, "the structure has no lag"
    assert indirect_inference(record, STRUCTURE, LAGGING, **OPTIONS).model_adequate is True
    wrong = indirect_inference(record, STRUCTURE, LAUNCH, **OPTIONS)
    assert wrong.model_adequate is False, "nor has this ship"
    assert any(f"contradict the structure 'simulated {LAUNCH.name}'" in line for line in wrong.verdict)


def test_intervals_that_are_led_back_hold_the_truth_as_often_as_they_say() -> None:
    binding, truth = bind(trial(LAGGING), STRUCTURE, LAGGING, **OPTIONS), parameters_of(LAGGING)
    inside, distances = 0, []
    for seed in range(8):
        record = trial(LAGGING, noise=0.02, seed=100 + seed)
        found = indirect_inference(record, STRUCTURE, LAGGING, binding=binding, **OPTIONS)
        for name in FREE:
            estimate = found.parameters[name]
            inside += estimate.ci95[0] < truth[name] < estimate.ci95[1]
            distances.append((estimate.value - truth[name]) / estimate.std)
    # Not wider either: what the structure lacks is no noise.
    assert inside >= 20
    assert 0.6 < np.std(distances) < 1.4


def test_a_simulated_answer_lies_on_the_records_grid_with_its_gaps() -> None:
    record = trial(LAUNCH, rate_hz=5.0)
    torque = record.signals["M_b"].copy()
    torque[100:120] = np.nan
    record = dataclasses.replace(record, signals={**record.signals, "M_b": torque}, hold="first")
    answer = answered(LAUNCH, record)
    assert len(answer) == len(record)
    assert np.isnan(answer.signals["M_b"][100:120]).all()
    assert np.isfinite(answer.signals["n_e"]).all()


def test_a_set_point_held_between_samples_is_held_in_the_answer() -> None:
    record = simulate(LAUNCH, signals.steps([20.0], 10.0, rate_hz=5.0))
    answer = answered(LAUNCH, dataclasses.replace(record, hold="zero"))
    last = [float(one.normalised("n_e")[-5]) for one in (record, answer)]
    assert last[1] == pytest.approx(last[0], rel=1e-3)


def test_what_the_data_do_not_tell_is_named() -> None:
    unknown = Structure.linear(products=True, torque="gauge")
    with pytest.raises(InputError, match=r"the data do not tell .*; fix them or give them a prior"):
        indirect_inference(trial(LAUNCH, noise=0.01), unknown, LAUNCH, **OPTIONS)


def test_a_binding_of_another_structure_is_refused() -> None:
    binding = Binding(("p",), np.ones(1), np.ones(1), np.eye(1))
    with pytest.raises(InputError, match="binding is of p, expected one of tau_n, vK_p, vK_i"):
        indirect_inference(trial(LAUNCH, noise=0.01), STRUCTURE, LAUNCH, binding=binding, **OPTIONS)
