"""Without v and g: what the three parameters that remain stand for, what the fit finds, and what is lost."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from shipfp_rs import Structure, Vessel, signals, simulate
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.assessment.ladder import ladder
from shipfp_rs.assessment.prediction import predict
from shipfp_rs.identification.identify import identify
from shipfp_rs.vessel.linear_model import LinearModel, linearise
from tests.identification.test_identifiability import VALUES, experiment, response

FULL = LinearModel(
    **{name: VALUES[name] for name in ("tau_n", "g", "v", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set")}
)
EFFECTIVE = FULL.three_parameters()
"""Closed form: tau_n, vK_p and vK_i times p / (p - g)."""
NAMES = {"tau_n": EFFECTIVE.tau_n, "vK_p": EFFECTIVE.K_p, "vK_i": EFFECTIVE.K_i}
FREQUENCIES = np.geomspace(0.003, 20.0, 60)


@pytest.mark.parametrize("output", ["dn", "dE", "dM_g"])
def test_speed_and_a_gauges_torque_are_the_same_without_g(output):
    full, effective = (model.response(FREQUENCIES, [output]) for model in (FULL, EFFECTIVE))
    assert np.allclose(effective, full, rtol=1e-12)


def test_the_engines_torque_is_off_as_the_closed_form_says():
    full, effective = (model.response(FREQUENCIES, ["dM_b"])[0] for model in (FULL, EFFECTIVE))
    lag = FULL.tau_n * 2j * np.pi * FREQUENCIES
    r = FULL.p / (FULL.p - FULL.g)
    assert np.allclose(effective / full - 1.0, (r - 1.0) * lag / (FULL.p + lag), rtol=1e-9)
    # Exact where it is slow, at most 1 - r = 23 % where it is fast.
    assert abs(effective[0] / full[0] - 1.0) < 0.005
    assert np.abs(effective / full - 1.0).max() < 1.0 - r


@pytest.mark.parametrize("torque", ["brake", "gauge"])
@pytest.mark.parametrize("domain", ["time", "frequency"])
@pytest.mark.parametrize("delayed", [False, True])
def test_the_fit_finds_the_effective_values(torque, domain, delayed):
    options = {"dead_time_loop": True, "dead_time_set_point": True} if delayed else {}
    outputs = ("dn", "dM") if torque == "gauge" else ("dn",)
    full = Structure.linear(torque=torque, products=True, outputs=outputs, **options)
    three = Structure.three_parameters(torque=torque, **options)
    if domain == "time":
        found = identify(experiment(full), three, starts=1)
    else:
        found = identify(response(full), three, starts=1, weighting="std")
    expected = NAMES | {name: VALUES[name] for name in ("tau_prop", "T_d", "T_set") if name in three.names}
    for name, value in expected.items():
        assert abs(found[name].value - value) < 4 * found[name].std
        assert found[name].std < 0.01 * value
    assert found.identifiability.rank == found.identifiability.free
    assert found.model_adequate is not False
    assert any("v and g are left out" in line for line in found.verdict)


def test_the_engines_torque_fitted_along_is_called_wrong():
    found = identify(
        experiment(Structure.linear(products=True)), Structure.three_parameters(outputs=("dn", "dM"))
    )
    assert found.model_adequate is False
    # The fast torque wants the shaft's own time constant, not the effective one.
    assert found["tau_n"].value == pytest.approx(FULL.tau_n, rel=0.05)
    assert not any("left out" in line for line in found.verdict)


def test_a_ship_is_simulated_as_well_with_three_parameters_as_with_all():
    tug = Vessel.load("stan-tug-1205")
    trial = simulate(tug, signals.chirp(0.02, 1.0, 120.0, 12.0, rate_hz=20.0))
    steps = simulate(tug, signals.steps([12.0, -12.0], 20.0, rate_hz=20.0))
    own = {"p": linearise(tug).p}
    three = identify(trial, Structure.three_parameters().with_fixed(**own), noise="white")
    assert three["tau_n"].value == pytest.approx(linearise(tug).three_parameters().tau_n, rel=0.01)
    full = identify(trial, Structure.linear(products=True).with_fixed(**own), noise="white")
    rest = {
        fingerprint.structure["name"]: np.std(predict(fingerprint, steps)["n_e"] - steps.normalised("n_e"))
        / np.std(steps.normalised("n_e"))
        for fingerprint in (three, full)
    }
    # What is left is the curvature of the propeller, 1 % steps on either side of the point.
    assert max(rest.values()) < 0.01
    assert rest["three parameters"] < 1.05 * rest["linear"]


def test_the_ladder_starts_with_three_and_goes_on_only_where_the_data_tell_g():
    outputs = {"outputs": ("dn", "dM")}
    for torque, supported in (("gauge", False), ("brake", True)):
        full = Structure.linear(torque=torque, products=True)
        rungs = [Structure.three_parameters(torque=torque, **outputs), full]
        steps = ladder(experiment(full), rungs)
        assert [rung.supported for rung in steps.rungs] == [True, supported]


def test_a_saved_fingerprint_keeps_what_it_is(tmp_path):
    made = experiment(Structure.linear(products=True))
    found = identify(made, Structure.three_parameters())
    loaded = type(found).load(found.save(tmp_path / "fingerprint.json"))
    assert loaded.structure["three_parameters"] is True
    assert np.allclose(predict(loaded, made)["n_e"], predict(found, made)["n_e"])
    # The poles are those of the full loop: only names are lost.
    poles = closed_loop(loaded)
    expected = replace(FULL, T_d=0.0, T_set=0.0).poles
    for place, pole in enumerate(sorted(expected.real, reverse=True), 1):
        assert poles[f"pole {place}, real"].value == pytest.approx(pole, rel=0.01)
    assert asdict(EFFECTIVE)["g"] == 0.0
