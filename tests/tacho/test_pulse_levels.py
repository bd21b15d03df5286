"""Levels that follow a train: amplitudes that go with speed or fade, offsets that drift, wheels that lack a tooth.

`pytest -m study -k pick_ups -s` prints the figures of 100 records of each kind at 2, 5 and 10 kHz.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from shipfp_rs import tacho
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.speed_sources import with_missing

Array = npt.NDArray[np.float64]

TEETH = 6
RATED_RPS = 20.0
NOISE = 0.01
"""Standard deviation, of an amplitude of 1 at rated speed."""
KINDS = ("run-up", "from rest", "fading", "drift", "missing tooth", "run-up, missing tooth")


@dataclass(frozen=True)
class Record:
    """Samples of a pick-up with their times [s], and of each true pulse its time, height, and slope [1/s]."""

    rate_hz: float
    samples: Array
    pulse_s: Array
    height: Array
    slope: Array
    pulses: npt.NDArray[np.int64]


def record(kind: str, rate_hz: float, seed: int, duration_s: float = 60.0, noise: float = NOISE) -> Record:
    """Simulate a sinusoidal pick-up of six teeth; a missing tooth leaves the middle level for a whole pulse."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration_s * rate_hz)) / rate_hz
    way = time / duration_s
    if kind.startswith("run-up"):
        share = np.interp(way, [0.15, 0.8], [0.25, 1.0])
    elif kind == "from rest":
        share = np.interp(way, [0.0, 0.2, 0.8], [0.0, 0.02, 1.0])
    else:
        share = np.full(len(time), 0.7)
    amplitude = np.ones(len(time))
    if kind.startswith("run-up") or kind == "from rest":
        amplitude = share
    elif kind == "fading":
        amplitude = np.interp(way, [0.2, 0.5, 0.6, 0.9], [1.0, 0.0, 0.0, 1.0])
    swing = 1.0 + 0.003 * np.sin(2 * np.pi * 0.7 * time + rng.uniform(0.0, 6.3))
    speed = RATED_RPS * share * swing
    turned = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))) / rate_hz + rng.uniform()
    phase = TEETH * turned
    wave = np.sin(2.0 * np.pi * phase)
    missing = 12 if "missing" in kind else 0
    pulses = np.arange(np.ceil(phase[0]), np.floor(phase[-1]) + 1.0)
    if missing:
        wave = np.where(np.round(phase) % missing == 0, 0.0, wave)
        pulses = pulses[pulses % missing != 0]
    offset = 1.5 * np.sin(2 * np.pi * way) + 0.5 * np.sin(2 * np.pi * time / 7.0) if kind == "drift" else 0.0
    at = np.interp(pulses, phase, time)
    return Record(
        rate_hz,
        (amplitude * wave + offset + noise * rng.standard_normal(len(time))).astype(np.float32),
        at,
        2.0 * np.interp(at, time, amplitude),
        2.0 * np.pi * TEETH * np.interp(at, time, speed * amplitude),
        pulses.astype(np.int64),
    )


@dataclass(frozen=True)
class Outcome:
    """What became of the pulses of a record, and the errors of speed over the sampling limit and over those stated."""

    lost: int
    """Above the detection limit and not counted."""
    invented: int
    """Crossings that are no pulse, and second ones of a pulse."""
    untold: int
    """Neither counted nor in a gap."""
    gap_s: float
    over_limit: float
    over_stated: float
    counted: int


def _nearest(places: Array, values: Array) -> npt.NDArray[np.intp]:
    found = np.clip(np.searchsorted(places, values), 1, len(places) - 1)
    return found - (np.abs(places[found] - values) > np.abs(places[found - 1] - values))


