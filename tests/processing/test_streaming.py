"""A log may be larger than memory: channels are read in pieces, and no process holds more than a few of them."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.logs.formats import TEXTS
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers import delimited
from shipfp_rs.logs.readers.child_process import end_idle, idle_process
from tests.damage import status_bytes
from tests.logger_files import NEEDS, WRITERS

SAMPLES = 3_000_000
PIECE = 50_000
# SciPy reads a variable of these versions whole; the log as a whole may still be larger than memory.
KINDS = [kind for kind in WRITERS if not kind.startswith("MATLAB 5")]


@pytest.mark.skipif(sys.platform != "linux", reason="memory of a process is told by /proc")
@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=() if index % 2 else pytest.mark.slow) for index, kind in enumerate(KINDS)],
)
def test_reading_through_a_channel_holds_a_fraction_of_it(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for start, package in NEEDS.items():
        if kind.startswith(start):
            pytest.importorskip(package)
    monkeypatch.setattr(delimited, "PART", 1 << 16)
    suffix, write = WRITERS[kind]
    noise = np.random.default_rng(1).standard_normal(SAMPLES // 30 if suffix in TEXTS else SAMPLES).round(6)
    samples = len(noise)
    end_idle()
    # What a package takes for itself, once, is not of the log.
    short, path = tmp_path / f"short{suffix}", tmp_path / f"log{suffix}"
    write(short, {"u": noise[:PIECE]})
    write(path, {"u": noise})
    assert sum(len(piece) for piece in Log.open(short).chunks("u", PIECE)) == min(PIECE, samples)
    del noise
    log = Log.open(path)
    child = idle_process()

    def held() -> int:
        return sum(status_bytes(process, "RssAnon") for process in (os.getpid(), child) if process)

    before, most, total = held(), 0, 0
    for piece in log.chunks("u", PIECE):
        total += len(piece)
        most = max(most, held() - before)
    assert total == samples
    # HDF5 alone keeps 8 MB of chunks, however long the channel.
    assert most < 16 * samples / 3, f"{most / 1e6:.1f} MB, of a channel of {8 * samples / 1e6:.1f} MB"
