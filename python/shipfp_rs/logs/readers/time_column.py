"""Time columns of a table: detected from names and cells, or given by the user."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers import time_cells
from shipfp_rs.logs.readers.time_cells import EPOCH, MISSING, Order, TextTime, TimePlan, find_text_time
from shipfp_rs.support.arrays import Array

SAMPLE_ROWS = 2000
"""Number of first rows in which the time is detected."""
EPOCHS: tuple[tuple[float, float, float, datetime, str], ...] = (
    (9.4e8, 2.2e9, 1.0, EPOCH, "s since 1970"),
    (9.4e11, 2.2e12, 1e-3, EPOCH, "ms since 1970"),
    (9.4e14, 2.2e15, 1e-6, EPOCH, "us since 1970"),
    (9.4e17, 2.2e18, 1e-9, EPOCH, "ns since 1970"),
    (3.02e9, 4.3e9, 1.0, datetime(1904, 1, 1, tzinfo=UTC), "s since 1904 (LabVIEW)"),
    (1.25e17, 1.4e17, 1e-7, datetime(1601, 1, 1, tzinfo=UTC), "100 ns since 1601 (Windows)"),
    (6.3e17, 6.5e17, 1e-7, datetime(1, 1, 1, tzinfo=UTC), "100 ns since year 1 (.NET)"),
)
"""For each epoch: lowest and highest value for dates from about 2000 to 2039, unit [s], epoch, description. The ranges
do not overlap.
"""
DAYS = (
    (3.6e4, 5.1e4, 25569.0, "days since 1900 (Excel)"),
    (7.3e5, 7.46e5, 719529.0, "days since year 0 (MATLAB)"),
)
"""For times in days: lowest and highest value for the same dates, value at 1970-01-01, description."""
DAY_STEP = 1e-4
"""Largest plausible step of times in days (8.6 s). Times with such small steps in seconds would have a rate above 10 kHz."""
LONGEST_STEP_S = 5.0
"""Longest plausible step [s] of a column without a unit; a column with longer steps is not taken as seconds."""
CENTURIES_S = 6.3e9
WORDS = {"d": "day first", "m": "month first", "y": "year first", "": ""}
ORDERS: dict[str, Order] = {"d": "d", "t": "d", "j": "d", "m": "m", "y": "y", "a": "y"}


class Column(NamedTuple):
    """Possible time column: name without unit, unit, key of the field in the table, cells of its first rows."""

    name: str
    unit: str
    key: str
    cells: pa.Array


def is_number(column: Column) -> bool:
    """Whether a column holds numbers, not text or timestamps."""
    kind = column.cells.type
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def fits_time(column: Column) -> bool:
    """Whether a column whose name means time has a unit of time: T [°C] does not."""
    return column.unit.lower() in time_cells.SECONDS or column.unit == "UTC"


def numbers_of(column: Column) -> Array:
    """Finite numbers in a column's first rows."""
    values = column.cells.to_numpy(zero_copy_only=False).astype(np.float64)
    return np.asarray(values[np.isfinite(values)])


def plan_of_numbers(path: object, column: Column, *, trusted: bool = False) -> TimePlan | None:
    """Interpret a column of numbers by its unit of time, or as time since an epoch such as 1970."""
    values = numbers_of(column)
    plan = TimePlan((column.key,), column.name)
    if len(values) < 2:
        return plan
    first, step = float(values[0]), float(np.median(np.diff(values)))
    unit = column.unit.lower() if column.unit != "UTC" else ""
    factor = time_cells.SECONDS.get(unit, 1.0)
    for low, high, scale, year, text in EPOCHS:
        stated = unit and abs(scale / factor - 1.0) < 0.5
        if not low < first < high or (unit and not stated and first * factor < CENTURIES_S):
            continue
        if not unit and step * scale > LONGEST_STEP_S:
            raise InputError(
                f"{path}: time column {column.name!r} starts at {first:.10g} in steps of {step:g}; is it {text}, or "
                f"in another unit? give the unit, such as --time '{column.name} [us]'"
            )
        offset = float(np.floor(first)) if scale == 1.0 else first
        zero = year + timedelta(microseconds=round(offset * scale * 1e6))
        contradicts = f", not {column.unit} as its heading says" if unit and not stated else ""
        # Times relative to the first row keep their last digits in float64; times since the epoch would lose them.
        note = f"time from {column.name!r}, {text}{contradicts}"
        return replace(plan, factor=scale, offset=offset, zero=zero, note=note)
    if not unit and _is_packed(values):
        return replace(
            plan, packed=True, note=f"time from {column.name!r}, hours, minutes and seconds as one number"
        )
    for low, high, at_1970, text in DAYS:
        if low < first < high and not unit and 0.0 < step < DAY_STEP:
            offset = float(np.floor(first))
            zero = EPOCH + timedelta(days=offset - at_1970)
            return replace(
                plan, factor=86400.0, offset=offset, zero=zero, note=f"time from {column.name!r}, {text}"
            )
    if not unit and not trusted and step > LONGEST_STEP_S:
        raise InputError(
            f"{path}: time column {column.name!r} has no unit and rises by {step:g} per row; give its unit, such as "
            f"--time '{column.name} [ms]'"
        )
    note = f"time from {column.name!r}, taken as seconds" if not unit else ""
    return replace(plan, factor=factor, note=note)


