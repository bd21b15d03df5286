"""A fingerprint of each kind comes back from its file as it was saved, whatever the fit has written into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

import shipfp_rs as fp
from tests.identification.test_identifiability import experiment, response, started_near_truth
from tests.identification.test_open_loop import TRUTH, recorded

LAUNCH = fp.Vessel.load("stan-launch-804")
NOISE = {"n_e": 0.3, "M_b": 0.5}
LIMITED = fp.Structure.ship(["torque_limit"], torque="brake").with_start(M_max=1.5)
FEW = dict.fromkeys(("dead_time_loop", "torque_limit", "rack_rate", "twist"), False)
PLAIN = fp.Structure.linear(products=True)


def steps(*, held: bool) -> fp.Experiment:
    """Return steps of the set point, whose samples are held or joined by straight lines; the record does not say so."""
    given = fp.signals.steps([40.0, -60.0, 30.0, -30.0, 50.0], 8.0, lead_s=5.0, rate_hz=25.0)
    found = fp.simulate(LAUNCH, replace(given, hold="zero" if held else "first"), noise=NOISE, seed=2)
    return replace(found, hold="first")


def joint() -> fp.Fingerprint:
    trials = [replace(experiment(PLAIN, noise=0.02), name=name) for name in ("first", "second")]
    both = fp.Structure.joint(
        {trial.name: started_near_truth(PLAIN) for trial in trials}, shared=["g", "vK_p", "vK_i"]
    )
    return fp.identify(trials, both, intervals="symmetric")


KINDS: dict[str, Callable[[], fp.Fingerprint]] = {
    "ship, straight lines": lambda: fp.identify(
        steps(held=False), elements=FEW, fixed={"T_set": 0.0, "T_s": 0.0}, intervals="symmetric"
    ),
    "ship, profiles": lambda: fp.identify(steps(held=True), elements=FEW, fixed={"T_set": 0.0, "T_s": 0.0}),
    "given ship with a limit": lambda: fp.identify(steps(held=True), LIMITED, intervals="symmetric"),
    "linear": lambda: fp.identify(experiment(PLAIN), PLAIN, vessel="launch", time_limit_s=60.0),
    "linear, white": lambda: fp.identify(experiment(PLAIN), PLAIN, noise="white", seed=None),
    "tied": lambda: fp.identify(
        experiment(PLAIN), PLAIN.with_tied(vK_i=("vK_p", 0.1)), intervals="symmetric"
    ),
    "joint": joint,
    "open loop": lambda: fp.identify(recorded(TRUTH), intervals="symmetric"),
    "responses": lambda: fp.identify(response(PLAIN), PLAIN),
    "responses and experiment": lambda: fp.identify([response(PLAIN), experiment(PLAIN)], PLAIN),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_holds_what_was_found(kind: str, tmp_path) -> None:
    found = KINDS[kind]()
    path = found.save(tmp_path / "fingerprint.json")
    again = fp.Fingerprint.load(path)
    assert again.to_dict() == found.to_dict()
    assert str(again) == str(found)
    assert again.save(tmp_path / "again.json").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("between", ["band-limited", "straight", "held", "straight lines"])
def test_each_way_of_a_set_point_between_its_samples_is_read(between: str, tmp_path) -> None:
    found = fp.identify(experiment(PLAIN), PLAIN, noise="white", intervals="symmetric")
    told = replace(found, settings={**found.settings, "set_point": between})
    assert fp.Fingerprint.load(told.save(tmp_path / "fingerprint.json")).settings["set_point"] == between
