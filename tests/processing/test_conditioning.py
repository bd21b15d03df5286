"""Operating points, trends, delays and the low-pass, with answers known from the plant."""

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.processing.conditioning import LowPass, about_local_point, detrended
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.vessel.vessel import Vessel

TUG = Vessel.load("stan-tug-1205")
SINE = simulate(TUG, signals.sine_sequence([0.2], 8, 20.0, rate_hz=50.0))


def with_torque(experiment, torque):
    return replace(experiment, signals={**experiment.signals, "M_g": torque})


def test_a_local_point_takes_an_offset_of_the_torque_away():
    offset = with_torque(SINE, SINE.signals["M_g"] + 50.0)
    whole_periods = offset.window(20.0, 40.0)
    assert whole_periods.normalised("M_g").mean() == pytest.approx(50.0 / 1725.0, rel=0.02)
    local = about_local_point(whole_periods)
    assert local.normalised("M_g").mean() == pytest.approx(0.0, abs=1e-12)
    assert local.operating_point["M_g"] == pytest.approx(1775.0, rel=1e-3)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_drift_is_taken_off_and_the_level_stays(degree):
    time = np.linspace(-1.0, 1.0, len(SINE))
    drift = 30.0 * time**degree
    drifting = SINE.signals["M_g"] + drift
    drifting[200:300] = np.nan
    found = detrended(with_torque(SINE, drifting), degree).signals["M_g"]
    known = np.isfinite(drifting)
    assert np.array_equal(np.isfinite(found), known)
    expected = SINE.signals["M_g"] + drift[known].mean()
    # The first period is not yet the sine's own: the plant starts from rest.
    assert np.abs(found - expected)[known].max() < 0.02 * np.ptp(SINE.signals["M_g"])
    assert np.nanmean(found) == pytest.approx(np.nanmean(drifting), rel=1e-12)


def test_a_trend_of_the_set_point_is_no_drift():
    rising = simulate(TUG, signals.steps(np.full(8, 5.0), 5.0, rate_hz=50.0))
    with pytest.raises(InputError, match="the set point itself is a trend"):
        detrended(rising)
    with pytest.raises(InputError, match="degree: found 4"):
        detrended(SINE, 4)


@pytest.mark.parametrize("rate_hz", [2000.0, 1000.0, 500.0])
@pytest.mark.parametrize("late", [0.0, 0.00013, 0.0042])
def test_a_late_channel_of_any_rate_comes_out_in_time(rate_hz, late):
    def wave(time):
        return 5.0 + np.sin(2 * np.pi * 3.0 * time) + 0.5 * np.cos(2 * np.pi * 11.0 * time)

    # What the channel tells at a time happened `late` before.
    time = np.arange(round(40.0 * rate_hz)) / rate_hz
    log = Log.from_arrays({"late": wave(time - late)}, rate_hz=rate_hz)
    rows = Rows(log, "late", delay_s=late)
    start_s, count = 10.0, 1000
    start = (start_s - rows.channel.start_s) * rate_hz
    ours = LowPass(rows.channel, 50.0, start)(rows.read, count)
    np.testing.assert_allclose(ours, wave(start_s + np.arange(count) / 50.0), atol=3e-4)


@pytest.mark.parametrize(("rate_hz", "piece"), [(2000.0, 1 << 17), (2000.0, 9973), (125.0, 1000)])
def test_a_low_pass_is_the_convolution_with_its_taps_whatever_is_read_at_once(monkeypatch, rate_hz, piece):
    monkeypatch.setattr("shipfp_rs.processing.conditioning.PIECE", piece)
    samples = np.random.default_rng(5).normal(size=40_000)
    samples[7000:7003] = np.nan
    low_pass = LowPass(Channel("U", "V", rate_hz, len(samples)), 50.0, 0.0)
    ours = low_pass(lambda first, stop: samples[first:stop], 900)
    half = len(low_pass.taps)
    stuffed = np.zeros((len(samples) + 2 * half) * low_pass.up)
    filled = np.interp(
        np.arange(len(samples)), *(np.flatnonzero(np.isfinite(samples)), samples[np.isfinite(samples)])
    )
    stuffed[:: low_pass.up] = np.pad(filled, half, mode="edge")
    plain = (
        low_pass.up * np.convolve(stuffed, low_pass.taps, mode="same")[half * low_pass.up :: low_pass.down]
    )
    np.testing.assert_allclose(ours, plain[:900], atol=1e-12)


def test_nothing_above_half_the_common_rate_folds_back():
    time = np.arange(40_000) / 2000.0
    for frequency in (25.0, 26.0, 40.0, 49.0, 75.0, 999.0):
        channel = Channel("U", "V", 2000.0, len(time))
        samples = np.sin(2 * np.pi * frequency * time)
        out = LowPass(channel, 50.0, 10_000)(lambda first, stop, x=samples: x[first:stop], 500)
        assert np.abs(out).max() < 2e-4, frequency


def test_entrained_water_counts_on_the_propellers_side():
    full = Vessel.load("stan-tug-1205-full")
    smooth = {"propeller.shaft_ripple": 0.0, "propeller.blade_ripple": 0.0, "engine.firing": None}
    ship = full.replace({**smooth, "governor.once_a_firing": False, "shaft.stiffness_Nm_rad": None})
    experiment = simulate(ship, signals.chirp(0.1, 1.0, 20.0, 20.0, rate_hz=200.0))
    n_s = experiment.signals["n_s"]
    load = ship.torque_coefficient * n_s**ship.propeller.torque_exponent
    inertia = ship.propeller_side_inertia
    found = experiment.signals["M_g"] - 2.0 * np.pi * inertia * np.gradient(n_s, 1.0 / experiment.rate_hz)
    np.testing.assert_allclose(found[5:-5], load[5:-5], rtol=1e-3)
