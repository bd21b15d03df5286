"""Which columns of a table are its time, and how their cells become seconds: found from names and cells, or as told."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers import text_time, time_words
from shipfp_rs.logs.readers.text_time import DAY_NS, MISSING, TextTime

Array = npt.NDArray[np.float64]
Cells = Callable[[str], Iterator[pa.Array]]
"""Column to its cells, block by block, all columns in blocks of the same lengths."""

SAMPLE_ROWS = 2000
"""Rows from which the time is found."""
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
AMBIGUOUS = frozenset(
    ["x", "xvalue", "xvalues", "xdata", "xaxis", "tempo", "clock", "data", "ora", "hora", "saat", "instant"]
)
"""Words of time that mean other things as well."""
WORDS = {"d": "day first", "m": "month first", "y": "year first", "": ""}
ORDERS: dict[str, text_time.Order] = {"d": "d", "t": "d", "j": "d", "m": "m", "y": "y", "a": "y"}


@dataclass(frozen=True)
class Column:
    """A column that may be time: its name without the unit, its unit, its field in the table, cells of its first rows."""

    name: str
    unit: str
    key: str
    cells: pa.Array


@dataclass(frozen=True)
class TimePlan:
    """How the time of a table is read.

    Parameters
    ----------
    keys
        Fields of the table: one, or a date and a time of day.
    name
        What they are called in messages.
    how
        How each is written, None for numbers and for timestamps.
    factor, offset
        Seconds per unit and what is taken off before, of numbers.
    zero
        Where the seconds count from, where the file tells.
    note
        What was found, one line.
    """

    keys: tuple[str, ...]
    name: str
    how: tuple[TextTime | None, ...] = (None,)
    factor: float = 1.0
    offset: float = 0.0
    zero: datetime | None = None
    note: str = ""
    packed: bool = False
    """Whether a number is hours, minutes and seconds: 100059.5."""

    def seconds(self, path: object, cells: Cells) -> Iterator[Array]:
        """Yield the times of all rows [s] from `zero` on; NaN for an empty cell."""
        state = _Rollover()
        row = 0
        streams = [cells(key) for key in self.keys]
        for parts in zip(*streams, strict=True):
            try:
                yield self._decoded(parts, state)
            except ValueError as error:
                if len(error.args) != 2:
                    raise
                at, cell = error.args
                raise InputError(
                    f"{path}: time column {self.name!r}: record {row + int(at) + 1} holds {cell!r}, expected a time like "
                    "those before it"
                ) from None
            row += len(parts[0])

    def _decoded(self, parts: Sequence[pa.Array], state: _Rollover) -> Array:
        values = parts[0]
        if self.how[0] is None and pa.types.is_timestamp(values.type):
            return _from_zero(_stamps(values), self.zero)
        if self.how[0] is None:
            return self._numbers(values, state)
        told = [
            text_time.nanoseconds(part.cast(pa.string()), how)
            for part, how in zip(parts, self.how, strict=True)
            if how
        ]
        if len(told) == 2:
            both = np.where((told[0] == MISSING) | (told[1] == MISSING), MISSING, told[0] + told[1])
            return _from_zero(both, self.zero)
        if self.how[0].has_date:
            return _from_zero(told[0], self.zero)
        return state.unrolled(told[0])

    def _numbers(self, values: pa.Array, state: _Rollover) -> Array:
        if self.packed:
            seconds = np.asarray(values.cast(pa.float64()).to_numpy(zero_copy_only=False))
            known = np.where(np.isfinite(seconds), seconds, 0.0)
            told = np.rint(((known // 1e4) * 3600 + (known // 100 % 100) * 60 + known % 100) * 1e9).astype(
                np.int64
            )
            return state.unrolled(np.where(np.isfinite(seconds), told, MISSING))
        if pa.types.is_integer(values.type) and self.offset:
            whole = values.cast(pa.int64()).fill_null(int(self.offset)).to_numpy(zero_copy_only=False) - int(
                self.offset
            )
            seconds = whole * self.factor
            if values.null_count:
                seconds[values.is_null().to_numpy(zero_copy_only=False)] = np.nan
            return np.asarray(seconds)
        numbers = values.to_numpy(zero_copy_only=False).astype(np.float64)
        return np.asarray((numbers - self.offset) * self.factor if self.offset else numbers * self.factor)


@dataclass
class _Rollover:
    """Times of day that pass midnight, in stretches."""

    last: int = MISSING
    days: int = 0

    def unrolled(self, told: npt.NDArray[np.int64]) -> Array:
        known = told[told != MISSING]
        if not len(known):
            return np.full(len(told), np.nan)
        before = np.append(self.last if self.last != MISSING else known[0], known[:-1])
        passed = self.days + np.cumsum(known - before < -DAY_NS // 2)
        self.last, self.days = int(known[-1]), int(passed[-1])
        out = np.full(len(told), np.nan)
        out[told != MISSING] = (known + passed * DAY_NS) * 1e-9
        return out


def _stamps(values: pa.Array) -> npt.NDArray[np.int64]:
    whole = values.cast(pa.timestamp("ns", tz=values.type.tz), safe=False).cast(pa.int64())
    return np.asarray(whole.fill_null(int(MISSING)).to_numpy(zero_copy_only=False))


def _from_zero(told: npt.NDArray[np.int64], zero: datetime | None) -> Array:
    base = (
        0 if zero is None else (zero - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    )
    return np.where(told == MISSING, np.nan, (told - base) * 1e-9)


@dataclass(frozen=True)
class Wish:
    """What the user says of the time: columns, and a unit or the order of a date."""

    columns: tuple[str, ...]
    told: str = ""

    @classmethod
    def of(cls, text: str) -> Wish:
        """Read "COLUMN", "COLUMN [ms]", "COLUMN [d.m.y]" or "DATE + CLOCK"."""
        found = [re.fullmatch(r"(.*\S)\s*\[([^\]]*)\]\s*", part) for part in re.split(r"\s\+\s", text)]
        names = [
            match[1] if match else part for match, part in zip(found, re.split(r"\s\+\s", text), strict=True)
        ]
        told = next((match[2].strip() for match in found if match), "")
        return cls(tuple(name.strip() for name in names), told)


def find_time(
    path: object,
    columns: Sequence[Column],
    names: Mapping[str, str],
    *,
    wish: str | None,
    european: bool = False,
    nameless: bool = False,
) -> list[TimePlan]:
    """Find the time of a table: none, one, or several where each stands before the columns that go by it.

    Parameters
    ----------
    path
        For messages.
    columns
        Those that may be time.
    names
        Name of every column of the table to its key, in order.
    wish
        What the user says; see `Wish.of`.
    european
        Whether the table has decimal commas.
    nameless
        Whether the columns have no names: the first is time then, where it rises evenly and is no count of rows.

    Raises
    ------
    InputError
        Where the wish names no column, or what is found can be read in two ways.
    """
    if wish is not None:
        return [_wished(path, columns, names, Wish.of(wish), european)]
    numbers = [
        _numeric(path, c) for c in columns if time_words.is_time(c.name) and _is_number(c) and _fits_time(c)
    ]
    groups = _interleaved([plan for plan in numbers if plan], columns, names)
    if groups:
        return groups
    found = [plan for plan in [*numbers, *_texts(path, columns, european)] if plan is not None]
    scored = [(_score(path, plan, columns), -place, plan) for place, plan in enumerate(found)]
    usable = [item for item in scored if item[0] > (0.0,)]
    if not usable:
        # What is certainly called time is told of where it is none; an x may be anything.
        certain = [plan for plan in numbers if plan and time_words.plain(plan.name) not in AMBIGUOUS]
        return certain[:1] or (_nameless(columns, names) if nameless else [])
    best = max(usable, key=lambda item: item[:2])[2]
    others = [plan for _, _, plan in usable if plan is not best]
    zero = best.zero or next((_zero_of(path, plan, columns) for plan in others if plan.zero), None)
    also = f"; {', '.join(repr(plan.name) for plan in others)} not used for it" if others else ""
    return [replace(best, zero=zero, note=best.note + also)]


def _nameless(columns: Sequence[Column], names: Mapping[str, str]) -> list[TimePlan]:
    first = next((c for c in columns if c.key == next(iter(names.values())) and _is_number(c)), None)
    if first is None:
        return []
    steps = np.diff(_values(first))
    step = float(np.median(steps)) if len(steps) else 0.0
    if not 0.0 < step <= LONGEST_STEP_S or step == 1.0 or not (np.abs(steps - step) < 0.5 * step).all():
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
    if wish.told and wish.told.lower() in time_words.SECONDS and _is_number(first):
        return _numeric(path, replace(first, unit=wish.told), trusted=True) or TimePlan(
            (first.key,), first.name
        )
    order = ORDERS.get(wish.told[:1].lower(), "") if wish.told else ""
    if wish.told and not order:
        raise InputError(
            f"{path}: time column {first.name!r} [{wish.told}], expected a unit (s, ms, us, ns, min, h) or the order of a "
            "date (d.m.y, m/d/y, y-m-d)"
        )
    if len(chosen) == 1 and (_is_number(first) or pa.types.is_timestamp(first.cells.type)) and not order:
        plan = _numeric(path, first) if _is_number(first) else _stamped(path, first)
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


def _is_number(column: Column) -> bool:
    kind = column.cells.type
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _fits_time(column: Column) -> bool:
    """Whether the unit of a column that is called like a time is one of time: T [°C] is not."""
    return column.unit.lower() in time_words.SECONDS or column.unit == "UTC"


def _values(column: Column) -> Array:
    values = column.cells.to_numpy(zero_copy_only=False).astype(np.float64)
    return np.asarray(values[np.isfinite(values)])


def _numeric(path: object, column: Column, *, trusted: bool = False) -> TimePlan | None:
    """Tell seconds from other units and from what counts from a year."""
    values = _values(column)
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
            f"{path}: time column {column.name!r} tells no unit and rises by {step:g} a row; say which, such as "
            f"--time '{column.name} [ms]'"
        )
    note = f"time from {column.name!r}, taken as seconds" if not unit else ""
    return replace(plan, factor=factor, note=note)


def _is_packed(values: Array) -> bool:
    """Whether numbers go from 59.9 to 100.0, as hhmmss.s without marks does."""
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


def _stamped(path: object, column: Column) -> TimePlan:
    return _with_zero(path, TimePlan((column.key,), column.name), [column])


def _texts(path: object, columns: Sequence[Column], european: bool) -> list[TimePlan | None]:
    """Plans for timestamps, for texts that are times, and for a date beside a time of day."""
    plans: list[TimePlan | None] = [_stamped(path, c) for c in columns if pa.types.is_timestamp(c.cells.type)]
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
    if pa.types.is_integer(column.cells.type) and time_words.is_date(column.name):
        cells = [str(cell) for cell in column.cells.to_pylist() if cell is not None]
        found = text_time.find_text_time(cells)
        return found if found and found.pattern == "compact" else None
    if not pa.types.is_string(column.cells.type):
        return None
    cells = [cell for cell in column.cells.to_pylist() if cell]
    found = text_time.find_text_time(cells, european=european)
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
        note += f", {WORDS[dated.order]}" + (
            "" if dated.sure else f" by custom; else say --time '{name} [{_other(dated)}]'"
        )
    return _with_zero(path, TimePlan(keys, name, tuple(how), note=note), columns)


def _other(how: TextTime) -> str:
    return "m/d/y" if how.order == "d" else "d/m/y"


def _with_zero(path: object, plan: TimePlan, columns: Sequence[Column]) -> TimePlan:
    """Count from the first row of a plan whose cells have dates."""
    zero = _zero_of(path, plan, columns)
    return replace(plan, zero=zero)


def _zero_of(path: object, plan: TimePlan, columns: Sequence[Column]) -> datetime | None:
    if plan.zero is not None and plan.how == (None,) and plan.offset:
        return plan.zero
    by_key = {column.key: column for column in columns}
    first = by_key[plan.keys[0]].cells
    if plan.how[0] is None:
        if not pa.types.is_timestamp(first.type):
            return None
    elif not any(how and how.has_date for how in plan.how):
        return None
    bare = replace(plan, zero=None)
    for seconds in bare.seconds(path, lambda key: iter([by_key[key].cells[:SAMPLE_ROWS]])):
        known = seconds[np.isfinite(seconds)]
        if len(known):
            if plan.how[0] is None:
                told = _stamps(first)
                ns = int(told[told != MISSING][0])
            else:
                ns = round(float(known[0]) * 1e9)
                ns = _first_ns(plan, by_key)
            return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=ns // 1000)
    return None


def _first_ns(plan: TimePlan, columns: Mapping[str, Column]) -> int:
    told = [
        text_time.nanoseconds(columns[key].cells.cast(pa.string()), how)
        for key, how in zip(plan.keys, plan.how, strict=True)
        if how
    ]
    known = np.logical_and.reduce([part != MISSING for part in told])
    return int(sum(int(part[known][0]) for part in told))


def _score(path: object, plan: TimePlan, columns: Sequence[Column]) -> tuple[float, ...]:
    """How well a column's first rows do for a time: that they rise, in even steps, and that one calls it time."""
    by_key = {column.key: column for column in columns}
    (seconds,) = plan.seconds(path, lambda key: iter([by_key[key].cells]))
    seconds = seconds[np.isfinite(seconds)]
    steps = np.diff(seconds)
    if len(steps) < 1 or np.mean(steps < 0.0) > 0.02 or not (steps > 0.0).any():
        return (0.0,)
    rising = float(np.mean(steps > 0.0))
    middle = float(np.median(steps[steps > 0.0]))
    even = float(np.mean(np.abs(steps - middle) < 0.5 * middle))
    named = any(time_words.is_time(by_key[key].name) for key in plan.keys)
    return (1.0, round(rising, 1), round(even, 1), float(named))


def _interleaved(
    plans: Sequence[TimePlan], columns: Sequence[Column], names: Mapping[str, str]
) -> list[TimePlan]:
    """Plans of a table whose columns come in pairs or groups, each with a time of its own before it; else none."""
    if len(plans) < 2:
        return []
    keys = list(names.values())
    places = [keys.index(plan.keys[0]) for plan in plans]
    apart = all(after - before > 1 for before, after in zip(places, [*places[1:], len(keys)], strict=True))
    words = {time_words.plain(re.sub(r"\s*\(\d+\)$", "", plan.name)) for plan in plans}
    return list(plans) if places[0] == 0 and apart and len(words) == 1 else []
