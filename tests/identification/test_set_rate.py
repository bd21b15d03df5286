"""A ramp on the set point, as drives have it: found, given, and left out where there is none."""

from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs import _core
from shipfp_rs.structures.ship import INDEX, KERNEL, rate_limited
from shipfp_rs.structures.structure import Structure
from tests.identification.parity import FINE_HZ, SHIP, Case, excitation, fp_low_pass

RATE = 0.05


@cache
def record(rate: float | None) -> fp.Experiment:
    """A drive whose set point rises and falls at most at a rate, measured behind a low-pass."""
    time = np.arange(100_000) / FINE_HZ
    asked = excitation(Case(amplitude=0.03, seconds=100.0), time)
    parameters = np.array(_core.SHIP_OFF)
    parameters[INDEX["v"]] = 1.0
    for name, value in SHIP.items():
        parameters[INDEX[KERNEL.get(name, name)]] = value
    followed = asked if rate is None else rate_limited(asked, rate, FINE_HZ)
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b")]
    rows = _core.simulate_ship(parameters, 1.0 + followed, np.empty(0), 1.0 / FINE_HZ, 2, "first", outputs)
    taps, random = fp_low_pass(50.0), np.random.default_rng(1)
    low = [np.convolve(np.pad(row, 500, mode="edge"), taps, "valid")[::20] for row in (asked, *rows)]
    noise = [level * random.standard_normal(len(low[0])) for level in (0.0, 1e-4, 5e-4)]
    signals = {
        name: 1000.0 * (1.0 + row + more)
        for name, row, more in zip(("n_set", "n_e", "M_b"), low, noise, strict=True)
    }
    return fp.Experiment("ramp", 50.0, signals, dict.fromkeys(signals, 1000.0), provenance={"filter": "FIR"})


def test_a_ramp_is_found_with_its_rate_and_the_ship_behind_it():
    found = fp.identify(record(RATE))
    assert found.elements["set_rate"]["state"] == "on"
    assert found["set_rate"].value == pytest.approx(RATE, rel=0.02)
    assert {name for name in ("torque_limit", "rack_rate") if found.elements[name]["state"] == "on"} == set()
    for name in ("tau_n", "vK_p", "vK_i", "p", "T_d", "T_set"):
        low, high = found[name].ci95
        assert low <= SHIP[name] <= high, name


def test_a_ship_without_a_ramp_has_none():
    assert fp.identify(record(None), intervals="symmetric").elements["set_rate"]["state"] == "off"


def test_a_known_rate_is_taken_as_it_is_and_simulated():
    known = fp.identify(record(RATE), fixed={"set_rate": RATE}, intervals="symmetric")
    assert (known["set_rate"].value, known["set_rate"].status) == (RATE, "fixed")
    assert known["tau_n"].value == pytest.approx(SHIP["tau_n"], rel=0.02)
    structure = Structure.ship(["dead_time_loop", "dead_time_set_point", "set_rate"])
    outputs = structure.equations.simulate({**SHIP, "set_rate": RATE, "set point scale": 0.0}, record(RATE))
    torque = record(RATE).normalised("M_b")
    assert np.std(outputs[1] - torque) < 0.1 * np.std(torque)


def test_a_ramp_is_the_limit_of_fine_steps():
    time = np.arange(500) / 50.0
    signal = 0.1 * np.sin(0.8 * time)
    found = rate_limited(signal, 0.03, 50.0)
    assert np.abs(np.diff(found)).max() <= 0.03 / 50.0 * (1.0 + 1e-9)
    np.testing.assert_allclose(rate_limited(signal, 10.0, 50.0), signal, atol=1e-5)