def outcome(truth: Record, noise: float = NOISE) -> Outcome:
    """Find the pulses of a record and compare."""
    found = tacho.pulse_times(truth.samples, truth.rate_hz)
    true = truth.pulse_s
    period = np.gradient(true)
    place = _nearest(true, found.times_s)
    error = found.times_s - true[place]
    strange = np.abs(error) > 0.3 * period[place]
    counted = np.zeros(len(true), dtype=np.bool_)
    counted[place[~strange]] = True
    in_gap = np.zeros(len(true), dtype=np.bool_)
    for start, stop in found.gaps_s:
        in_gap |= (true >= start - 1e-9) & (true <= stop + 1e-9)
    # Half a pulse at either end of the record may not be armed, or not get high.
    whole = (np.arange(len(true)) > 0) & (np.arange(len(true)) < len(true) - 1)
    speed = tacho.speed_from_pulses(found, 1)
    single = speed.flags == tacho.PulseFlag.GOOD
    begins, ends = speed.time_s - 0.5 * speed.duration_s, speed.time_s + 0.5 * speed.duration_s
    first, last = (_nearest(true, edge[single]) for edge in (begins, ends))
    truly = (truth.pulses[last] - truth.pulses[first]) / (true[last] - true[first])
    wrong = speed.speed_rps[single] - truly
    # A straight line between two samples has two thirds of their variance on average.
    timing = np.sqrt(2.0 / 3.0) * noise * np.hypot(1.0 / truth.slope[first], 1.0 / truth.slope[last])
    return Outcome(
        int(np.count_nonzero(~counted & (truth.height > found.limit) & whole)),
        int(np.count_nonzero(strange) + len(place) - len(np.unique(place))),
        int(np.count_nonzero(~counted & ~in_gap & whole)),
        float(np.sum(np.diff(found.gaps_s))),
        float(np.sqrt(np.mean((wrong / (timing * truly**2)) ** 2))),
        float(np.sqrt(np.mean((wrong / speed.std_rps[single]) ** 2))),
        int(np.count_nonzero(counted)),
    )


RATE = 2000.0
CASES = Path(__file__).parents[1] / "data" / "cases"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rate_hz", [2000.0, 10_000.0])
def test_breakage_c1_every_pulse_is_counted_or_lies_in_a_gap(kind, rate_hz):
    found = outcome(record(kind, rate_hz, seed=1, duration_s=40.0))
    assert (found.lost, found.invented, found.untold) == (0, 0, 0)
    assert found.over_limit < 1.1
    assert (found.gap_s > 1.0) == (kind in ("from rest", "fading"))


@pytest.mark.parametrize("rate_hz", [2000.0, 20_000.0])
@pytest.mark.parametrize("pulses_hz", [0.7, 4.33])
@pytest.mark.parametrize("share", [0.003, 0.4])
def test_a_slow_train_is_counted_however_fast_the_logger(rate_hz, pulses_hz, share):
    # One mark on a propeller's shaft: nearly all of the record is the noise between two edges.
    time = np.arange(round(90.0 * rate_hz)) / rate_hz
    turns = pulses_hz * time + 0.01 * np.sin(0.5 * time) + 0.5
    samples = 4.8 * (turns % 1.0 < share) + 0.1 + 0.03 * np.random.default_rng(8).standard_normal(len(time))
    found = tacho.pulse_times(samples.astype(np.float32), rate_hz)
    crossed = np.interp(np.arange(1.0, turns[-1]), turns, time)
    assert len(found.times_s) == len(crossed)
    assert np.abs(found.times_s - crossed).max() < 1.0 / rate_hz
    assert len(found.gaps_s) == 0


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_pick_ups_of_a_hundred_seeds(kind):
    for rate_hz in (2000.0, 5000.0, 10_000.0):
        every = [outcome(record(kind, rate_hz, seed)) for seed in range(100)]
        lost, invented, untold = (
            sum(getattr(one, name) for one in every) for name in ("lost", "invented", "untold")
        )
        limit = float(np.sqrt(np.mean([one.over_limit**2 for one in every])))
        stated = float(np.sqrt(np.mean([one.over_stated**2 for one in every])))
        counted = sum(one.counted for one in every)
        print(
            f"{kind:>22} at {rate_hz:5g} Hz: {counted} pulses, {lost} lost, {invented} invented, {untold} untold, "
            f"speed {limit:.3f} of the limit (worst {max(one.over_limit for one in every):.3f}), "
            f"{stated:.3f} of what is stated"
        )
        assert (lost, invented, untold) == (0, 0, 0)
        assert limit < 1.1
        assert 0.95 < stated < 1.05


@pytest.mark.parametrize("samples", [3.47, 4.56, 6.37, 12.71, 40.3])
@pytest.mark.parametrize("shape", ["square", "sine"])
def test_breakage_c2_the_stated_deviation_holds_from_three_samples_a_pulse(shape, samples):
    rng = np.random.default_rng(0)
    places = np.arange(120_000)
    ratios, means = [], []
    for steady in (False, True):
        period = samples * (1.0 + (0.0 if steady else 0.02) * np.sin(2.0 * np.pi * places / 30_000.0))
        phase = np.cumsum(1.0 / period)
        wave = np.where(phase % 1 < 0.4, 1.0, -1.0) if shape == "square" else np.sin(2.0 * np.pi * phase)
        train = (wave + 0.005 * rng.standard_normal(len(places))).astype(np.float32)
        speed = tacho.speed_from_pulses(tacho.pulse_times(train, RATE), 1)
        truth = RATE / np.interp(speed.time_s * RATE, places, period)
        ratios.append(np.sqrt(np.mean((speed.speed_rps - truth) ** 2) / np.mean(speed.std_rps**2)))
        means.append(np.mean(speed.speed_rps / truth))
    assert ratios == pytest.approx([1.0, 1.0], abs=0.05)
    assert means == pytest.approx([1.0, 1.0], abs=1e-3)