def _is_packed(values: Array) -> bool:
    """Whether numbers are times of day hhmmss.s: read as times, their steps are more equal than read as numbers."""
    inside = (values >= 0.0) & (values < 240000.0) & (values % 100 < 60) & (values // 100 % 100 < 60)
    steps = np.diff(values)
    told = np.diff(values // 1e4 * 3600.0 + values // 100 % 100 * 60.0 + values % 100)
    middle = float(np.median(steps))
    even, packed = (np.abs(each - middle) < 0.5 * max(middle, 0.0) for each in (steps, told))
    return bool(inside.all() and packed.sum() > even.sum() and (steps >= 0.0).all())


@dataclass(frozen=True)
class Wish:
    """Time columns requested by the user, with a unit or the order of a date."""

    columns: tuple[str, ...]
    told: str = ""

    @classmethod
    def of(cls, text: str) -> Wish:
        """Parse "COLUMN", "COLUMN [ms]", "COLUMN [d.m.y]" or "DATE + CLOCK"."""
        parts = re.split(r"\s\+\s", text)
        found = [re.fullmatch(r"(.*\S)\s*\[([^\]]*)\]\s*", part) for part in parts]
        names = (match[1] if match else part for match, part in zip(found, parts, strict=True))
        told = next((match[2].strip() for match in found if match), "")
        return cls(tuple(name.strip() for name in names), told)


def find_time(
    path: object,
    columns: Sequence[Column],
    names: Mapping[str, str],  # key of every column of the table by name, in order
    *,
    wish: str | None,  # the user's request, see `Wish.of`
    european: bool = False,  # the table has decimal commas
    nameless: bool = False,  # without headings: the first column is time if it rises evenly and does not count rows
) -> list[TimePlan]:
    """Find the time columns of a table: none, one, or several that each precede the columns they belong to."""
    if wish is not None:
        return [_wished(path, columns, names, Wish.of(wish), european)]
    timely = [column for column in columns if is_number(column) and fits_time(column)]
    numbers = [plan_of_numbers(path, column) for column in timely if time_cells.is_time(column.name)]
    texts = _texts(path, columns, european)
    found = [plan for plan in [*numbers, *texts] if plan is not None]
    if groups := _interleaved(path, found, columns, names):
        return groups
    scored = [(_score(path, plan, columns), -place, plan) for place, plan in enumerate(found)]
    usable = [item for item in scored if item[0] > (0.0,)]
    if not usable:
        # Return a column that is clearly named as time although it is not usable; its use raises an error.
        ambiguous = time_cells.WORDS["ambiguous"].split()
        certain = [plan for plan in numbers if plan and time_cells.plain(plan.name) not in ambiguous]
        of_unit = (plan_of_numbers(path, column) for column in timely if column.unit)
        by_unit = [plan for plan in of_unit if plan and _score(path, plan, columns)[:3] == (1.0, 1.0, 1.0)]
        return certain[:1] or by_unit[:1] or (_nameless(columns, names) if nameless else [])
    best = max(usable, key=lambda item: item[:2])[2]
    others = [plan for _, _, plan in usable if plan is not best]
    zero = best.zero or next((_zero_of(path, plan, columns) for plan in others if plan.zero), None)
    also = f"; {', '.join(repr(plan.name) for plan in others)} not used for it" if others else ""
    return [replace(best, zero=zero, note=best.note + also)]


def even_step(values: Array) -> float:
    """Step of values that rise evenly and do not count rows; 0 for other values."""
    steps = np.diff(values)
    step = float(np.median(steps)) if len(steps) else 0.0
    return step if step > 0.0 and step != 1.0 and (np.abs(steps - step) < 0.5 * step).all() else 0.0


def _nameless(columns: Sequence[Column], names: Mapping[str, str]) -> list[TimePlan]:
    first = next((c for c in columns if c.key == next(iter(names.values())) and is_number(c)), None)
    if first is None:
        return []
    step = even_step(numbers_of(first))
    if not 0.0 < step <= LONGEST_STEP_S:
        return []
    note = f"no headings; {first.name!r} rises evenly by {step:.6g} and is taken as time in s"
    return [TimePlan((first.key,), first.name, note=note)]


def _wished(
    path: object, columns: Sequence[Column], names: Mapping[str, str], wish: Wish, european: bool
) -> TimePlan:
    chosen: list[Column] = []
    for text in wish.columns:
        column = next((c for c in columns if text in (c.key, c.name)), None)
        column = column or next((c for c in columns if c.name.lower() == text.lower()), None)
        if column is None:
            raise InputError(
                f"{path}: time column {text!r}, found {', '.join(names)}; name one of them (--time)"
            )
        chosen.append(column)
    if len(chosen) > 2:
        raise InputError(
            f"{path}: time columns {' + '.join(wish.columns)!r}, expected one, or a date + a time of day"
        )
    first = chosen[0]
    if wish.told and wish.told.lower() in time_cells.SECONDS and is_number(first):
        return plan_of_numbers(path, first._replace(unit=wish.told), trusted=True) or TimePlan(
            (first.key,), first.name
        )
    order = ORDERS.get(wish.told[:1].lower(), "") if wish.told else ""
    if wish.told and not order:
        raise InputError(
            f"{path}: time column {first.name!r} [{wish.told}], expected a unit (s, ms, us, ns, min, h) or the order of a "
            "date (d.m.y, m/d/y, y-m-d)"
        )
    if len(chosen) == 1 and (is_number(first) or pa.types.is_timestamp(first.cells.type)) and not order:
        stamped = TimePlan((first.key,), first.name)
        plan = plan_of_numbers(path, first) if is_number(first) else _with_zero(path, stamped, [first])
        if plan is None:
            raise InputError(
                f"{path}: time column {first.name!r} holds no numbers in its first rows; name another (--time)"
            )
        return plan
    plan = _text_plan(path, chosen, european)
    if plan is None:
        cell = next((str(c) for c in first.cells.to_pylist() if c is not None), "")
        raise InputError(
            f"{path}: time column {first.name!r} holds {cell!r}, expected numbers, or a date and time like "
            "2019-11-05 10:00:00.5, 05.11.2019 10:00:00 or 10:00:00 PM"
        )
    if order:
        how = tuple(
            replace(each, order=order, sure=True) if each and each.has_date else each for each in plan.how
        )
        note = f"time from {plan.name!r}, {WORDS[how[0].order if how[0] else '']} as told"
        plan = _with_zero(path, replace(plan, how=how, note=note), chosen)
    return plan


def _texts(path: object, columns: Sequence[Column], european: bool) -> list[TimePlan | None]:
    """Plans for timestamps, for texts that are times, and for a date beside a time of day."""
    stamps = [column for column in columns if pa.types.is_timestamp(column.cells.type)]
    plans: list[TimePlan | None] = [_with_zero(path, TimePlan((c.key,), c.name), [c]) for c in stamps]
    dates: list[Column] = []
    clocks: list[Column] = []
    for column in columns:
        how = _how(column, european)
        if how is None:
            continue
        if how.has_date and how.has_clock:
            plans.append(_text_plan(path, [column], european))
        else:
            (dates if how.has_date else clocks).append(column)
    if dates and clocks:
        plans.append(_text_plan(path, [dates[0], clocks[0]], european))
        clocks = clocks[1:]
    plans += [_text_plan(path, [clock], european) for clock in clocks]
    return plans


def _how(column: Column, european: bool) -> TextTime | None:
    if pa.types.is_integer(column.cells.type) and time_cells.is_date(column.name):
        cells = [str(cell) for cell in column.cells.to_pylist() if cell is not None]
        found = find_text_time(cells)
        return found if found and found.pattern == "compact" else None
    if not pa.types.is_string(column.cells.type):
        return None
    cells = [cell for cell in column.cells.to_pylist() if cell]
    found = find_text_time(cells, european=european)
    if found is not None and found.pattern.startswith("two") and not found.sure:
        told = column.unit[:1].lower()
        if told in ("d", "t", "j", "m") and re.search("y|j|a", column.unit.lower()):
            return replace(found, order="m" if told == "m" else "d", sure=True)
    return found


def _text_plan(path: object, columns: Sequence[Column], european: bool) -> TimePlan | None:
    how = [_how(column, european) for column in columns]
    if any(each is None for each in how):
        return None
    told = [each for each in how if each]
    if len(told) == 2 and (told[0].has_date == told[1].has_date):
        return None
    keys = tuple(column.key for column in columns)
    name = " + ".join(column.name for column in columns)
    dated = next((each for each in told if each.has_date), None)
    note = f"time from {name!r}"
    if dated is None:
        note += ", time of day without a date"
    else:
        other = "m/d/y" if dated.order == "d" else "d/m/y"
        note += f", {WORDS[dated.order]}"
        note += "" if dated.sure else f" by custom; else say --time '{name} [{other}]'"
    return _with_zero(path, TimePlan(keys, name, tuple(how), note=note), columns)


def _with_zero(path: object, plan: TimePlan, columns: Sequence[Column]) -> TimePlan:
    """Set the origin of a plan with dates to the first row."""
    return replace(plan, zero=_zero_of(path, plan, columns))


def _zero_of(path: object, plan: TimePlan, columns: Sequence[Column]) -> datetime | None:
    if plan.offset:  # the numbers count from an epoch
        return plan.zero
    by_key = {column.key: column.cells for column in columns}
    told = plan.stamps(path, [by_key[key] for key in plan.keys])
    known = [] if told is None or not plan.dated else told[told != MISSING].tolist()
    return EPOCH + timedelta(microseconds=known[0] // 1000) if known else None


def _score(path: object, plan: TimePlan, columns: Sequence[Column]) -> tuple[float, ...]:
    """Score of a column as time: fraction of rising steps, fraction of even steps, whether its name means time."""
    steps = _first_steps(path, plan, columns)
    if len(steps) < 1 or np.mean(steps < 0.0) > 0.02 or not (steps > 0.0).any():
        return (0.0,)
    rising = float(np.mean(steps > 0.0))
    middle = float(np.median(steps[steps > 0.0]))
    even = float(np.mean(np.abs(steps - middle) < 0.5 * middle))
    named = any(time_cells.is_time(column.name) for column in columns if column.key in plan.keys)
    return (1.0, round(rising, 1), round(even, 1), float(named))


def _first_steps(path: object, plan: TimePlan, columns: Sequence[Column]) -> Array:
    """Steps of the known times in the first rows [s]."""
    by_key = {column.key: column.cells for column in columns}
    (seconds,) = plan.seconds(path, lambda key: iter([by_key[key]]))
    return np.diff(seconds[np.isfinite(seconds)])


def timed_key(key: str, names: Mapping[str, str]) -> str | None:
    """Key of the column after which a time column is named."""
    name = next(name for name, own in names.items() if own == key)
    lower = {other.lower().replace(" ", "_"): own for other, own in names.items()}
    return next((lower[part] for part in sorted(time_cells.timed_by(name)) if part in lower), None)


def _interleaved(
    path: object, plans: Sequence[TimePlan], columns: Sequence[Column], names: Mapping[str, str]
) -> list[TimePlan]:
    """Time plans of a table with groups of columns that each start with a time column; else an empty list."""
    # Each time column is named after a column, or all have similar names, or their first rows rise at different rates.
    keys = list(names.values())
    own = {column.key: column for column in columns}
    single = [(plan, own[plan.keys[0]]) for plan in plans if len(plan.keys) == 1]
    plans = [plan for plan, column in single if time_cells.is_time(column.name) or not is_number(column)]
    if len(after := [plan for plan in plans if timed_key(plan.keys[0], names)]) > 1:
        return after
    plans = sorted(plans, key=lambda plan: keys.index(plan.keys[0]))
    places = [keys.index(plan.keys[0]) for plan in plans]
    if len(plans) < 2 or places[0] or min(np.diff([*places, len(keys)])) < 2:
        return []
    words = {time_cells.plain(re.sub(r"\s*\(\d+\)$", "", own[plan.keys[0]].name)) for plan in plans}
    if len(words) == 1:
        return plans
    steps = []
    for plan in plans:
        each = _first_steps(path, plan, columns)
        steps.append(float(np.median(each)) if len(each) and (each > 0.0).all() else 0.0)
    apart = min(steps) > 0.0 and len(np.unique(np.round(np.log(steps), 1))) == len(plans)
    return plans if apart else []
