"""Trials of `simulate`, as a first user makes them: how often the intervals of `identify` hold the vessel's parameters."""

from __future__ import annotations

import itertools

import pytest

import shipfp_rs as fp

SINES_HZ = [0.02, 0.05, 0.1, 0.17, 0.31, 0.53, 0.9, 1.3]
LEVELS_RPM = [20.0, -20.0, 40.0, -10.0, 0.0, 25.0, -25.0, 10.0, -30.0, 0.0]


def excitation(kind: str, rate_hz: float) -> fp.signals.Excitation:
    """Return two minutes of a chirp, steps or sines."""
    if kind == "chirp":
        return fp.signals.chirp(0.02, 2.0, 120.0, 13.0, rate_hz=rate_hz)
    if kind == "steps":
        return fp.signals.steps(LEVELS_RPM, 12.0, rate_hz=rate_hz, lead_s=5.0)
    return fp.signals.multisine(SINES_HZ, 100.0, 25.0, rate_hz=rate_hz)


@pytest.mark.study
def test_intervals_of_simulated_trials_hold() -> None:
    """Print the counts of each kind; a line takes half a minute."""
    inside, known = 0, 0
    for kind in ("chirp", "steps", "sines"):
        own, told = 0, 0
        for name, rate_hz, torque, seed in itertools.product(
            ("stan-launch-804", "stan-tug-1205"), (25.0, 50.0, 100.0), ("M_b", "M_g"), (1, 2)
        ):
            vessel = fp.Vessel.load(name)
            truth = fp.linearise(vessel)
            values = {one: getattr(truth, one) for one in ("tau_n", "g", "p", "tau_prop", "T_d", "T_set")}
            values |= {"vK_p": truth.v * truth.K_p, "vK_i": truth.v * truth.K_i, "tau_twist": 0.0}
            noise = {"n_e": 0.03, "M_b": 0.1, "M_g": 0.1}
            trial = fp.simulate(vessel, excitation(kind, rate_hz), noise=noise, seed=seed)
            found = fp.identify(trial, outputs=["n_e", torque])
            ends = {one: found[one].ci95 for one in values if one in found and found[one].ci95 is not None}
            own += sum(low - 1e-9 <= values[one] <= high + 1e-9 for one, (low, high) in ends.items())
            told += len(ends)
        print(f"{kind}: {own} of {told} intervals hold")
        inside, known = inside + own, known + told
    assert inside > 0.92 * known