def test_saw_teeth_squares_and_bipolar_pulses_give_one_crossing_each():
    phase = np.cumsum(np.linspace(5.0, 25.0, 120_000)) / RATE
    way = phase % 1
    rng = np.random.default_rng(0)
    for wave in (
        way - 0.5,
        np.where(way < 0.1, 1.0, 0.0),
        np.exp(-(((way - 0.4) / 0.05) ** 2)) - np.exp(-(((way - 0.6) / 0.05) ** 2)),
    ):
        train = np.linspace(0.2, 1.0, len(wave)) * wave - 3.0 + 0.005 * rng.standard_normal(len(wave))
        found = tacho.pulse_times(train, RATE)
        assert abs(len(found.times_s) - phase[-1]) <= 1.0
        assert not len(found.gaps_s)


def test_the_hum_of_a_shaft_at_rest_is_no_train():
    time = np.arange(round(60.0 * RATE)) / RATE
    phase = np.cumsum(np.interp(time, [0.0, 20.0, 30.0], [20.0, 20.0, 0.0])) / RATE
    rng = np.random.default_rng(0)
    train = np.where((phase % 1 < 0.3) & (time < 30.0), 5.0, 0.0)
    train += 0.1 * np.sin(2.0 * np.pi * 50.0 * time) + 0.002 * rng.standard_normal(len(time))
    found = tacho.pulse_times(train, RATE)
    # The last few take longer and longer, and may be those of a shaft that has stopped.
    assert 0.0 <= phase[-1] - len(found.times_s) <= 6.0
    assert found.times_s[-1] < 30.0
    assert found.faint_s[-1] == pytest.approx([found.times_s[-1], 60.0])


def test_the_parts_of_a_gap_have_their_reasons():
    truth = record("fading", RATE, seed=0, duration_s=40.0)
    samples = truth.samples.copy()
    samples[4000:4400] = np.nan
    found = tacho.pulse_times(samples, RATE)
    np.testing.assert_array_equal(found.missing_s, [[2.0, 2.2]])
    assert len(found.gaps_s) == 1 + len(found.faint_s)
    assert 0.1 < found.limit < 0.2
    assert len(found.time_std_s) == len(found.times_s)


def test_a_train_of_zero_and_one_has_no_faint_pulses_beside_the_gap_of_its_wheel():
    log = Log.open(CASES / "changes_36_1.csv")
    pulses = tacho.pulse_times(log["Channel 0"], log.channel("Channel 0").rate_hz)
    assert len(pulses.faint_s) == 0
    assert len(pulses.times_s) == pytest.approx(1434, abs=1)


def test_edges_doubled_in_a_channel_of_states_leave_its_speed():
    log = Log.open(CASES / "double_edge.csv")
    pulses = tacho.pulse_times(log["Channel 0"], log.channel("Channel 0").rate_hz)
    speed = tacho.speed_from_pulses(pulses.at(with_missing(pulses.times_s, 60, 2)), 60)
    assert speed.turned_rev.sum() == pytest.approx(24.93, abs=0.02)
    np.testing.assert_allclose(speed.speed_rps * 60.0, 300.0, rtol=2e-3)
    (fault,) = log.faults
    assert (fault.kind, fault.channel, len(fault.spans), fault.excluded) == ("A", "Channel 0", 8, False)
    np.testing.assert_allclose(fault.spans[0, 0] / log.channel("Channel 0").rate_hz, 1 / 3, atol=1e-3)


def test_the_gap_of_a_wheel_at_constant_speed_is_no_missing_row(tmp_path):
    teeth = np.arange(3600)
    rises = teeth[teeth % 60 < 58] / 300.0
    rows = np.column_stack([rises, rises + 0.5 / 300.0]).ravel()
    path = tmp_path / "states.csv"
    lines = "".join(f"{time:.7f},{(k + 1) % 2}\n" for k, time in enumerate(rows))
    path.write_text("Time [s],Channel 0\n" + lines)
    log = Log.open(path)
    assert not log.faults
    pulses = tacho.pulse_times(log["Channel 0"], log.channel("Channel 0").rate_hz)
    speed = tacho.speed_from_pulses(pulses.at(with_missing(pulses.times_s, 60, 2)), 60)
    np.testing.assert_allclose(speed.speed_rps * 60.0, 300.0, rtol=2e-3)
