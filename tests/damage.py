"""Damage to files: bit flips, cuts, inserted and deleted blocks, swapped headers, reproducible from a seed."""

from __future__ import annotations

import os
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import LogWarning, ShipfpError
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.child_process import idle_process

Bytes = npt.NDArray[np.uint8]

KINDS = ("bits", "header", "cut", "insert", "delete", "zero", "ones", "swap", "foreign header", "repeat")


def damaged(whole: Bytes, kind: str, draw: np.random.Generator) -> Bytes:
    """A copy of a file's bytes with one kind of damage."""
    size = len(whole)
    start = int(draw.integers(size))
    length = int(min(2 ** draw.integers(0, 13), size - start))
    block = slice(start, start + length)
    copy = whole.copy()
    match kind:
        case "bits":
            places = draw.integers(0, size, draw.integers(1, 9))
            copy[places] ^= (1 << draw.integers(0, 8, len(places))).astype(np.uint8)
        case "header":  # where most of the structure is, at the end of some formats
            edge = min(size, 1500)
            places = draw.integers(0, edge, draw.integers(1, 9))
            places = places if draw.random() < 0.6 else size - 1 - places
            copy[places] = draw.choice(
                np.array([0, 1, 127, 128, 255, draw.integers(256)], np.uint8), len(places)
            )
        case "cut":
            copy = copy[:start]
        case "insert":
            copy = np.insert(copy, start, draw.integers(0, 256, length, dtype=np.uint8))
        case "delete":
            copy = np.delete(copy, block)
        case "zero":
            copy[block] = 0
        case "ones":
            copy[block] = 255
        case "swap":
            other = int(draw.integers(size - length + 1))
            copy[block], copy[other : other + length] = whole[other : other + length], whole[block]
        case "foreign header":
            heads = (
                b"PAR1",
                b"ARROW1\0\0",
                b"TDSm",
                b"MDF     4.10",
                b"\x89HDF\r\n\x1a\n",
                b"|CF,2,1,1;",
                b"a,b\n",
            )
            head = np.frombuffer(heads[draw.integers(len(heads))], np.uint8)[:size]
            copy[: len(head)] = head
        case "repeat":
            copy = np.insert(copy, start, whole[block])
    return copy


@dataclass
class Tally:
    """What became of the damaged copies of one file."""

    copies: Counter[str] = field(default_factory=Counter)
    """Tried, read, refused; of these crashed, where the reader's child process died, and hung."""
    slowest_s: float = 0.0
    worst_bytes: int = 0
    """Growth of the process that reads, above what it had before the file."""
    faults: Counter[str] = field(default_factory=Counter)
    """What must not be: other exceptions, messages of several lines or without the file's name."""

    def __str__(self) -> str:
        return (
            "{tried:6d} {read:6d} {refused:8d} {crashed:8d} {hung:5d} ".format_map(self.copies)
            + f"{self.slowest_s:8.2f} {self.worst_bytes / 1e6:9.0f} {sum(self.faults.values()):7d}"
        )

    HEADER = "files   read  refused  crashes hangs slowest/s memory/MB faults"


def try_damaged(whole: Path, folder: Path, count: int, seed: int = 1) -> Tally:
    """Open and read through `count` damaged copies of a file."""
    draw = np.random.default_rng(seed)
    content = np.fromfile(whole, np.uint8)
    target = folder / f"damaged{whole.suffix}"
    tally = Tally()
    # The package's own memory is not the file's: it is loaded by the time the first damaged copy comes.
    _read(whole)
    for index in range(count):
        damaged(content, KINDS[index % len(KINDS)], draw).tofile(target)
        process = idle_process() or os.getpid()
        before = start_peak(process)
        begin = time.monotonic()
        tally.copies["tried"] += 1
        try:
            _read(target)
            tally.copies["read"] += 1
        except ShipfpError as error:
            message = str(error)
            tally.copies["refused"] += 1
            tally.copies["crashed"] += " crashes on it " in message
            tally.copies["hung"] += "not read within" in message
            if "\n" in message or str(target) not in message:
                tally.faults[message] += 1
        except Exception as error:  # this is what is looked for
            tally.faults[f"{index}: {KINDS[index % len(KINDS)]}: {type(error).__name__}: {error}"] += 1
        tally.slowest_s = max(tally.slowest_s, time.monotonic() - begin)
        tally.worst_bytes = max(tally.worst_bytes, peak(process) - before)
    return tally


def _read(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        log = Log.open(path)
        for name in log.channels:
            for _ in log.chunks(name):
                pass


def start_peak(process: int) -> int:
    """Start a process's high-water mark anew and return its resident memory; 0 where the system can't."""
    try:
        Path(f"/proc/{process}/clear_refs").write_text("5")
    except OSError:
        return 0
    return status_bytes(process, "VmRSS")


def peak(process: int) -> int:
    return status_bytes(process, "VmHWM")


def status_bytes(process: int, key: str) -> int:
    """One of the kinds of memory of a process; 0 where the system does not tell."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(key)), 0)
