"""Is a structure that lacks the engine's rate limiter found out by its residuals, and one that lacks nothing left alone?

The study (`pytest -m study -k wrong_model -s`) prints the shares; ALARM_DRAWS sets another number of logs than 200.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from shipfp_rs import Vessel, signals, simulate
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fingerprint_content import ALARM
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure
from tests.launch import noisy_record

SHIP = Vessel.load("stan-launch-804")
CHIRP = signals.chirp(0.05, 5.0, 30.0, 13.0, rate_hz=50.0)
STRUCTURE = Structure.linear(products=True)
LIMIT_NM_S = 250.0
"""The chirp asks for up to 1100 Nm/s, 31 rad/s times v K_p 0.01 M_b0; the limiter acts above 1 Hz."""
NOISE = 0.05
CORRELATION = 0.9
FALSE_ALARMS = 0.05


def of_the_structure(seed: int) -> Fingerprint:
    return identify(noisy_record(CHIRP, NOISE, CORRELATION, [3, seed]), STRUCTURE, intervals="symmetric")


def of_the_ship(seed: int, limit_Nm_s: float | None) -> Fingerprint:
    ship = SHIP.replace({"engine.torque_rate_Nm_s": limit_Nm_s})
    level = (NOISE, CORRELATION)
    trial = simulate(ship, CHIRP, noise={"n_e": level, "M_b": level}, seed=seed)
    return identify(trial, STRUCTURE, intervals="symmetric")


KINDS = {
    "made by the structure itself": of_the_structure,
    "made by the plant, no limiter": lambda seed: of_the_ship(seed, None),
    f"made by the plant, limiter of {LIMIT_NM_S:g} Nm/s": lambda seed: of_the_ship(seed, LIMIT_NM_S),
}


def told_wrong(fingerprints: list[Fingerprint]) -> float:
    return float(np.mean([found.model_adequate is False for found in fingerprints]))


@pytest.mark.study
def test_the_alarm_of_a_wrong_model_over_many_logs():
    draws = int(os.environ.get("ALARM_DRAWS", "200"))
    shares = {}
    print(f"\nStructure called wrong, {draws} logs of 30 s, noise {NOISE:.0%}, correlation {CORRELATION}")
    for kind, make in KINDS.items():
        fingerprints = [make(seed) for seed in range(draws)]
        shares[kind] = told_wrong(fingerprints)
        missed = np.median([found.fit["overall"]["structure_misses_pct"] for found in fingerprints])
        print(f"{kind:45} {shares[kind]:7.1%}   explained of what was left, median {missed:.2g} %")
    itself, plant, limited = shares.values()
    assert max(itself, plant) < FALSE_ALARMS
    assert binom.sf(round(itself * draws) - 1, draws, ALARM) > 1e-3
    assert limited > 0.99


def test_a_rate_limiter_that_the_structure_lacks_is_found_and_what_it_has_is_not():
    assert told_wrong([of_the_structure(seed) for seed in range(6)]) <= 1 / 6
    assert told_wrong([of_the_ship(seed, None) for seed in range(4)]) <= 1 / 4
    limited = [of_the_ship(seed, LIMIT_NM_S) for seed in range(6)]
    assert told_wrong(limited) == 1.0
    assert all(any("contradict the structure" in line for line in found.verdict) for found in limited)
    assert min(found.fit["overall"]["structure_misses_pct"] for found in limited) > 2.0


def test_the_verdict_counts_every_output_and_is_none_without_a_test():
    found = of_the_structure(0)
    least = min(found.fit[output]["input_correlation_p"] for output in ("dn", "dM"))
    assert found.fit["overall"]["structure_p"] == pytest.approx(min(1.0, 2 * least))
    assert replace(found, fit={"dn": {"nrmse_pct": 90.0}}, adequate={}).model_adequate is None
    assert Fingerprint._from_dict(found.to_dict()).model_adequate == found.model_adequate
