"""A set point that a bus brings and the engine holds: stairs show in what is read as seldom, by a plant of no package's."""

from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import shipfp_rs as fp
from shipfp_rs.identification.load_side import load_side_of
from shipfp_rs.identification.question import question_of
from shipfp_rs.logs.channel import Channel, blocks_of
from tests.families import small_steps
from tests.families.plant import physical

CYCLE_S, STEP_S = 0.04, 1e-3
REST_S, CHIRP_S = 25.0, 100.0
"""Before and after what moves, and how long it moves."""
TRUE = {
    "tau_n": 2.4, "g": -0.05, "p": 2.1, "vK_p": 8.0, "vK_i": 8.0, "T_d": 0.05, "T_set": 0.02, "tau_act": 0.015,
    "tau_prop": 0.5, "T_s": 0.0, "update": 1.0,
}  # fmt: skip


@cache
def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Held set point, speed and torque of a pod in waves, each over its operating point, at each step."""
    grid = np.arange(round((CHIRP_S + 2.0 * REST_S) / STEP_S)) * STEP_S
    late, highest = np.clip(grid - REST_S, 0.0, CHIRP_S), TRUE["vK_p"] / TRUE["tau_n"] / (2.0 * np.pi) * 2.5
    growth = np.log(highest / 0.03) / CHIRP_S
    chirp = np.sin(2.0 * np.pi * 0.03 * np.expm1(growth * late) / growth)
    fade = np.interp(late, [0.0, 1.0, CHIRP_S - 1.0, CHIRP_S], [0.0, 1.0, 1.0, 0.0])
    held = round(CYCLE_S / STEP_S)
    asked = (1.0 + 0.0214 * chirp * fade)[np.arange(len(grid)) // held * held]
    keep = np.exp(-2.0 * np.pi * 0.92 * STEP_S)
    rough = lfilter(
        [np.sqrt(1.0 - keep**2)], [1.0, -keep], np.random.default_rng(2).standard_normal(len(grid))
    )
    heard, push = (partial(np.interp, xp=grid, fp=row) for row in (asked, 0.0038 * rough))
    plant = physical(dict(TRUE), engine_speed=1.0, shaft_torque=1.0)
    ran = small_steps.simulate(plant, heard, len(grid) * STEP_S, step_s=STEP_S, load=push)
    return asked, ran.engine_speed, ran.brake_torque


@cache
def read(every_s: float = CYCLE_S) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Set point, speed and torque of a pod, each over its operating point, read every so many seconds."""
    random, every = np.random.default_rng(5), round(every_s / STEP_S)
    asked, speed, torque = (row[::every] for row in moved())
    speed = speed + 1e-4 * random.standard_normal(len(speed))
    return asked, speed, torque + 1e-3 * random.standard_normal(len(torque))


def asked(hold: str = "zero"):
    """The question of what was read, and the vector of the truth."""
    set_point, speed, torque = read()
    signals = {"n_set": 120.0 * set_point, "n_e": 120.0 * speed, "M_b": 5e4 * torque}
    point = {"n_set": 120.0, "n_e": 120.0, "M_b": 5e4}
    question = question_of([fp.Experiment("pod", 1.0 / CYCLE_S, signals, point, hold=hold)])
    likelihood = question.likelihood(None)
    known = {**TRUE, "T_M": 0.0, "T_n": 0.0, "T_s": 0.001, "c_2": 0.0}
    return question, likelihood, likelihood.coordinates.vector(known)


def test_images_that_are_only_compared_are_those_that_are_taken_off():
    _, likelihood, vector = asked()
    values, states = likelihood.coordinates.values(vector), np.zeros(2)
    before = likelihood.models[0].effect(values, states)
    after = likelihood.corrected(vector).models[0].effect(values, states)
    assert np.abs(before[1]).max() > 0.01 * np.abs(likelihood.records[0].spectrum[1]).max()
    assert np.abs(after).max() < 1e-12 * np.abs(before).max()
    gone = likelihood.records[0].spectrum - likelihood.corrected(vector).records[0].spectrum
    np.testing.assert_allclose(gone[:, 1:], before[:, 1:], atol=0.03 * np.abs(before).max())


