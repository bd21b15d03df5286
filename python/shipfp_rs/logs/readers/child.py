"""Child process started by `child_process`: opens logs and sends their samples through a pipe."""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import re
import signal
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Samples
from shipfp_rs.logs.formats import one_line_errors
from shipfp_rs.logs.log import Log

SPARE_BYTES = 200_000_000
"""Memory that a reader may use [bytes], in addition to three times the file's size."""


def serve() -> None:
    """Answer requests until the parent closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # Output printed by a package must not mix with the answers.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    server = _Server()
    with contextlib.suppress(EOFError):
        while True:
            pickle.dump((server.answer(pickle.load(requests)), server.grown), answers)
            answers.flush()


class _Server:
    def __init__(self) -> None:
        self._path = ""
        self._log: Log | None = None
        self._streams: dict[int, Iterator[Samples]] = {}
        self._start_bytes: int | None = None
        self.grown = 0
        """Growth of this process's memory since its first file [bytes]."""

    def answer(self, request: dict[str, Any]) -> Any:
        """Return what was requested, or the `InputError` that explains why it is not available."""
        try:
            with one_line_errors(Path(request["open"][3] if "open" in request else self._path)):
                if "open" in request:
                    return self._open(*request["open"])
                return self._read(*request["read"], start=request["start"], drop=request["drop"])
        except InputError as error:
            told = "needs more memory than three times its size and 200 MB; is it damaged?"
            return InputError(f"{self._path}: {told}") if isinstance(error.__cause__, MemoryError) else error

    def _open(
        self,
        package: str,
        module: str,
        reader: str,
        path: str,
        rate_hz: float | None,
        options: dict[str, str],
    ) -> tuple[dict[str, Any], list[str]]:
        self._log, self._streams, self._path = None, {}, path
        _bound_memory(None)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                importlib.import_module(package)
                open_log = getattr(importlib.import_module(module), reader).__wrapped__
        except (ImportError, OSError) as error:
            raise InputError(
                f"{path}: the package {package} can't be loaded: {error}; install it again"
            ) from error
        used = _data_bytes()
        self._start_bytes = self._start_bytes or used
        self.grown = used - self._start_bytes
        _bound_memory(used + 3 * Path(path).stat().st_size + SPARE_BYTES)
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", LogWarning)
            try:
                log = self._log = open_log(Path(path), rate_hz, **options)
            except InputError as error:
                # Warnings about omitted content may explain the error.
                raise InputError("; ".join([str(error), *(str(note.message) for note in notes)])) from error
        facts = {
            "channels": [*log.channels.values()],
            "start_utc": log.start_utc,
            "faults": log.faults,
            "notes": log.notes,
        }
        return facts, [str(note.message) for note in notes]

    def _read(
        self, stream: int, name: str, first: int, size: int, *, start: bool, drop: list[int]
    ) -> Samples | None:
        for gone in drop:
            self._streams.pop(gone, None)
        if start and self._log is not None:
            self._streams[stream] = self._log.raw_blocks(name, first, size)
        if stream not in self._streams:
            raise InputError(f"{self._path}: was replaced while channel {name!r} was read; read it again")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            block = next(self._streams[stream], None)
        if block is None:
            return None
        block = block.astype(block.dtype.newbyteorder("="), copy=False)
        return block if np.ma.is_masked(block) else np.ma.getdata(block)


def _data_bytes() -> int:
    """Private writable memory of this process; 0 if the system does not report it."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0
    found = re.search(r"VmData:\s*(\d+) kB", status)
    return 1024 * int(found[1]) if found else 0


def _bound_memory(limit: int | None) -> None:
    """Make allocations fail above a limit, if the system can."""
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        soft = hard if limit is None else limit
        resource.setrlimit(resource.RLIMIT_DATA, (soft if hard < 0 else min(soft, hard), hard))
