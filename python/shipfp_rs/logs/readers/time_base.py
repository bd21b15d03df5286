"""Start and rate of a time column, and the names and units under which loggers write time, rates and units."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError

TIME_NAMES = ("time", "t", "time_s", "time_ms", "timestamp", "timestamps", "datetime", "date/time", "zeit")
"""What a column of time may be called, in lower case."""

SECONDS = {
    "": 1.0,
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "ns": 1e-9,
}
SECONDS |= {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
"""Of the units that a time column may have."""

RATE_NAMES = (
    "rate_hz",
    "fs",
    "sample_rate",
    "samplerate",
    "sampling_rate",
    "sample_frequency",
    "sampling_frequency",
    "sampling",
    "samples_per_second",
    "sps",
    "scan_rate",
    "logging_rate",
    "log_rate",
    "abtastrate",
    "abtastfrequenz",
    "messrate",
    "samplefrequentie",
    "bemonsteringsfrequentie",
    "fréquence_d'échantillonnage",
    "fréquence_échantillonnage",
    "samplingsfrekvens",
    "samplingsfrekvensen",
    "punktavläsningsfrekvens",
    "frecuencia_de_muestreo",
    "frequência_de_amostragem",
    "frequenza_di_campionamento",
    "częstotliwość_próbkowania",
    "näytteenottotaajuus",
    "örnekleme_frekansı",
    "частота_дискретизации",
)
INTERVAL_NAMES = (
    "dt",
    "ts",
    "delta_x",
    "deltax",
    "sample_interval",
    "sampling_interval",
    "sample_period",
    "sampling_period",
    "sample_time",
    "interval",
    "wf_increment",
    "abtastintervall",
    "abtastzeit",
    "abtastperiode",
    "periode_d'échantillonnage",
    "período_de_muestreo",
)
"""What a sample rate [Hz] or the time between two samples [s] may be called, in lower case with underscores."""


@np.errstate(all="ignore")  # what is not finite is found below
def time_base(
    path: Path, name: str, blocks: Iterable[npt.NDArray[np.float64]], *, check: bool
) -> tuple[float, float]:
    """Return start [s] and mean rate [Hz] of a time column in one pass.

    With `check`, raise where a step differs from the median step of the first block by more than half of it.
    """
    start = last = interval = np.nan
    count = 0
    for block in blocks:
        if not len(block):
            continue
        if not count:
            start = float(block[0])
            interval = float(np.nanmedian(np.diff(block))) if np.isfinite(block).sum() > 1 else np.nan
            last = start - interval
            if check and not interval > 0.0:
                raise InputError(
                    f"{path}: time column {name!r} does not increase from row to row; give rate_hz (--rate)"
                )
        if check:
            steps = np.diff(block, prepend=last)
            bad = np.flatnonzero(~(np.abs(steps - interval) < 0.5 * interval))
            if bad.size:
                raise InputError(
                    f"{path}: time column {name!r} is not uniform at row {count + int(bad[0]) + 1}: a step "
                    f"of {steps[bad[0]]:g} s, expected {interval:g} s; cut the file there or give rate_hz (--rate)"
                )
        last = float(block[-1])
        count += len(block)
    rate = (count - 1) / (last - start) if last != start else np.nan
    rate = float(f"{rate:.12g}")  # 20, not 19.999999999999996: times are not known to their last bit
    if not np.isfinite(start) or (check and not 0.0 < rate < np.inf):
        raise InputError(
            f"{path}: time column {name!r} starts at {start:g} s; expected numbers that increase"
        )
    return start, rate


def seconds_per(path: Path, unit: str) -> float:
    """Return the seconds in one of a time column's units; `InputError` where it is none of time."""
    if unit not in SECONDS:
        raise InputError(
            f"{path}: time column holds unit {unit!r}, expected timestamps or a number of s, ms, us or ns"
        )
    return SECONDS[unit]


def stated_rate(facts: Iterable[tuple[str, object]]) -> float | None:
    """Return the sample rate [Hz] that one of these named values states, or None."""
    for name, value in facts:
        key = re.sub(r"[\s-]+", "_", name.strip().lower())
        number = np.asarray(value)
        if number.size != 1 or number.dtype.kind not in "iuf":
            continue
        known = float(number.reshape(-1)[0])
        if not 0.0 < known < np.inf:
            continue
        if key in RATE_NAMES or key.removesuffix("_hz") in RATE_NAMES:
            return known
        if key in INTERVAL_NAMES:
            return 1.0 / known
    return None


def split_unit(heading: str) -> tuple[str, str]:
    """Split "torque [V]" or "torque (V)" into name and unit."""
    match = re.fullmatch(r"(.*\S)\s*(?:\[([^\]]*)\]|\(([^)]*)\))", heading)
    return (match[1], (match[2] or match[3] or "").strip()) if match else (heading, "")
