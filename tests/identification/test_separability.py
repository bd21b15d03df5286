"""The rack tells v, K_p and K_i apart; speed and torque alone tell vK_p and vK_i only."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import Fingerprint, Structure, Vessel, identify, process, signals, simulate
from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial import Trial
from shipfp_rs.runs.run import located, structure_from
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
from shipfp_rs.vessel.linear_model import linearise

LAUNCH = Vessel.load("stan-launch-804")
TUG = Vessel.load("stan-tug-1205").replace({"actuator.lag_s": 0.08})
CHIRP = signals.chirp(0.02, 3.0, 100.0, 6.0, rate_hz=25.0)
FINE = signals.chirp(0.03, 1.0, 60.0, 6.0, rate_hz=50.0)
"""Sampled so finely that straight lines between samples are as good as what a low-pass has passed."""
NOISE = dict.fromkeys(("n_e", "M_b", "M_g", "X_f"), 0.05)
GAINS = ("v", "K_p", "K_i")
TRUTH = {ship.name: dataclasses.asdict(linearise(ship)) for ship in (LAUNCH, TUG)}
TRUTH[TUG.name] |= {"tau_act": 0.08, "T_d": 0.0}
WITH, WITHOUT = ("dn", "dM", "dX"), ("dn", "dM")


def fitted(ship: Vessel, structure: Structure, seed: int) -> Fingerprint:
    record = simulate(ship, CHIRP if ship is LAUNCH else FINE, noise=NOISE, seed=seed)
    return identify(record, structure, noise="white", starts=1)


def holds(fingerprint: Fingerprint, name: str, truth: float) -> bool:
    low, high = fingerprint[name].ci95
    return low < truth < high


def launch(outputs: tuple[str, ...]) -> Structure:
    return Structure.linear(outputs=outputs, free_exponent=True)


def tug(outputs: tuple[str, ...], **known: float) -> Structure:
    """The tug's drive train with the lag of its actuator, torque at a gauge."""
    structure = Structure.ship(["actuator_lag"], outputs=outputs, torque="gauge", products=False)
    return structure.with_fixed(**known)


def assert_products_only(found: Fingerprint, truth: dict[str, float]) -> None:
    for name in GAINS:
        assert (found[name].value, found[name].status) == (None, "unidentifiable")
        assert all(other in found[name].reason for other in set(GAINS) - {name})
    for name in ("vK_p", "vK_i"):
        estimate = found.derived[name]
        assert abs(estimate.value - truth["v"] * truth[name[1:]]) < 4 * estimate.std
    assert set(GAINS) <= set(found.identifiability.closes_gap)
    assert any(line.startswith("Known together: ") and "vK_p" in line for line in found.verdict)


def test_speed_and_torque_tell_the_products_alone():
    found = fitted(LAUNCH, launch(WITHOUT), 1)
    assert_products_only(found, TRUTH[LAUNCH.name])
    assert (found.identifiability.rank, found.identifiability.free) == (5, 6)


def test_with_the_rack_each_is_told_by_itself():
    found = fitted(LAUNCH, launch(WITH), 1)
    assert found.identifiability.rank == found.identifiability.free == 6
    for name in (*GAINS, "tau_n", "g", "p"):
        estimate, truth = found[name], TRUTH[LAUNCH.name][name]
        assert estimate.status == "free"
        assert abs(estimate.value - truth) < 4 * estimate.std
        assert estimate.std < 0.06 * abs(truth)
    assert not found.identifiability.null_space


def test_behind_a_gauge_the_rack_tells_the_gains_and_one_more_must_be_known():
    truth = TRUTH[TUG.name]
    open_ = fitted(TUG, tug(WITH), 4)
    for name in ("K_p", "K_i", "p", "tau_prop", "tau_act"):
        assert abs(open_[name].value - truth[name]) < 4 * open_[name].std
    for name in ("v", "g", "tau_n"):
        # Only the curvature of the propeller's torque tells them.
        assert open_[name].std > 0.3 * abs(truth[name])
        assert holds(open_, name, truth[name])
    closed = fitted(TUG, tug(WITH, tau_n=truth["tau_n"]), 4)
    for name in (*GAINS, "g"):
        assert abs(closed[name].value - truth[name]) < 4 * closed[name].std
    assert_products_only(fitted(TUG, tug(WITHOUT, tau_n=truth["tau_n"]), 4), truth)


@pytest.mark.study
@pytest.mark.parametrize("ship", ["launch", "tug"])
def test_intervals_of_the_gains_hold_the_truth(ship):
    draws = int(os.environ.get("SEPARABILITY_DRAWS", "40"))
    vessel = LAUNCH if ship == "launch" else TUG
    truth = TRUTH[vessel.name]
    known = {} if ship == "launch" else {"tau_n": truth["tau_n"]}
    full, bare = (
        (launch(WITH), launch(WITHOUT)) if ship == "launch" else (tug(WITH, **known), tug(WITHOUT, **known))
    )
    held, widths, open_ = Counter(), Counter(), 0
    for seed in range(draws):
        found = fitted(vessel, full, seed)
        for name in (*GAINS, "g"):
            held[name] += holds(found, name, truth[name])
            widths[name] += 100.0 * found[name].std / abs(truth[name]) / draws
        open_ += all(fitted(vessel, bare, seed)[name].value is None for name in GAINS)
    print(f"\n{vessel.name}, {draws} draws, noise of 5 %: the rack is measured")
    for name, count in held.items():
        print(f"  {name:4} interval holds the truth in {count} of {draws}, std {widths[name]:.2g} %")
    print(f"  without it {', '.join(GAINS)} are left open in {open_} of {draws}")
    assert open_ == draws
    # Of 40 draws at 95 % fewer than 33 happen once in 20,000.
    assert all(count >= 0.825 * draws for count in held.values())


