"""The overview kept beside a log: no spike is lost at any zoom, and it belongs to one state of the log."""

import os
import stat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shipfp_rs.logs.log import Log
from shipfp_rs.view import pyramid
from shipfp_rs.view.results import FINER, HEAD, TILE, Series, packed

RATE_HZ = 2000.0
SAMPLES = 1_000_003
SPIKES = 1000
VALUES = st.floats(-5, 5, width=32) | st.sampled_from([0.0, np.nan, np.inf, -np.inf])


def plain_extremes(samples: np.ndarray, block: int) -> np.ndarray:
    """Least and greatest finite sample of every block, shape (K, 2); NaN where there is none."""
    found = np.full((-(-len(samples) // block), 2), np.nan)
    for k in range(len(found)):
        part = samples[k * block : (k + 1) * block].astype(np.float64)
        part = part[np.isfinite(part)]
        if part.size:
            found[k] = part.min(), part.max()
    return found


def plain_gaps(samples: np.ndarray) -> np.ndarray:
    """First sample and the one after the last of every stretch that is not finite, shape (G, 2)."""
    missing = np.concatenate([[0], ~np.isfinite(samples.astype(np.float64)), [0]]).astype(int)
    return np.flatnonzero(np.diff(missing)).reshape(-1, 2)


@settings(max_examples=80, deadline=None)
@given(
    samples=arrays(np.float64, st.integers(0, 400), elements=VALUES),
    chunk=st.integers(1, 150),
    kind=st.sampled_from([np.float32, np.float64, np.int16, np.int64]),
)
def test_any_chunks_give_the_extremes_of_every_block_and_the_gaps(samples, chunk, kind):
    if np.issubdtype(kind, np.integer):
        samples = np.nan_to_num(samples, posinf=9, neginf=-9)
    samples = samples.astype(kind)
    blocks = pyramid.Extremes()
    parts = [blocks.feed(samples[k : k + chunk]) for k in range(0, len(samples), chunk)]
    found = np.concatenate([np.empty((0, 2)), *parts, blocks.finish()])
    np.testing.assert_array_equal(found, plain_extremes(samples, 64))
    np.testing.assert_array_equal(blocks.gaps, plain_gaps(samples))
    assert (blocks.seen, blocks.gap_count) == (len(samples), len(plain_gaps(samples)))


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, st.integers(0, 300), elements=VALUES), st.integers(1, 20))
def test_a_coarser_level_is_that_of_larger_blocks(samples, block):
    fine = pyramid.extremes(samples, block)
    np.testing.assert_array_equal(fine, plain_extremes(samples, block))
    np.testing.assert_array_equal(pyramid.coarser(fine), plain_extremes(samples, block * 4))


def test_a_channel_of_holes_keeps_the_first_ones_and_counts_all():
    samples = np.zeros(50_000, dtype=np.float32)
    samples[::2] = np.nan
    blocks = pyramid.Extremes()
    blocks.feed(samples)
    assert blocks.gap_count == 25_000
    assert 1000 < len(blocks.gaps) < 10_000


def write_log(folder: Path, kind=np.float32, seed: int = 0) -> tuple[Path, np.ndarray, np.ndarray]:
    """A noisy channel with spikes of one sample at random places, up and down, and a gap."""
    random = np.random.default_rng(seed)
    samples = random.normal(0.0, 1.0, SAMPLES)
    places = random.choice(SAMPLES, SPIKES, replace=False)
    samples[400_000:400_500] = np.nan
    samples[places] = random.uniform(50.0, 60.0, SPIKES) * random.choice([-1.0, 1.0], SPIKES)
    samples = samples.astype(kind)
    log = Log.from_arrays({"torque": samples, "ramp": np.arange(SAMPLES, dtype=np.int32)}, rate_hz=RATE_HZ)
    return log.write(folder / "log.parquet"), samples, places


def unpacked(tile: bytes) -> np.ndarray:
    """What the page makes of a tile: least and greatest of its blocks."""
    head = np.frombuffer(tile[: HEAD.itemsize], dtype=HEAD)[0]
    values = np.frombuffer(tile[HEAD.itemsize :], dtype="<f4").reshape(head["count"], head["columns"])
    return head["offset"] + values.astype(np.float64)[:, [0, -1]]


def series_of(path: Path) -> list[Series]:
    log = Log.open(path)
    return [Series.of_channel(one, lambda: log) for one in pyramid.made(log, path).channels]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_every_spike_of_a_thousand_is_in_its_tile_at_every_zoom(tmp_path, kind):
    path, samples, places = write_log(tmp_path, kind)
    torque = series_of(path)[0]
    assert torque.depth == FINER + 4
    for level in range(torque.depth):
        block = 4**level
        wanted = np.unique(places // block // TILE)
        tiles = {index: unpacked(torque.tile(level, int(index))) for index in wanted}
        for place in places:
            low, high = tiles[place // block // TILE][place // block % TILE]
            assert low <= samples[place] + 1e-5
            assert samples[place] <= high + 1e-5, f"hidden at {block} samples a block"


def test_every_level_is_that_of_the_samples_themselves(tmp_path):
    path, samples, _ = write_log(tmp_path, np.float64)
    torque = series_of(path)[0]
    for level in (1, 2, 3, 4, 6):
        np.testing.assert_array_equal(torque.blocks(level, 0, SAMPLES), plain_extremes(samples, 4**level))
    np.testing.assert_array_equal(torque.blocks(0, 0, SAMPLES)[:, 0], samples)
    np.testing.assert_array_equal(torque.gaps, plain_gaps(samples))


def test_a_signal_that_changes_little_about_much_keeps_its_digits():
    blocks = 1.7e9 + np.array([[0.0, 0.001], [0.25, 0.5]])
    found = unpacked(packed(blocks))
    np.testing.assert_allclose(found - 1.7e9, blocks - 1.7e9, atol=1e-6)


def test_what_single_precision_can_not_hold_is_not_hidden():
    found = unpacked(packed(np.array([[0.0, 1e300], [np.nan, np.nan]])))
    assert found[0, 1] > 1e38
    assert np.isnan(found[1]).all()


def test_it_stands_beside_the_log_and_opens_without_reading_it(tmp_path, monkeypatch):
    path, _, _ = write_log(tmp_path)
    made = pyramid.made(Log.open(path), path)
    assert made.path == tmp_path / "log.parquet.shipfp-pyramid"
    monkeypatch.setattr(Log, "open", None)
    found = pyramid.stored(path)
    for before, after in zip(made.channels, found.channels, strict=True):
        assert before.channel == after.channel
        for one, other in zip(before.levels, after.levels, strict=True):
            np.testing.assert_array_equal(one, other)


def test_another_state_of_the_log_has_another_one(tmp_path):
    path, _, _ = write_log(tmp_path)
    pyramid.made(Log.open(path), path)
    assert pyramid.stored(path, rate_hz=10.0) is None
    before = path.stat()
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns + 1))
    assert pyramid.stored(path) is None


@pytest.mark.parametrize("keep", [0, 7, 100, -1, -20])
def test_a_damaged_one_is_made_anew(tmp_path, keep):
    path, _, _ = write_log(tmp_path)
    place = pyramid.made(Log.open(path), path).path
    place.write_bytes(place.read_bytes()[:keep])
    assert pyramid.stored(path) is None
    assert pyramid.made(Log.open(path), path).path == place


def test_in_a_folder_that_can_not_be_written_it_goes_to_the_cache(tmp_path, monkeypatch):
    folder = tmp_path / "trial"
    folder.mkdir()
    path, _, _ = write_log(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    beside = next(pyramid.places(path))
    really = pyramid._appearing

    def read_only(place):
        if place == beside:
            raise PermissionError(13, "Permission denied")
        return really(place)

    monkeypatch.setattr(pyramid, "_appearing", read_only)
    made = pyramid.made(Log.open(path), path)
    assert made.path.parent == tmp_path / "cache" / "shipfp"
    assert pyramid.stored(path).path == made.path
    assert [entry.name for entry in folder.iterdir()] == ["log.parquet"]


def test_a_failed_reading_leaves_nothing(tmp_path):
    path, _, _ = write_log(tmp_path)
    log = Log.open(path)

    def broken(*_):
        raise OSError(28, "No space left on device")
        yield

    log._blocks = broken
    with pytest.raises(ValueError, match="can't be written"):
        pyramid.made(log, path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["log.parquet"]


def test_it_can_be_read_by_whoever_can_read_the_users_files(tmp_path):
    path, _, _ = write_log(tmp_path)
    mask = os.umask(0o022)
    os.umask(mask)
    mode = stat.S_IMODE(pyramid.made(Log.open(path), path).path.stat().st_mode)
    assert mode == 0o666 & ~mask
