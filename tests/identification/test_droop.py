"""A governor whose set point falls with its fuel: found where it acts, and only there."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.si import parameters_of, with_parameters
from shipfp_rs.structures.structure import Structure

SECONDS = 160.0


def trial(droop: float, seed: int = 1) -> fp.Experiment:
    """A launch of a drooping governor, with sensors' noise."""
    vessel = fp.Vessel.load("stan-launch-804")
    quick = {"actuator.dead_time_s": 0.05, "actuator.lag_s": 0.08}
    governor = {"governor.droop": droop, "governor.K_p": 4.0, "governor.K_i": 5.0}
    chirp = fp.signals.chirp(0.02, 3.0, SECONDS, 60.0, rate_hz=50.0)
    return fp.simulate(
        vessel.replace(quick | governor), chirp, noise={"n_e": 0.05, "M_b": 0.1, "M_g": 0.1}, seed=seed
    )


def test_a_vessel_droops_by_as_much_as_its_file_says():
    """Long after a step of the set point the fuel's torque is that of the propeller less the engine's own slope."""
    vessel = fp.Vessel.load("stan-launch-804").replace({"governor.droop": 0.05, "governor.K_i": 5.0})
    at = vessel.operating_point.n_e_rpm
    step = fp.Excitation("step", "step", 50.0, np.r_[np.zeros(1), np.full(2999, 0.01 * at)], "zero")
    assert parameters_of(vessel)["droop"] == pytest.approx(0.05)
    last = float(fp.simulate(vessel, step).normalised("n_e")[-1])
    regulates = (1.0 + last) ** vessel.propeller.torque_exponent - 1.0 - vessel.operating_point.g * last
    assert last == pytest.approx(0.01 - 0.05 * regulates, rel=1e-4)


@pytest.mark.parametrize("torque", ["brake", "gauge"])
@pytest.mark.parametrize("droop", [0.02, 0.06])
def test_a_droop_is_found_without_being_asked_for(droop, torque):
    record = trial(droop)
    outputs = {"torque": torque, "outputs": ["dn", "dM"]}
    found, without = fp.identify(record, **outputs), fp.identify(record, **outputs, elements={"droop": False})
    low, high = found["droop"].ci95
    assert low < droop < high
    assert found.elements["droop"]["state"] == "on"
    assert "droop" not in without.parameters
    assert found.settings["criterion"] < without.settings["criterion"]


def test_a_governor_without_a_droop_is_given_none():
    found = fp.identify(trial(0.0), torque="brake", outputs=["dn", "dM"])
    assert "droop" not in found.parameters
    assert found.elements["droop"]["state"] == "off"


def test_a_declared_droop_is_fitted_and_may_be_zero():
    structure = Structure.ship(["dead_time_loop", "dead_time_set_point", "actuator_lag", "droop"])
    low, high = fp.identify(trial(0.0), structure)["droop"].ci95
    assert low == 0.0 < high < 0.03
    low, high = fp.identify(trial(0.04), structure)["droop"].ci95
    assert low < 0.04 < high


