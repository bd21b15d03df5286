"""Small sweeps for the tests: cheap draws, a table to compare, and what a sweep's folder holds."""

from __future__ import annotations

import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import tomlkit

from shipfp_rs.support.toml import validated
from shipfp_rs.sweeps import Plan

DEADLY = 3

KNOWN = {"g": -0.583, "p": 2.0, "vK_i": 1.583}
"""What is taken as known, so that a draw takes a seventh of the time."""
CHEAP: dict[str, Any] = {
    "excitation": {"kind": "chirp", "duration_s": 10.0, "start_hz": 0.2, "rate_hz": 20.0, "amplitude_rpm": 40.0},
    "noise": {"n_e": 0.001, "M_b": 0.005},
    "identify": {"noise": "white", "fixed": KNOWN},
    "factors": {"noise.level": {"low": 0.5, "high": 2.0}},
}  # fmt: skip


def sweep_toml(**changes: Any) -> str:
    """Return the SWEEP.toml of cheap draws, some tables changed or added."""
    return tomlkit.dumps(CHEAP | changes)


def cheap_plan(
    draws: int, *, sweep: dict[str, Any] | None = None, kind: type[Plan] = Plan, **tables: Any
) -> Plan:
    """Return a plan of draws that take a tenth of a second each, with other tables where given."""
    header = {"vessel": "stan-launch-804", "draws": draws, **(sweep or {})}
    return validated({**CHEAP, **tables, "sweep": header}, kind, "SWEEP.toml").checked("SWEEP.toml")


def rows(folder: Path) -> list[dict[str, Any]]:
    """Return the table of a sweep's folder, a dictionary a draw."""
    return pq.read_table(folder / "results.parquet").to_pylist()


def results(folder: Path) -> bytes:
    """Return the bytes of a sweep's table."""
    return (folder / "results.parquet").read_bytes()


class DeadlyPlan(Plan):
    """A plan of which one draw ends the process that makes it."""

    def seed_of(self, index: int) -> int:
        """Kill a worker over one draw; the process that leads the sweep survives it."""
        if index == DEADLY and multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().seed_of(index)