def test_the_truth_leaves_noise_alone_before_and_after_images_are_taken_off():
    _, likelihood, vector = asked()
    truth = likelihood.with_noise(vector)
    for one in (likelihood, likelihood.corrected(vector)):
        torque = one.residual(vector, 0)[1]
        expected = truth.residual(vector, 0)[1]
        assert np.abs(torque - expected).max() < 0.3 * np.sqrt(np.mean(np.abs(expected) ** 2))


def test_derivatives_are_those_of_the_residuals_with_images():
    _, likelihood, vector = asked()
    _, jacobian = likelihood.spectra(vector, 0)
    for place, name in enumerate(likelihood.coordinates.names):
        if name in ("T_s", "tau_twist", "tau_eng"):
            continue  # they have no value below zero, where they are
        step = np.zeros(len(vector))
        step[place] = 1e-6
        up, down = (likelihood.residual(vector + sign * step, 0) for sign in (1.0, -1.0))
        slopes = (up - down) / 2e-6
        np.testing.assert_allclose(-jacobian[place], slopes, atol=0.02 * np.abs(slopes).max() + 1e-9)


def test_the_drive_behind_stairs_is_the_plant_and_its_torque_is_not_read_late():
    question, likelihood, vector = asked()
    others = dict.fromkeys(("torque_limit", "rack_rate", "twist"), False)
    found = fp.identify(question.experiments, elements=others)
    for name in ("tau_n", "p", "vK_p", "vK_i", "T_d", "T_M"):
        low, high = found[name].ci95
        assert low <= TRUE.get(name, 0.0) <= high, name
    alone = load_side_of(question, likelihood.corrected(vector).records).parameters
    assert abs(alone["T_M"].value) < 2.0 * alone["T_M"].std
    assert abs(alone["tau_n"].value - TRUE["tau_n"]) < 2.0 * alone["tau_n"].std
    # As if nothing were held, stairs turn the torque's phase as if it were read early.
    smooth, likelihood, vector = asked("first")
    plain = load_side_of(smooth, likelihood.corrected(vector).records).parameters
    assert plain["T_M"].value < -2.5 * plain["T_M"].std


@pytest.mark.parametrize(("torque_s", "hold"), [(CYCLE_S, "zero"), (CYCLE_S / 10.0, "first")])
def test_a_torque_that_is_read_often_shows_no_stairs_behind_the_low_pass(torque_s, hold, tmp_path: Path):
    set_point, speed, _ = read()
    _, _, torque = read(torque_s)
    rows = {"n_set": 120.0 * set_point, "n": 120.0 * speed, "torque": 50.0 * torque}
    rates = {"torque": 1.0 / torque_s}
    channels = [Channel(key, "", rates.get(key, 1.0 / CYCLE_S), len(row)) for key, row in rows.items()]
    log = fp.Log("pod", channels, blocks_of(rows))
    (tmp_path / "TRIAL.toml").write_text(
        f'[trial]\nname = "pod"\nlog = "pod"\n[channels.set_point]\ncolumn = "n_set"\nunit = "rpm"\nheld = true\n'
        f'[channels.torque]\ncolumn = "torque"\nunit = "kNm"\nlocation = "brake"\n'
        f'[channels.n]\ncolumn = "n"\nunit = "rpm"\nshaft = "engine"\n'
        f"[operating_point]\nsteady_s = [0.0, {REST_S}]\n[processing]\nrate_hz = 25.0\n"
        f'[[windows]]\nname = "chirp"\nkind = "chirp"\nstart_s = {REST_S - 3.0}\nstop_s = {REST_S + 100.0}\n',
        encoding="utf-8",
    )
    (found,) = fp.process(log, fp.Trial.load(tmp_path / "TRIAL.toml"))
    assert found.hold == hold
    # What follows the mean of a held sample follows it half a cycle late; stairs are the model's.
    first = round((REST_S - 3.0) / CYCLE_S)
    late = np.interp(
        np.arange(len(found)) - (0.5 if hold == "first" else 0.0) + first,
        np.arange(len(set_point)),
        set_point,
    )
    inner = slice(100, -100)
    assert np.abs(found.signals["n_set"] / 120.0 - late)[inner].max() < 5e-3
