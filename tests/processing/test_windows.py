"""Windows of a trial are found where the generator ran them, whatever the noise and the pauses."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli, signals
from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial import KINDS
from shipfp_rs.processing.windows import _whole, find_windows, longest_rest
from shipfp_rs.simulation.raw_log import EQUATION_6_7

RATE = 400.0
NOISE_V = 0.004
SINES_HZ = (0.0193, 0.0405, 0.11, 0.3728, 1.637, 7.19, 15.01)
BORDER_S = 2.5
"""Largest distance of a border from the truth: a slow sine has left its level by little after a second or two."""


def schedule(seed: int) -> tuple[Log, list[tuple[str, float, float]]]:
    """Sines, chirps and steps like those of Table 6.7 in any order, pauses of 20 to 60 s; relay jumps on top."""
    rng = np.random.default_rng(seed)
    sines = rng.choice(SINES_HZ, 4, replace=False)
    parts = [
        *(("sine", signals.sine_sequence([f], max(4, round(30 * f)), 76.0, rate_hz=RATE)) for f in sines),
        ("chirp", signals.chirp(0.004, 3.981, 250.0, 76.0, rate_hz=RATE)),
        ("chirp", signals.chirp(0.015, 0.27, 250.0, 76.0, rate_hz=RATE)),
        ("steps", signals.steps([250.0, -250.0, -250.0, 250.0], 20.0, rate_hz=RATE)),
    ]
    pieces, truth, at = [], [], 0
    for index in [*rng.permutation(len(parts)), -1]:
        pause = round(rng.uniform(20.0, 60.0) * RATE)
        pieces.append(np.zeros(pause))
        at += pause
        if index >= 0:
            kind, excitation = parts[index]
            pieces.append(excitation.samples)
            truth.append((kind, at / RATE, (at + len(excitation)) / RATE))
            at += len(excitation)
    volts = EQUATION_6_7.inverse(1183.8 + np.concatenate(pieces))
    volts += rng.normal(0.0, NOISE_V, len(volts))
    for place in rng.integers(0, len(volts) - 20, 10):
        volts[place : place + rng.integers(2, 16)] += rng.choice([-2.0, 2.0])
    return Log.from_arrays({"U": volts.astype(np.float32)}, rate_hz=RATE, units={"U": "V"}), truth


@pytest.mark.parametrize("seed", range(10))
def test_every_window_is_found_with_its_kind_and_borders(seed):
    log, truth = schedule(seed)
    found = [window for window in find_windows(log, "U") if window.kind != "steady"]
    assert [window.kind for window in found] == [kind for kind, _, _ in truth]
    for window, (kind, start_s, stop_s) in zip(found, truth, strict=True):
        assert abs(window.start_s - start_s) < BORDER_S, window
        # The last level of the steps is that of the pause: their end is where one more hold would end.
        assert abs(window.stop_s - stop_s) < BORDER_S, window
        if kind == "sine":
            asked_hz = min(SINES_HZ, key=lambda one: abs(one - window.frequency_hz[0]))
            assert window.frequency_hz[0] == pytest.approx(asked_hz, rel=0.02)
        if kind == "chirp":
            assert window.frequency_hz[0] < window.frequency_hz[1]


def test_rests_are_at_the_level_of_the_pauses():
    log, truth = schedule(1)
    found = find_windows(log, "U")
    rest = longest_rest(found)
    assert rest is not None
    assert EQUATION_6_7(rest.level) == pytest.approx(1183.8, abs=1.0)
    for start_s, stop_s in ((start, stop) for kind, start, stop in truth if kind != "steps"):
        assert rest.stop_s <= start_s + 1.0 or rest.start_s >= stop_s - BORDER_S


def test_a_set_point_that_never_moves_is_one_rest():
    rng = np.random.default_rng(0)
    log = Log.from_arrays({"U": -5.0 + rng.normal(0.0, NOISE_V, 40_000)}, rate_hz=RATE)
    (rest,) = find_windows(log, "U")
    assert (rest.kind, rest.start_s, rest.stop_s) == ("steady", 0.0, 100.0)


@pytest.mark.parametrize(
    ("samples", "message"), [(np.ones(100), "100 samples"), (np.full(40_000, np.nan), "no finite sample")]
)
def test_channels_without_enough_in_them_are_refused(samples, message):
    with pytest.raises(InputError, match=message):
        find_windows(Log.from_arrays({"U": samples}, rate_hz=RATE), "U")


def test_init_writes_what_a_log_shows(tmp_path: Path, capsys):
    log, truth = schedule(3)
    path = log.write(tmp_path / "run.parquet")
    assert cli.main(["init", str(tmp_path), "--log", str(path), "--set-point", "U"]) == 0
    assert "S1" in capsys.readouterr().out
    trial = tomllib.loads((tmp_path / "TRIAL.toml").read_text())
    assert [window["kind"] for window in trial["windows"]] == [kind for kind, _, _ in truth]
    assert trial["channels"]["set_point"] == {"column": "U", "unit": "V", "calibration": "to be given"}
    assert trial["trial"] == {"name": "run", "log": str(path)}
    start_s, stop_s = trial["operating_point"]["steady_s"]
    recorded = log.read("U", start_s + 1.0, stop_s - 1.0)
    assert np.median(np.abs(EQUATION_6_7(recorded) - 1183.8)) < 2.0


@pytest.mark.parametrize("shift_s", [0.0, 0.4])
def test_steps_of_a_set_point_logged_on_change_are_found(shift_s, tmp_path: Path, capsys):
    changes = 14.0 * np.arange(45) + np.random.default_rng(1).uniform(-shift_s, shift_s, 45).round(1)
    level = 50 + 5 * (np.arange(45) % 3)
    rows = [(time, f"{at},,") for time, at in zip(changes - changes[0], level, strict=True)]
    rows += [
        (time, f",{400.0 + time % 7.0:.3f},{60.0 + time % 5.0:.3f}") for time in np.arange(0.0, 620.0, 0.1)
    ]
    path = tmp_path / "log.csv"
    path.write_text(
        "time [s],set point [%],speed [rpm],torque [kNm]\n"
        + "".join(f"{time:.1f},{cells}\n" for time, cells in sorted(rows))
    )
    (steps,) = (found for found in find_windows(Log.open(path), "set point") if found.kind == "steps")
    assert steps.start_s == pytest.approx(14.0, abs=1.0)
    assert steps.stop_s > 600.0
    assert cli.main(["init", "--log", str(path), str(tmp_path / "campaign")]) == 0
    assert "nothing but rest" not in capsys.readouterr().out
    assert "\nheld = true " in (tmp_path / "campaign" / "TRIAL.toml").read_text()


def excited(deviation: np.ndarray, rest_s: float = 20.0, rate: float = 50.0) -> Log:
    rest = np.zeros(round(rest_s * rate))
    rpm = 1200.0 + np.concatenate([rest, deviation, rest])
    return Log.from_arrays({"U": rpm + np.random.default_rng(1).normal(0.0, 0.3, len(rpm))}, rate_hz=rate)


def squares(periods_s: list[float], count: int) -> signals.Excitation:
    """Square waves one after the other at 100 Hz."""
    halves = np.repeat(periods_s, 2 * count)
    levels = np.repeat(20.0 * (-1.0) ** np.arange(halves.size), np.round(50.0 * halves).astype(int))
    return signals.Excitation("squares", "squares", 100.0, levels)


@pytest.mark.parametrize("rest_s", [20.0, 0.0])
@pytest.mark.parametrize(
    ("lines", "period_s", "periods"),
    [
        (np.geomspace(0.03, 1.5, 12), 100.0, 1),
        (np.geomspace(0.05, 1.5, 10), 40.0, 3),
        (np.arange(1, 21) / 40.0, 40.0, 2),
    ],
    ids=["lines far apart, once", "lines far apart, thrice", "every line, twice"],
)
def test_a_multisine_is_called_so(lines, period_s, periods, rest_s):
    asked = signals.multisine(lines, period_s, 20.0, periods=periods, rate_hz=50.0).samples
    (found,) = [window for window in find_windows(excited(asked, rest_s), "U") if window.kind != "steady"]
    assert (found.name, found.kind) == ("M1", "multisine")
    assert found.frequency_hz == pytest.approx((lines[0], lines[-1]), rel=0.2)


@pytest.mark.parametrize(
    "excitation",
    [
        signals.chirp(0.03, 1.5, 100.0, 20.0, rate_hz=50.0),
        signals.chirp(0.03, 1.5, 100.0, 20.0, law="logarithmic", rate_hz=50.0),
        signals.band_limited_noise(0.02, 1.0, 100.0, 10.0, seed=1, rate_hz=50.0),
        signals.prbs(7, 1.0, 20.0, rate_hz=50.0),
        signals.prbs(5, 1.0, 20.0, periods=4, rate_hz=50.0),
        signals.sine_sequence([0.05, 0.1, 0.2, 0.5], 4, 20.0, rate_hz=50.0),
    ],
    ids=lambda excitation: excitation.name,
)
def test_what_is_no_multisine_is_not_called_so(excitation):
    found = find_windows(excited(excitation.samples), "U")
    assert "multisine" not in {window.kind for window in found}


@pytest.mark.parametrize("cut_s", [0.0, 5.0])
@pytest.mark.parametrize(
    ("excitation", "kind"),
    [
        (signals.standard("multisine", 120.0, 20.0), "multisine"),
        (signals.standard("multisine", 300.0, 20.0), "multisine"),
        (signals.standard("sines", 120.0, 20.0), "sines"),
        (signals.standard("chirp", 120.0, 20.0), "chirp"),
        (signals.standard("prbs", 120.0, 20.0), "prbs"),
        (signals.standard("noise", 120.0, 20.0), "other"),
        (squares([4.0], 20), "squares"),
        (squares([8.0, 4.0, 2.0], 6), "squares"),
        (signals.sine_sequence([0.25], 20, 20.0, rate_hz=100.0), "sine"),
    ],
    ids=lambda one: getattr(one, "name", one),
)
def test_the_kind_of_an_excitation_is_told_in_the_whole_log_and_in_a_stretch_of_it_alike(
    excitation, kind, cut_s
):
    log = excited(excitation.samples, rate=100.0)
    stop_s = 20.0 + excitation.duration
    for stretch in ((), (20.0 + cut_s, stop_s - cut_s)):
        found = [window for window in find_windows(log, "U", *stretch) if window.kind != "steady"]
        assert [window.kind for window in found] == [kind]
        assert kind in KINDS
        if stretch:
            assert (found[0].start_s, found[0].stop_s) == pytest.approx(stretch, abs=0.51)


@pytest.mark.parametrize("seed", range(5))
def test_a_stair_of_chance_is_no_multisine(seed):
    heights = np.random.default_rng(seed).uniform(-20.0, 20.0, 14)
    found = find_windows(excited(np.convolve(np.repeat(heights, 450), np.ones(10) / 10, mode="same")), "U")
    assert "multisine" not in {window.kind for window in found}


def test_two_series_of_steps_are_two_windows():
    stairs = signals.steps([250.0, -250.0], 20.0, rate_hz=RATE).samples
    deviation = np.concatenate([np.zeros(20_000), stairs, np.zeros(40_000), stairs, np.zeros(20_000)])
    volts = EQUATION_6_7.inverse(1183.8 + deviation)
    volts += np.random.default_rng(0).normal(0.0, NOISE_V, len(volts))
    log = Log.from_arrays({"U": volts}, rate_hz=RATE)
    steps = [window for window in find_windows(log, "U") if window.kind == "steps"]
    assert [round(window.start_s) for window in steps] == [50, 190]
    assert [round(window.stop_s) for window in steps] == [90, 230]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("hum", [0.0, 0.01])
def test_a_stair_of_short_levels_is_steps_whatever_its_crossings_look_like(seed: int, hum: float):
    """Its levels cross their middle as a chirp does, and the mains' hum about one that lies there as a sine does."""
    random, rate = np.random.default_rng(seed), 400.0
    holds = np.round(random.uniform(4.0, 9.0, 4 + seed % 3) * rate).astype(int)
    heights = np.where(np.arange(len(holds)) % 2, -1.0, 1.0) * random.uniform(0.1, 1.0, len(holds))
    stair = np.repeat(heights * (1.0 if seed % 2 else np.linspace(1.0, 0.2, len(holds))), holds)
    time = np.arange(len(stair) + round(40.0 * rate)) / rate
    volts = np.pad(stair, round(20.0 * rate)) + hum * np.sin(2.0 * np.pi * 50.0 * time)
    log = Log.from_arrays({"U": volts + random.normal(0.0, 0.003, len(volts))}, rate_hz=rate)
    assert {window.kind for window in find_windows(log, "U")} == {"steady", "steps"}


def test_a_loss_within_another_ends_with_the_longer_one():
    set_point, load = np.zeros((2, 100 * 50))
    set_point[20 * 50 : 60 * 50] = load[30 * 50 : 40 * 50] = np.nan
    log = Log.from_arrays({"set point": set_point, "load": load}, rate_hz=50.0)
    assert _whole(log, ["set point", "load"], 0.0, 100.0) == [(0.0, 20.0), (60.0, 100.0)]