def with_fuel(log: Log, told: np.ndarray) -> Log:
    """The log and a channel of 50 samples a second."""
    kept = [log.channel(name) for name in log.channels if name != "fuel"]
    samples = {channel.name: log.read(channel.name) for channel in kept} | {"fuel": told}

    def blocks(channel: str, first: int, size: int) -> Iterator[np.ndarray]:
        for start in range(first, len(samples[channel]), size):
            yield samples[channel][start : start + size]

    return Log(log.name, [*kept, Channel("fuel", "%", 50.0, len(told), 0.0)], blocks)


@pytest.fixture(scope="module")
def recorded() -> tuple[Log, str]:
    """A log of the tug with its fuel in per cent from a bus: 50 a second, steps of 0.02 %, and the TRIAL.toml."""
    ship = Vessel.load("stan-tug-1205")
    chirp = signals.chirp(0.02, 1.5, 120.0, 20.0, rate_hz=500.0)
    log, truth = simulate_raw_log(ship, chirp, faults=(), steady_s=20.0, pause_s=10.0, seed=5)
    every = round(log.channel("U_torque").rate_hz / 50.0)
    X_0 = ship.operating_point.X_0_mm
    fuel = 45.0 * truth.clean.signals["X_f"][::every] / X_0
    told = 0.02 * np.round((fuel + np.random.default_rng(6).normal(0.0, 0.03, len(fuel))) / 0.02)
    log = with_fuel(log, told)
    rack = '[channels.rack]\ncolumn = "fuel"\nunit = "%"\ncalibration = { scale = 1.0, offset = 0.0 }\n\n'
    text = trial_toml("stan-tug-1205", "run.parquet", Sensors(), truth).replace(
        "[channels.PTM_1]", rack + "[channels.PTM_1]", 1
    )
    text = (
        text.replace("rate_hz = 50.0", "rate_hz = 20.0")
        + '\n[identify]\ntorque = "gauge"\nproducts = false\n'
    )
    return log, text


def trial_with(text: str, folder: Path, identify: str) -> Trial:
    (folder / "TRIAL.toml").write_text(text + identify)
    return Trial.load(folder / "TRIAL.toml")


def test_a_trial_with_a_rack_channel_tells_the_gains(recorded, tmp_path):
    log, text = recorded
    ship = Vessel.load("stan-tug-1205")
    truth = dataclasses.asdict(linearise(ship))
    known = f"\n[identify.fixed]\ntau_n = {truth['tau_n']}\n"
    trial = trial_with(text, tmp_path, 'outputs = ["dn", "dM", "dX"]\n' + known)
    (experiment,) = process(log, trial, ship)
    assert experiment.operating_point["X_f"] == pytest.approx(45.0, rel=1e-3)
    found = identify(experiment, structure_from(trial.identify, located(trial)), starts=1)
    for name in GAINS:
        # A log's filters and pulses leave less than a per cent of error beside the noise.
        assert found[name].value == pytest.approx(truth[name], rel=0.03)
        assert found[name].status == "free"
    bare = identify(experiment, structure_from(trial_with(text, tmp_path, known).identify, "gauge"), starts=1)
    for name in GAINS:
        assert bare[name].value is None


def test_the_racks_operating_point_may_be_given(recorded, tmp_path):
    log, text = recorded
    trial = trial_with(text.replace("[operating_point]", "[operating_point]\nX_mm = 50.0"), tmp_path, "")
    (experiment,) = process(log, trial, TUG)
    assert experiment.operating_point["X_f"] == 50.0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('column = "fuel"', 'column = "rack"', "no channel 'rack'"),
        ('unit = "%"', 'unit = "mm"', r"channel 'fuel' is in '%', channels\.rack\.unit says 'mm'"),
    ],
)
def test_a_wrong_rack_is_one_line(recorded, tmp_path, old, new, says):
    log, text = recorded
    with pytest.raises(InputError, match=says):
        process(log, trial_with(text.replace(old, new), tmp_path, ""), TUG)


def test_an_output_without_its_channel_is_one_line(recorded, tmp_path):
    log, text = recorded
    start, stop = text.index("[channels.rack]"), text.index("[channels.PTM_1]")
    trial = trial_with(text[:start] + text[stop:], tmp_path, 'outputs = ["dn", "dM", "dX"]\n')
    with pytest.raises(InputError, match=r"no signal for output 'dX', expected one of X_f"):
        identify(process(log, trial, TUG), structure_from(trial.identify, located(trial)))


def test_a_spike_of_the_rack_is_masked(recorded, tmp_path):
    log, text = recorded
    told = log.read("fuel").copy()
    told[3000] = 90.0
    spiky = with_fuel(log, told)
    (experiment,) = process(spiky, trial_with(text, tmp_path, ""), TUG)
    (fault,) = [fault for fault in experiment.provenance["faults"] if fault["channel"] == "fuel"]
    assert (fault["kind"], fault["spans"]) == ("spike", [[3000, 3001]])
    lost = np.isnan(experiment.signals["X_f"])
    assert 0 < lost.sum() <= 5
    assert not np.isnan(experiment.signals["n_e"][lost]).any()
