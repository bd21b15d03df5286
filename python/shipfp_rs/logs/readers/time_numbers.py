"""Columns of numbers that may be time: seconds and other units, what counts from a year, hours and minutes in one number."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers import time_words
from shipfp_rs.logs.readers.time_plan import TimePlan

Array = npt.NDArray[np.float64]

EPOCHS: tuple[tuple[float, float, float, datetime, str], ...] = (
    (9.4e8, 2.2e9, 1.0, datetime(1970, 1, 1, tzinfo=UTC), "s since 1970"),
    (9.4e11, 2.2e12, 1e-3, datetime(1970, 1, 1, tzinfo=UTC), "ms since 1970"),
    (9.4e14, 2.2e15, 1e-6, datetime(1970, 1, 1, tzinfo=UTC), "us since 1970"),
    (9.4e17, 2.2e18, 1e-9, datetime(1970, 1, 1, tzinfo=UTC), "ns since 1970"),
    (3.02e9, 4.3e9, 1.0, datetime(1904, 1, 1, tzinfo=UTC), "s since 1904 (LabVIEW)"),
    (1.25e17, 1.4e17, 1e-7, datetime(1601, 1, 1, tzinfo=UTC), "100 ns since 1601 (Windows)"),
    (6.3e17, 6.5e17, 1e-7, datetime(1, 1, 1, tzinfo=UTC), "100 ns since year 1 (.NET)"),
)
"""Ranges of what counts from a year, the first years of this century to 2039 about, in which they do not overlap."""
DAYS = (
    (3.6e4, 5.1e4, 25569.0, "days since 1900 (Excel)"),
    (7.3e5, 7.46e5, 719529.0, "days since year 0 (MATLAB)"),
)
"""Ranges of what counts days, in the same years, and where 1970 began."""
DAY_STEP = 1e-4
"""Days: above it a step is longer than eight seconds; as seconds it would be a rate above ten kilohertz."""
LONGEST_STEP_S = 5.0
"""A column without a unit whose steps would be longer, taken as seconds, is not taken for them."""
CENTURIES_S = 6.3e9


class Column(NamedTuple):
    """A column that may be time: its name without the unit, its unit, its field in the table, cells of its first rows."""

    name: str
    unit: str
    key: str
    cells: pa.Array


def is_number(column: Column) -> bool:
    """Whether a column holds numbers, and neither text nor timestamps."""
    kind = column.cells.type
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def fits_time(column: Column) -> bool:
    """Whether the unit of a column that is called like a time is one of time: T [°C] is not."""
    return column.unit.lower() in time_words.SECONDS or column.unit == "UTC"


def numbers_of(column: Column) -> Array:
    """Return the finite numbers of a column's first rows."""
    values = column.cells.to_numpy(zero_copy_only=False).astype(np.float64)
    return np.asarray(values[np.isfinite(values)])


def plan_of_numbers(path: object, column: Column, *, trusted: bool = False) -> TimePlan | None:
    """Tell seconds from other units and from what counts from a year."""
    values = numbers_of(column)
    plan = TimePlan((column.key,), column.name)
    if len(values) < 2:
        return plan
    first, step = float(values[0]), float(np.median(np.diff(values)))
    unit = column.unit.lower() if column.unit != "UTC" else ""
    factor = time_words.SECONDS.get(unit, 1.0)
    for low, high, scale, year, text in EPOCHS:
        stated = unit and abs(scale / factor - 1.0) < 0.5
        if not low < first < high or (unit and not stated and first * factor < CENTURIES_S):
            continue
        if not unit and step * scale > LONGEST_STEP_S:
            raise InputError(
                f"{path}: time column {column.name!r} starts at {first:.10g} in steps of {step:g}: {text}, or another unit? "
                f"say which, such as --time '{column.name} [us]'"
            )
        offset = float(np.floor(first)) if scale == 1.0 else first
        zero = year + timedelta(microseconds=round(offset * scale * 1e6))
        contradicts = f", not {column.unit} as its heading says" if unit and not stated else ""
        # The first row is zero: seconds of a day keep their last digits, those since a year do not.
        return replace(
            plan,
            factor=scale,
            offset=offset,
            zero=zero,
            note=f"time from {column.name!r}, {text}{contradicts}",
        )
    if not unit and _is_packed(values):
        return replace(
            plan, packed=True, note=f"time from {column.name!r}, hours, minutes and seconds as one number"
        )
    for low, high, at_1970, text in DAYS:
        if low < first < high and not unit and 0.0 < step < DAY_STEP:
            offset = float(np.floor(first))
            zero = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=offset - at_1970)
            return replace(
                plan, factor=86400.0, offset=offset, zero=zero, note=f"time from {column.name!r}, {text}"
            )
    if not unit and not trusted and step > LONGEST_STEP_S:
        raise InputError(
            f"{path}: time column {column.name!r} has no unit and rises by {step:g} a row; say which, such as "
            f"--time '{column.name} [ms]'"
        )
    note = f"time from {column.name!r}, taken as seconds" if not unit else ""
    return replace(plan, factor=factor, note=note)


def _is_packed(values: Array) -> bool:
    """Whether numbers are times of day such as 100059.5 (hhmmss.s), which jump from 59.9 to 100.0."""
    if (
        values.min() < 0.0
        or values.max() >= 240000.0
        or (values % 100 >= 60).any()
        or (values // 100 % 100 >= 60).any()
    ):
        return False
    steps = np.diff(values)
    step = float(np.median(steps))
    return bool(np.any(np.abs(steps - step - 40.0) < 0.5 * max(step, 0.0)) and np.all(steps >= 0.0))
