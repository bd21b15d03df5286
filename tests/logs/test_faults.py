"""Faults are found where they are, to the sample, in chunks of any size, and what they touched isn't fitted."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from shipfp_rs.logs.faults import Fault, simulated
from shipfp_rs.logs.faults.chirp import constant_frequency
from shipfp_rs.logs.faults.extremes import TAPS, BlockExtremes, RepeatScan
from shipfp_rs.logs.faults.levels import MOST_BLOCK, HumScan, find_level_faults, hum_in
from shipfp_rs.logs.faults.scan import scan
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.support.arrays import apart_from, clipped_to, joined, marks, runs


def recurring(samples: np.ndarray, taps: int) -> set[tuple[int, int]]:
    """Return places and distances at which `taps` samples stand that stood before, whose first two differ."""
    words = np.lib.stride_tricks.sliding_window_view(samples.view(np.uint32), taps)
    first, later = np.nonzero(np.triu((words[:, None] == words[None]).all(axis=2), 1))
    changes = words[first, 0] != words[first, 1]
    return set(zip(first[changes].tolist(), (later - first)[changes].tolist(), strict=True))


RATE_HZ = 2000.0
SAMPLES = 40_000
TIME = np.arange(SAMPLES) / RATE_HZ


def torque(seed: int = 0) -> np.ndarray:
    """Volts of a torque: slow swing, firing ripple, noise."""
    noise = np.random.default_rng(seed).normal(0.0, 0.02, SAMPLES)
    return 1.6 + 0.2 * np.sin(2 * np.pi * 0.3 * TIME) + 0.05 * np.sin(2 * np.pi * 59.0 * TIME) + noise


def set_point(seed: int = 0) -> np.ndarray:
    return (
        -5.0 + 0.3 * np.sin(2 * np.pi * 1.5 * TIME) + np.random.default_rng(seed).normal(0.0, 0.004, SAMPLES)
    )


def found(samples: np.ndarray, **options: object) -> dict[str, list[list[int]]]:
    log = Log.from_arrays({"u": samples.astype(np.float32)}, rate_hz=RATE_HZ)
    return {kind: spans.tolist() for kind, spans in scan(Rows(log, "u"), 0, len(samples), **options).items()}  # type: ignore[arg-type]


def fed(scanner: BlockExtremes | HumScan | RepeatScan, samples: np.ndarray, cuts: Sequence[int]) -> None:
    for part in np.split(samples, sorted(cuts)):
        scanner.feed(part)


def test_a_sound_channel_has_no_fault() -> None:
    for seed in range(20):
        assert found(torque(seed), repeats=True) == {}
        assert found(set_point(seed), mains_hz=50.0, repeats=True) == {}


def test_a_channel_without_noise_may_rest() -> None:
    stairs = np.repeat([-5.0, -5.2, -5.0, -4.8], SAMPLES // 4)
    rest = np.where(TIME < 5.0, -5.0, -5.0 + 0.3 * np.sin(2 * np.pi * 0.5 * (TIME - 5.0)))
    assert found(stairs, mains_hz=50.0, repeats=True) == found(rest, mains_hz=50.0, repeats=True) == {}


@settings(max_examples=40)
@given(
    kind=st.sampled_from(simulated.LOSSES),
    start=st.integers(0, SAMPLES - 600),
    length=st.integers(520, 12_000),
    seed=st.integers(0, 99),
)
@example(kind="stuck", start=285, length=520, seed=50)  # begins and ends with small steps by chance
def test_a_loss_is_told_to_the_sample(kind: str, start: int, length: int, seed: int) -> None:
    stop = min(start + length, SAMPLES)
    spans = found(simulated.lose(torque(seed), kind, [(start, stop)]))
    assert list(spans) == [kind]
    ((first, last),) = spans[kind]
    assert last == stop
    # The value that a stuck channel holds is the last sound one.
    assert first == (start - 1 if kind == "stuck" and start else start)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_missing(value: float) -> None:
    samples = torque()
    samples[[7, 8, 9_000, SAMPLES - 1]] = value
    assert found(samples) == {"gap": [[7, 9], [9_000, 9_001], [SAMPLES - 1, SAMPLES]]}


@pytest.mark.parametrize("share", [0.002, 0.02, 0.2])
def test_every_clipped_sample_is_told(share: float) -> None:
    cut, spans = simulated.clip(torque(), share)
    top = found(cut)
    assert marks(np.array(top["clipped"]), 0, SAMPLES)[marks(spans, 0, SAMPLES)].all()
    assert list(top) == ["clipped"]
    assert found(-cut) == top, "the same at the bottom"


def test_short_spikes_at_the_receivers_limit_are_not_clipping() -> None:
    samples = torque()
    samples[8_000:8_060] = 5.0
    assert found(samples) == {}
    samples[8_000:8_400] = 5.0
    assert found(samples) == {"clipped": [[8_000, 8_400]]}


@pytest.mark.parametrize(("start", "stop"), [(0, SAMPLES), (8_000, 22_000), (30_000, SAMPLES)])
def test_hum_is_told_and_taken_out(start: int, stop: int) -> None:
    clean = set_point()
    humming = simulated.hum(clean, RATE_HZ, 50.0, 0.05, start, stop)
    ((first, last),) = found(humming, mains_hz=50.0)["D2"]
    assert abs(first - start) <= 400
    assert abs(last - stop) <= 400, "to a block of ten cycles"
    quiet = humming - hum_in(humming, 0, np.array([[first, last]]), RATE_HZ)
    inner = slice(max(start, first) + 600, min(stop, last) - 600)
    assert np.std(quiet[inner] - clean[inner]) < 0.05 / 50.0
    outside = np.r_[0:first, last:SAMPLES]
    np.testing.assert_array_equal(quiet[outside], humming[outside])


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0, 115.0, 130.0])
def test_breakage_c3_the_level_of_a_slow_log_is_no_hum(rate_hz: float) -> None:
    time = np.arange(round(60.0 * rate_hz)) / rate_hz
    speed = 1184.0 + 40.0 * np.sin(2.0 * np.pi * 0.1 * time)
    rows = Rows(Log.from_arrays({"n_set": speed}, rate_hz=rate_hz), "n_set")
    assert scan(rows, 0, len(time), mains_hz=50.0) == {}


def test_steps_and_jumps_are_no_hum() -> None:
    samples = set_point() + np.where(TIME > 8.0, 1.0, 0.0)
    samples[12_000:12_040] += 2.0
    assert found(samples, mains_hz=50.0) == {}


@settings(max_examples=60)
@given(
    seed=st.integers(0, 1000),
    rest=st.integers(0, 60),
    levels=st.sampled_from([2, 5, 4000]),
    start=st.integers(0, 300),
    count=st.integers(130, 300),
)
def test_prints_recur_only_where_samples_do(
    seed: int, rest: int, levels: int, start: int, count: int
) -> None:
    rounded = np.random.default_rng(seed).integers(0, levels, 600) * 0.25
    rounded[:rest] = rounded[0]
    samples = simulated.write_twice({"u": rounded}, start, count, over=False)["u"].astype(np.float32)
    scanner = RepeatScan()
    scanner.feed(samples)
    candidates = {tuple(pair) for pair in scanner.candidates().tolist()}
    assert candidates <= recurring(samples, TAPS)
    if levels > 5 and count > 250:
        assert {lag for _, lag in candidates} == {count}


@settings(max_examples=15)
@given(start=st.integers(0, 20_000), count=st.integers(300, 5_000), over=st.booleans())
def test_rows_recorded_twice_are_told_to_the_sample(start: int, count: int, over: bool) -> None:
    rows = simulated.write_twice({"u": set_point(1), "w": torque(2)}, start, count, over=over)
    log = Log.from_arrays({name: x.astype(np.float32) for name, x in rows.items()}, rate_hz=RATE_HZ)
    ((first, last),) = scan(Rows(log, "u"), 0, len(rows["u"]), repeats=True)["repeated"].tolist()
    assert (first, last) == (start + count, start + 2 * count)


def test_a_set_point_in_steps_that_recurs_by_design_is_no_row_written_twice() -> None:
    speed = 1200.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(3_000) / 3_000.0)
    steps = np.round(np.tile(speed, 3)[:5_500] / 0.125) * 0.125
    told = Log.from_arrays({"u": steps.astype(np.float32)}, rate_hz=RATE_HZ)
    assert "repeated" not in scan(Rows(told, "u"), 0, len(steps), repeats=True)


def test_a_channel_that_repeats_alone_is_no_row_written_twice() -> None:
    noise = np.tile(set_point()[:5_000], 8)
    log = Log.from_arrays({"u": noise, "w": torque()}, rate_hz=RATE_HZ)
    assert "repeated" not in scan(Rows(log, "u"), 0, SAMPLES, repeats=True)


@settings(max_examples=30)
@given(cuts=st.lists(st.integers(0, SAMPLES), max_size=12))
def test_chunks_make_no_difference(cuts: list[int]) -> None:
    samples = simulated.hum(set_point(), RATE_HZ, 50.0, 0.05, 9_000, 15_000).astype(np.float32)
    samples[20_000:20_700] = np.nan
    samples[25_000:26_000] = samples[25_000]
    whole, parts = BlockExtremes(MOST_BLOCK), BlockExtremes(MOST_BLOCK)
    fed(whole, samples, []), fed(parts, samples, cuts)
    told = [find_level_faults(scanner, lambda a, b: samples[a:b], RATE_HZ) for scanner in (whole, parts)]
    assert {k: v.tolist() for k, v in told[0].items()} == {k: v.tolist() for k, v in told[1].items()}
    hum_whole, hum_parts = HumScan(RATE_HZ), HumScan(RATE_HZ)
    fed(hum_whole, samples, []), fed(hum_parts, samples, cuts)
    assert hum_whole.spans(0.01).tolist() == hum_parts.spans(0.01).tolist()
    prints_whole, prints_parts = RepeatScan(), RepeatScan()
    twice = simulated.write_twice({"u": samples[:20_000]}, 4_000, 900, over=False)["u"]
    fed(prints_whole, twice, []), fed(prints_parts, twice, [cut for cut in cuts if cut < len(twice)])
    assert prints_whole.candidates().tolist() == prints_parts.candidates().tolist()


def test_integers_are_looked_at_as_they_are() -> None:
    counts = np.round(torque() * 1000.0).astype(np.int16)
    assert scan(Rows(Log.from_arrays({"u": counts}, rate_hz=RATE_HZ), "u"), 0, SAMPLES) == {}
    counts[5_000:9_000] = counts[4_999]
    stuck = scan(Rows(Log.from_arrays({"u": counts}, rate_hz=RATE_HZ), "u"), 0, SAMPLES)
    assert {kind: spans.tolist() for kind, spans in stuck.items()} == {"stuck": [[4_999, 9_000]]}


@pytest.mark.parametrize("noise", [0.0, 3.0])
@pytest.mark.parametrize("cycles", [0.3, 1.0, 4.0, 40.0])
def test_a_chirp_that_keeps_its_frequency_is_told(cycles: float, noise: float) -> None:
    time = np.arange(0.0, 500.0, 0.02)
    sine = 1184.0 + 76.0 * np.sin(2 * np.pi * cycles / 500.0 * time)
    told = constant_frequency(sine + np.random.default_rng(1).normal(0.0, noise, time.size), 50.0)
    assert told == pytest.approx(cycles / 500.0, rel=0.2) if cycles >= 4.0 else told is not None


@pytest.mark.parametrize(("low", "high"), [(0.001, 0.02), (0.015, 0.27), (0.1, 3.981), (3.981, 0.1)])
def test_the_trials_chirps_change_their_frequency(low: float, high: float) -> None:
    time = np.arange(0.0, 500.0, 0.02)
    rate = np.log(high / low) / 500.0
    chirp = 76.0 * np.sin(2 * np.pi * low / rate * np.expm1(rate * time))
    assert constant_frequency(chirp + np.random.default_rng(1).normal(0.0, 2.0, time.size), 50.0) is None


def test_spans_join_part_and_mark() -> None:
    spans = joined([np.array([[5, 9], [0, 2]]), np.array([[2, 3], [8, 12], [20, 21]])])
    assert spans.tolist() == [[0, 3], [5, 12], [20, 21]]
    assert apart_from(spans, np.array([[3, 5], [11, 15]])).tolist() == [[0, 3], [20, 21]]
    assert clipped_to(spans, 2, 6).tolist() == [[2, 3], [5, 6]]
    assert runs(marks(spans, 0, 30)).tolist() == spans.tolist()


def test_a_record_tells_everything_as_json() -> None:
    fault = Fault("stuck", "U_torque", "masked", np.array([[3, 9], [20, 40]]))
    assert fault.to_dict() == {
        "kind": "stuck",
        "channel": "U_torque",
        "method": "masked",
        "excluded": True,
        "count": 2,
        "spans": [[3, 9], [20, 40]],
    }
    with pytest.raises(ValueError, match="kind 'odd', expected one of A, B"):
        Fault("odd", "u", "", np.empty((0, 2)))