def test_the_response_of_a_drooping_ship_is_that_of_its_simulation():
    structure = Structure.ship(["droop"])
    values = {"tau_n": 1.4, "g": -0.5, "vK_p": 5.0, "vK_i": 6.0, "p": 2.0, "droop": 0.05}
    rate_hz, seconds, hz, size = 100.0, 60.0, 0.2, 1e-3
    time = np.arange(round(rate_hz * seconds)) / rate_hz
    swing = np.exp(2j * np.pi * hz * time)
    rest = {"n_e": 1600.0, "n_set": 1600.0, "M_b": 500.0}
    signals = {"n_set": 1600.0 * (1.0 + size * swing.imag), "n_e": np.full(len(time), 1600.0)}
    record = fp.Experiment("swing", rate_hz, {**signals, "M_b": np.full(len(time), 500.0)}, rest)
    last = slice(len(time) // 2, None)
    rows = structure.equations.simulate(values, record)[:, last]
    simulated = (
        2.0 * (rows - rows.mean(axis=1, keepdims=True)) @ swing[last].conj() / rows.shape[1] / size * 1j
    )
    (response,) = structure.equations.response(values, np.array([hz]), ())[0].T
    np.testing.assert_allclose(simulated, response, rtol=3e-3)


def test_a_torque_limit_is_not_taken_for_a_droop():
    """At a high gain the engine reaches its highest torque, which a droop explains in part."""
    vessel = fp.Vessel.load("stan-launch-804")
    own = {"actuator.dead_time_s": 0.08, "actuator.lag_s": 0.09, "governor.K_p": 12.0, "governor.K_i": 2.0}
    chirp = fp.signals.chirp(0.01, 3.0, 200.0, 30.0, rate_hz=50.0)
    record = fp.simulate(vessel.replace(own), chirp, noise={"n_e": 0.05, "M_b": 0.1}, seed=21)
    known = {"T_M": 0.0, "T_f": 0.0, "tau_eng": 0.0, "c_2": 0.0, "tau_twist": 0.0}
    found = fp.identify(record, torque="brake", outputs=["dn", "dM"], fixed=known)
    assert "droop" not in found.parameters
    gain = found["vK_p"].ci95
    assert gain is None or gain[0] < 12.0 * vessel.operating_point.v < gain[1]


def test_a_stiff_governor_that_droops_takes_no_shorter_steps():
    """A gain of 1000 beside a droop of 5 % acts as a gain of 20, and is simulated in the time of that."""
    structure = Structure.ship(["droop"])
    values = {"tau_n": 1.4, "g": -0.5, "vK_p": 1000.0, "vK_i": 1000.0, "p": 2.0, "droop": 0.05}
    rest = {"n_e": 1600.0, "n_set": 1600.0, "M_b": 500.0}
    still = {name: np.full(200, value) for name, value in rest.items()}
    record = fp.Experiment("rest", 50.0, {**still, "n_set": 1600.0 + np.arange(200.0)}, rest)
    usual, fine = (replace(structure.equations, substeps=steps).simulate(values, record) for steps in (0, 60))
    np.testing.assert_allclose(usual, fine, atol=1e-4)


@pytest.mark.study
def test_droops_of_ships_with_other_inertias_and_gains():
    """DROOP_SHIPS tugs and launches (40), every second one with a droop of 1 to 6 %; nothing is given to the fit."""
    told, inside, ships = {True: 0, False: 0}, [], int(os.environ.get("DROOP_SHIPS", "40"))
    for seed in range(ships):
        random = np.random.default_rng([7, seed])
        vessel = fp.Vessel.load(str(random.choice(["stan-launch-804", "stan-tug-1205"])))
        droop = random.uniform(0.01, 0.06) if seed % 2 else 0.0
        own = parameters_of(vessel)
        changes = {name: own[name] * random.uniform(0.7, 1.4) for name in ("tau_n", "K_p")}
        changes |= {"K_i": changes["K_p"] * random.uniform(0.8, 2.5)}
        delays = {
            "actuator.dead_time_s": random.uniform(0.02, 0.08),
            "actuator.lag_s": random.uniform(0.02, 0.1),
        }
        vessel = with_parameters(vessel, changes).replace({**delays, "governor.droop": droop})
        torque = str(random.choice(["brake", "gauge"]))
        chirp = fp.signals.chirp(0.01, 3.0, 300.0, 20.0, rate_hz=50.0)
        noise = {"n_e": 0.03, "M_b": 0.06, "M_g": 0.06}
        record = fp.simulate(vessel, chirp, noise=noise, seed=seed)
        found = fp.identify(record, torque=torque, outputs=["dn", "dM"])
        told[droop > 0.0] += "droop" in found.parameters
        true = {"droop": 0.0, **parameters_of(vessel)}
        rows = {
            name: found.parameters[name]
            for name in ("tau_n", "vK_p", "vK_i", "p", "droop")
            if name in found.parameters
        }
        rows = {name: one for name, one in rows.items() if one.ci95 is not None}
        inside += [one.ci95[0] <= true[name] <= one.ci95[1] for name, one in rows.items()]
        shown = {name: tuple(round(end, 4) for end in one.ci95) for name, one in rows.items()}
        print(
            f"{seed}: {torque}, droop {droop:.4f}, {shown}; {sum(inside)} of {len(inside)} hold", flush=True
        )
    print(
        f"told: {told[True]} of {ships // 2} with a droop, {told[False]} of {ships - ships // 2} without one"
    )
    assert np.mean(inside) > 0.85
    assert told[False] <= 0.1 * ships
