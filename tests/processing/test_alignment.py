"""Two loggers with clocks of their own tell one time once a signal that both recorded is laid over itself."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.alignment import align, merged, on_clock
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
from shipfp_rs.vessel.vessel import Vessel

DRIFT, OFFSET_S = 100e-6, 37.123456
SLOW_HZ, FAST_HZ = 2000.0, 5000.0
HALF_A_SAMPLE_S = 0.5 / SLOW_HZ


def set_point(time: np.ndarray) -> np.ndarray:
    """Volts: every 20 minutes a chirp from 0.05 to 1 Hz through 10 of them, rest, and a stair of steps in between."""
    part = np.mod(time, 1200.0)
    chirp = np.where(part < 600.0, np.sin(2 * np.pi * (0.05 * part + 0.95 / 1200.0 * part**2)), 0.0)
    stairs = 0.1 * np.floor(time / 1200.0) % 0.7
    return -5.0 + 0.3 * chirp + stairs


def turns(time: np.ndarray) -> np.ndarray:
    """Angle of the shaft [rev] at 5 rev/s, swinging in ever other ways."""
    return 5.0 * time + 0.3 * np.sin(2 * np.pi * 0.05 * time) + 2.0 * np.sin(2 * np.pi * time / 700.0)


def pulses(time: np.ndarray) -> np.ndarray:
    """Volts of four pulses a turn with edges of 1.5 ms."""
    phase = np.mod(4.0 * turns(time), 1.0)
    width = 20.0 * 1.5e-3
    return 5.0 * np.clip(np.minimum(phase, 0.3 + width - phase) / width, 0.0, 1.0)


def logger(name: str, rate_hz: float, duration_s: float, clock: tuple[float, float], seed: int) -> Log:
    """A log that is made as it is read; its clock stands at (true time - offset) / (1 + drift)."""
    offset_s, drift = clock
    signals = {"U_setpoint": set_point, "PTM_4": pulses, "U_torque": set_point}
    count = round(duration_s * rate_hz)

    def blocks(channel: str, first: int, size: int) -> Iterator[np.ndarray]:
        for start in range(first, count, size):
            index = np.arange(start, min(start + size, count))
            noise = np.random.default_rng([seed, start]).normal(0.0, 0.004, len(index))
            true = offset_s + (1.0 + drift) * index / rate_hz
            yield (signals[channel](true) + noise).astype(np.float32)

    return Log(name, [Channel(key, "V", rate_hz, count) for key in signals], blocks)


def worst_error_s(found, duration_s: float) -> float:
    """Largest error of the clock within the log [s]."""
    ends = np.array([0.0, duration_s])
    return float(np.abs(found(ends) - (OFFSET_S + (1.0 + DRIFT) * ends)).max())


@pytest.mark.parametrize(
    ("rates", "channel"), [((FAST_HZ, SLOW_HZ), "U_setpoint"), ((SLOW_HZ, FAST_HZ), "PTM_4")]
)
def test_clocks_agree_to_half_a_sample(rates: tuple[float, float], channel: str) -> None:
    duration_s = 1200.0
    reference = logger("a", rates[0], duration_s, (0.0, 0.0), 1)
    other = logger("b", rates[1], duration_s - 60.0, (OFFSET_S, DRIFT), 2)
    found = align(reference, other, channel, pulses=channel == "PTM_4")
    error = worst_error_s(found, duration_s - 60.0)
    assert error < HALF_A_SAMPLE_S
    assert error < 6.0 * found.std_s + 1e-5, "and no further off than it says"


def test_samples_come_to_the_references_times() -> None:
    reference = logger("a", SLOW_HZ, 700.0, (0.0, 0.0), 1)
    other = logger("b", FAST_HZ, 640.0, (OFFSET_S, DRIFT), 2)
    both = merged(reference, [other], "U_setpoint")
    assert set(both.channels) == {*reference.channels, *(f"{name} (b)" for name in other.channels)}
    channel = both.channel("U_torque (b)")
    time = channel.start_s + np.arange(channel.samples) / channel.rate_hz
    difference = both.read("U_torque (b)") - set_point(time)
    assert np.std(difference) < 0.0045, "the noise of 4 mV and next to nothing else"
    (fault,) = both.faults
    assert (fault.kind, fault.channel) == ("drift", "U_setpoint (b)")
    assert "ppm taken off" in fault.method


def test_any_block_size_gives_the_same_samples() -> None:
    log = logger("b", 500.0, 20.0, (0.0, 0.0), 2)
    held = Log.from_arrays({name: log.read(name) for name in log.channels}, rate_hz=500.0)
    found = align(held, held, "PTM_4", pulses=True)
    assert abs(found.offset_s) < 1e-9
    moved = on_clock(held, type(found)(0.25, 3e-4, 0.0))
    whole = moved.read("PTM_4")
    parts = np.concatenate(list(moved.chunks("PTM_4", 777)))
    np.testing.assert_array_equal(whole, parts)


def test_signals_that_have_nothing_in_common_are_refused() -> None:
    noise = np.random.default_rng(0)
    one, other = (Log.from_arrays({"u": noise.normal(size=60_000)}, rate_hz=200.0) for _ in range(2))
    with pytest.raises(InputError, match="channel 'u' never varies as in memory"):
        align(one, other, "u")


def test_a_trial_of_two_loggers_gives_the_experiment_of_one(tmp_path: Path) -> None:
    tug = Vessel.load("stan-tug-1205")
    chirp = signals.chirp(0.1, 2.0, 40.0, 76.0, rate_hz=500.0)
    whole, truth = simulate_raw_log(tug, chirp, faults=(), steady_s=30.0, pause_s=10.0, seed=3)
    text = trial_toml("stan-tug-1205", "a.parquet", Sensors(), truth)
    text = re.sub(r"steady_s = \[.*?\]", "steady_s = [5.0, 30.0]", text, flags=re.DOTALL)
    (tmp_path / "TRIAL.toml").write_text(text)
    (one,) = process(whole, Trial.load(tmp_path / "TRIAL.toml"))

    held = {name: whole.read(name) for name in whole.channels}
    units = dict.fromkeys(held, "V")
    torque = held.pop("U_torque")
    Log.from_arrays(held, rate_hz=2000.0, units=units).write(tmp_path / "a.parquet")
    # The second logger started 1.5 s late and its clock is 100 ppm fast.
    place = 3000.0 + np.arange(len(torque) - 3100) * (1.0 - 1e-4)
    late = {
        name: np.interp(place, np.arange(len(torque)), values).astype(np.float32)
        for name, values in (("U_torque", torque), ("U_setpoint", held["U_setpoint"]))
    }
    Log.from_arrays(late, rate_hz=2000.0, units=units).write(tmp_path / "b.parquet")
    align = '\n[align]\nreference = "a.parquet"\ncommon = "U_setpoint"\n\n[channels.set_point]'
    text = text.replace('"a.parquet"', '["a.parquet", "b.parquet"]').replace("[channels.set_point]", align, 1)
    (tmp_path / "TRIAL.toml").write_text(text)
    trial = Trial.load(tmp_path / "TRIAL.toml")
    (log,) = trial.logs()
    (two,) = process(log, trial)
    difference = two.signals["M_g"] - one.signals["M_g"]
    assert np.nanstd(difference) < 0.01 * np.nanstd(one.signals["M_g"])
    (drift,) = [fault for fault in two.provenance["faults"] if fault["kind"] == "drift"]
    assert drift["channel"] == "U_setpoint (b.parquet)"


@pytest.mark.study
@pytest.mark.parametrize("channel", ["U_setpoint", "PTM_4"])
def test_study_of_eight_hours(channel: str) -> None:
    duration_s = 8 * 3600.0
    reference = logger("a", SLOW_HZ, duration_s, (0.0, 0.0), 1)
    other = logger("b", FAST_HZ, duration_s - 60.0, (OFFSET_S, DRIFT), 2)
    found = align(reference, other, channel, pulses=channel == "PTM_4")
    error = worst_error_s(found, duration_s - 60.0)
    print(
        f"\n{channel}: 2000 and 5000 Hz, 8 h, 100 ppm: offset {found.offset_s:.6f} s, drift {1e6 * found.drift:.4f} ppm, "
        f"clock off by {1e6 * error:.1f} us at worst ({error * SLOW_HZ:.3f} samples at 2000 Hz), "
        f"said {1e6 * found.std_s:.1f} us"
    )
    assert error < HALF_A_SAMPLE_S
