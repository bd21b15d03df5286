"""Excitations: what each is made for, and arguments out of range."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import published, signals
from shipfp_rs.errors import InputError
from shipfp_rs.signals import Excitation


def test_published_sequence_follows_table_5_1() -> None:
    sequence = signals.published_sine_sequence()
    assert sequence.duration == pytest.approx(2542.2)
    assert sequence.amplitude_rpm == pytest.approx(13.0, rel=1e-6)
    assert signals.sine_sequence([1.0], 5, 13.0).crest_factor == pytest.approx(math.sqrt(2.0), rel=1e-12)
    for segment, row in zip(sequence.segments, published.virtual_schedule(), strict=True):
        assert (segment.start_s, segment.stop_s) == pytest.approx((row.begin_s, row.end_s))
        assert segment.frequency_hz == pytest.approx(row.frequency_hz, rel=0.01)


def test_sine_sequence_holds_each_frequency_for_its_periods_and_never_jumps() -> None:
    sequence = signals.sine_sequence([0.5, 2.0, 0.8], 3, 10.0, rate_hz=200.0)
    steepest = 2 * math.pi * 2.0 * 10.0 / 200.0
    assert np.abs(np.diff(sequence.samples)).max() <= steepest
    for segment in sequence.segments:
        assert (segment.stop_s - segment.start_s) * segment.frequency_hz == pytest.approx(3.0)
        time = sequence.time[(sequence.time >= segment.start_s) & (sequence.time < segment.stop_s)]
        inside = sequence.samples[(sequence.time >= segment.start_s) & (sequence.time < segment.stop_s)]
        expected = 10.0 * np.sin(2 * np.pi * segment.frequency_hz * (time - segment.start_s))
        np.testing.assert_allclose(inside, expected, atol=1e-9)


def test_multisine_holds_its_frequencies_equally_and_nothing_else() -> None:
    wanted = np.array([0.1, 0.2, 0.5, 1.1, 2.0])
    excitation = signals.multisine(wanted, 10.0, 13.0)
    frequency, amplitude = excitation.spectrum()
    present = amplitude > 1e-9
    np.testing.assert_allclose(frequency[present], wanted)
    np.testing.assert_allclose(amplitude[present], amplitude[present][0], rtol=1e-9)
    assert excitation.amplitude_rpm == pytest.approx(13.0)


def test_multisine_moves_frequencies_to_whole_periods_and_repeats() -> None:
    excitation = signals.multisine([0.12, 0.33], 10.0, 13.0, periods=3)
    frequency, amplitude = excitation.spectrum()
    np.testing.assert_allclose(frequency[amplitude > 1e-9], [0.1, 0.3])
    np.testing.assert_array_equal(excitation.samples[:1000], excitation.samples[2000:])
    assert [segment.start_s for segment in excitation.segments] == [0.0, 10.0, 20.0]


def test_multisine_phases_keep_the_crest_factor_low() -> None:
    lines = np.arange(1, 31) / 100.0
    in_phase = np.cos(2 * np.pi * lines[:, None] * np.arange(10_000) / 100.0).sum(axis=0)
    start = signals.multisine(lines, 100.0, 13.0, iterations=0)
    clipped = signals.multisine(lines, 100.0, 13.0)
    assert np.abs(in_phase).max() / in_phase.std() > 7.0
    # Schroeder's phases come near 1.7; clipping below 1.5.
    assert start.crest_factor < 1.8
    assert clipped.crest_factor < 1.55


def test_steps_stand_upon_each_other() -> None:
    excitation = signals.steps([65.0, 65.0, -30.0], 20.0, lead_s=5.0)
    assert excitation.hold == "zero"
    assert excitation.samples[[0, 499, 500, 2499, 2500, 4500]].tolist() == [
        0.0,
        0.0,
        65.0,
        65.0,
        130.0,
        100.0,
    ]
    assert excitation.duration == pytest.approx(65.0)


def test_prbs_is_white_over_its_period() -> None:
    excitation = signals.prbs(7, 0.1, 10.0, periods=2, seed=3)
    bits = excitation.samples[: 127 * 10 : 10] / 10.0
    assert set(bits) == {-1.0, 1.0}
    correlation = [int(np.dot(bits, np.roll(bits, shift))) for shift in range(127)]
    assert correlation == [127] + [-1] * 126  # the defining property of a maximum-length sequence
    assert not np.array_equal(excitation.samples, signals.prbs(7, 0.1, 10.0, periods=2, seed=4).samples)


def test_noise_keeps_to_its_band_and_seed() -> None:
    excitation = signals.band_limited_noise(0.5, 2.0, 100.0, 10.0, seed=1)
    frequency, amplitude = excitation.spectrum()
    outside = (frequency < 0.5) | (frequency > 2.0)
    assert amplitude[outside].max() < 1e-9
    assert (amplitude[~outside] > 0).all()
    assert np.sqrt(np.mean(excitation.samples**2)) == pytest.approx(10.0)
    again = signals.band_limited_noise(0.5, 2.0, 100.0, 10.0, seed=1)
    np.testing.assert_array_equal(excitation.samples, again.samples)
    assert not np.array_equal(
        excitation.samples, signals.band_limited_noise(0.5, 2.0, 100.0, 10.0, seed=2).samples
    )


def test_join_puts_parts_in_order_with_pauses_between() -> None:
    sines = signals.sine_sequence([1.0, 2.0], 2, 5.0)
    chirp = signals.chirp(0.5, 2.0, 4.0, 5.0)
    joined = signals.join([sines, chirp], pause_s=1.5)
    assert joined.duration == pytest.approx(3.0 + 1.5 + 4.0)
    np.testing.assert_array_equal(joined.samples[300:450], 0.0)
    np.testing.assert_array_equal(joined.samples[450:], chirp.samples)
    assert [(s.label, s.start_s, s.stop_s) for s in joined.segments] == [
        ("1 Hz", 0.0, 2.0),
        ("2 Hz", 2.0, 3.0),
        ("chirp", 4.5, 8.5),
    ]


def test_a_signal_generator_can_read_the_table(tmp_path: Path) -> None:
    excitation = signals.chirp(0.5, 2.0, 4.0, 5.0)
    path = excitation.to_csv(tmp_path / "chirp.csv")
    assert path.read_text().splitlines()[0] == "time_s,set_point_deviation_rpm"
    time, samples = np.loadtxt(path, delimiter=",", skiprows=1).T
    np.testing.assert_array_equal(samples, excitation.samples)
    np.testing.assert_array_equal(time, excitation.time)


def test_samples_cannot_be_changed_behind_the_excitations_back() -> None:
    mine = np.array([1.0, 2.0])
    excitation = Excitation("mine", "own", 1.0, mine)
    mine[0] = 5.0
    assert excitation.samples[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        excitation.samples[0] = 5.0


@settings(max_examples=30)
@given(
    lines=st.lists(st.integers(1, 200), min_size=1, max_size=20, unique=True),
    amplitude=st.floats(0.1, 500.0),
)
def test_any_multisine_is_as_large_as_asked_and_has_no_mean(lines: list[int], amplitude: float) -> None:
    excitation = signals.multisine([line / 10.0 for line in lines], 10.0, amplitude, iterations=5)
    assert excitation.amplitude_rpm == pytest.approx(amplitude)
    assert abs(excitation.samples.mean()) < 1e-12 * amplitude
    assert excitation.crest_factor >= 1.0


REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "no frequency": (lambda: signals.sine_sequence([], 4, 13.0), r"frequencies_hz is \[\], expected a list"),
    "part of a period": (
        lambda: signals.sine_sequence([1.0], 1.5, 13.0),
        "periods is 1.5, expected a whole number",
    ),
    "too fast": (
        lambda: signals.sine_sequence([1.0, 60.0], 4, 13.0),
        r"frequencies_hz\[1\] is 60 Hz, expected less than half of rate_hz 100",
    ),
    "no amplitude": (
        lambda: signals.chirp(0.1, 1.0, 10.0, 0.0),
        "amplitude_rpm is 0.0, expected a positive number",
    ),
    "backwards in time": (
        lambda: signals.chirp(0.1, 1.0, -10.0, 1.0),
        "duration is -10.0, expected a positive",
    ),
    "unknown law": (
        lambda: signals.chirp(0.1, 1.0, 10.0, 1.0, "cubic"),
        "law is 'cubic', expected 'linear' or 'logarithmic'",
    ),  # type: ignore[arg-type]
    "too long": (lambda: signals.chirp(0.1, 1.0, 1e9, 1.0), r"are 1e\+11 samples, expected 1 to"),
    "odd period": (
        lambda: signals.multisine([0.1], 10.005, 1.0),
        "1000.5 samples, expected a whole number of samples",
    ),
    "two on one line": (
        lambda: signals.multisine([0.1, 0.11], 10.0, 1.0),
        r"frequencies_hz\[1\] is 0.11, nearest multiple 0.1",
    ),
    "no steps": (lambda: signals.steps([], 1.0), "sizes_rpm is"),
    "step to nowhere": (lambda: signals.steps([math.nan], 1.0), "sizes_rpm is"),
    "long register": (lambda: signals.prbs(40, 0.1, 1.0), "order is 40, expected 2 to 20"),
    "part of a sample": (lambda: signals.prbs(4, 0.015, 1.0), "1.5 samples, expected a whole number"),
    "empty band": (
        lambda: signals.band_limited_noise(0.51, 0.52, 10.0, 1.0, seed=0),
        "holds no multiple of 1/duration_s",
    ),
    "different rates": (
        lambda: signals.join([signals.steps([1.0], 1.0), signals.steps([1.0], 1.0, rate_hz=10.0)]),
        "'steps' has 10 Hz and hold 'zero', expected 100 Hz",
    ),
    "nothing to join": (lambda: signals.join([]), "excitations is empty"),
    "infinite sample": (
        lambda: Excitation("x", "own", 1.0, np.array([0.0, np.inf])),
        "sample 1 is inf, expected finite",
    ),
    "one sample": (
        lambda: Excitation("x", "own", 1.0, np.array([0.0])),
        r"shape \(1,\), expected \(N,\), N >= 2",
    ),
}


@pytest.mark.parametrize(("build", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_arguments_out_of_range_are_named(build: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        build()


@pytest.mark.parametrize("law", ["linear", "logarithmic"])
@pytest.mark.parametrize("ends", [(0.1, 10.0), (10.0, 0.1)])
def test_a_chirp_jumps_over_the_bands_it_must_leave_out(law: signals.Law, ends: tuple[float, float]) -> None:
    plain = signals.chirp(*ends, 400.0, 13.0, law=law)
    careful = signals.chirp(*ends, 400.0, 13.0, law=law, avoid_hz=[(4.5, 6.0)])
    # What is left of the band is the leakage of a sweep that stops at its edge.
    assert plain.power_in(4.8, 5.7) > 0.02
    assert careful.power_in(4.8, 5.7) < 1e-3
    assert np.abs(np.diff(careful.samples)).max() <= 13.0 * 2 * np.pi * 10.0 / 100.0
    assert careful.duration == plain.duration


@pytest.mark.parametrize("law", ["linear", "logarithmic"])
def test_a_chirp_without_bands_is_the_textbook_chirp(law: signals.Law) -> None:
    from scipy.signal import chirp

    ours = signals.chirp(0.0014, 20.0, 100.0, 1.0, law)
    theirs = chirp(ours.time, 0.0014, 100.0, 20.0, method=law, phi=-90.0)
    np.testing.assert_allclose(ours.samples, theirs, atol=1e-9)


def test_sines_multisine_and_noise_leave_bands_out() -> None:
    avoid = [(0.9, 1.1)]
    assert [
        s.frequency_hz for s in signals.sine_sequence([0.5, 1.0, 2.0], 4, 13.0, avoid_hz=avoid).segments
    ] == [0.5, 2.0]
    assert signals.multisine([0.5, 1.0, 2.0], 10.0, 13.0, avoid_hz=avoid).power_in(0.9, 1.1) < 1e-20
    assert signals.band_limited_noise(0.1, 4.0, 60.0, 5.0, seed=1, avoid_hz=avoid).power_in(0.9, 1.1) < 1e-20
    with pytest.raises(InputError, match="every frequency lies in a band of avoid_hz"):
        signals.sine_sequence([1.0], 4, 13.0, avoid_hz=avoid)
    with pytest.raises(InputError, match=r"avoid_hz\[0\] is \(2.0, 1.0\), expected"):
        signals.chirp(0.1, 4.0, 10.0, 13.0, avoid_hz=[(2.0, 1.0)])
    with pytest.raises(InputError, match=r"cover all of 0\.5 to 2 Hz"):
        signals.chirp(0.5, 2.0, 10.0, 13.0, avoid_hz=[(0.1, 3.0)])


def test_a_ramp_starts_and_ends_at_zero_and_leaves_the_middle_alone() -> None:
    steps = signals.steps([65.0], 10.0)
    ramped = steps.ramped(2.0)
    assert ramped.samples[0] == 0.0
    assert ramped.samples[-1] == pytest.approx(0.0, abs=0.1)
    np.testing.assert_array_equal(ramped.samples[200:800], steps.samples[200:800])
    with pytest.raises(InputError, match="ramp_s is 6, two ramps expected within the 10 s"):
        steps.ramped(6.0)


def test_settling_holds_the_operating_point_and_moves_the_segments() -> None:
    sines = signals.sine_sequence([1.0, 2.0], 4, 13.0)
    settled = sines.settled(3.0, 2.0)
    assert settled.duration == pytest.approx(sines.duration + 5.0)
    assert not settled.samples[:300].any()
    assert settled.segments[0].start_s == pytest.approx(3.0)


def test_the_spectrum_shows_the_amplitude_of_a_sine() -> None:
    frequency, amplitude = signals.sine_sequence([2.0], 20, 13.0).spectrum()
    assert frequency[np.argmax(amplitude)] == pytest.approx(2.0)
    assert amplitude.max() == pytest.approx(13.0)
