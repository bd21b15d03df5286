"""Conversion of time cells to seconds: numbers, time stamps, and dates and times of day with their parts in any order."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from shipfp_rs.errors import InputError
from shipfp_rs.support import units
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.files import words_of

WORDS: Mapping[str, Any] = words_of("time_words")
"""Words for time in all languages; `data/time_words.toml` describes its lists."""
TIMES, DATES, RATES, INTERVALS, STARTS = (
    frozenset(WORDS[what].split()) for what in ("time", "date", "rate", "interval", "start")
)
SECONDS = {"": 1.0} | {
    word: float(unit) for unit, words in WORDS["seconds"].items() for word in words.split()
}
"""Seconds per unit of time, by name in lower case."""
MONTHS = {name: number for number, names in enumerate(WORDS["months"], start=1) for name in names.split()}
"""Months by the first letters of their names."""
BRACKETED = re.compile(r"(.*\S)\s*(?:\[([^\]]*)\]|\(([^)]*)\)|\{([^}]*)\}|<([^>]*)>)\s*")
TAILS = (r"(.*\S)\s+in\s+(\S+)", r"(.*?\S)\s*/\s*(.+)", r"(.*\S)\s*[,;:]\s*(\S+)", r"(.*\S)\s+-\s+(\S+)")
UNDERSCORED = re.compile(r"(.*[^\W_])[ _.]+([a-zµμ]+)")


def split_unit(heading: str) -> tuple[str, str]:
    """Split a heading into name and unit at any usual separator: "torque [V]", "n (1/min)", "t / s", "M in Nm".

    After a slash, a comma or "in", only a known unit is split off; after an underscore, only a unit of time, if the
    name means time.

    Examples
    --------
    >>> [split_unit(text) for text in ("torque [V]", "n / U/min", "Date/Time", "time_ms", "rate_hz")]
    [('torque', 'V'), ('n', 'rpm'), ('Date/Time', ''), ('time', 'ms'), ('rate_hz', '')]
    """
    if BRACKETED.fullmatch(heading):
        return split_bracketed(heading)
    spaced = re.fullmatch(r"(.*[^\s/,;:\-])(?<!\sin)\s+(\S+)", heading)
    if spaced and "/" in spaced[2] and units.told(spaced[2]) == "rpm":
        return spaced[1], "rpm"
    for pattern in TAILS:
        found = re.fullmatch(pattern, heading)
        # A dash and the letters of a time format, such as h:m:s, are not units.
        if found is None or found[2] == "-" or units.TIME_FORMAT.fullmatch(found[2]):
            continue
        if units.is_unit(found[2]):
            return found[1], units.told(found[2])
    found = UNDERSCORED.fullmatch(heading)
    if found and is_time(found[1]) and found[2].lower() in SECONDS:
        return found[1], found[2]
    return heading, ""


def split_bracketed(heading: str) -> tuple[str, str]:
    """Split a heading into name and unit only at a bracket, for names in which a slash separates path elements."""
    found = BRACKETED.fullmatch(heading)
    if found is None:
        return heading, ""
    return found[1], units.told(next((part for part in found.groups()[1:] if part), ""))


def plain(name: str) -> str:
    """Name in lower case without spaces, punctuation and trailing number."""
    text = unicodedata.normalize("NFC", name).lower()
    text = re.sub(r"[\s_\-./#%*'\"&+:;,!?()]+", "", text)
    return re.sub(r"(?<=[^\W\d])\d{1,2}$", "", text)


def is_time(name: str) -> bool:
    """Whether a column's name means time, or date and time.

    Examples
    --------
    >>> is_time("Zeit  1 - Standardmessrate"), is_time("X 1 - Position")
    (True, False)
    """
    counted = re.fullmatch(r"(\w{4,})\s+\d+\s+-\s+.+", name)
    return plain(counted[1] if counted else name) in TIMES


def timed_by(name: str) -> set[str]:
    """Names, in lower case, of channels to which a time column may belong: its own name without the word for time.

    Examples
    --------
    >>> timed_by("Data1_time_U_Pickup"), timed_by("Speed")
    ({'data1_u_pickup'}, set())
    """
    words = re.split(r"[\s_.-]+", name.lower())
    names = {"_".join(words[:k] + words[k + 1 :]) for k, word in enumerate(words) if plain(word) in TIMES}
    return names - {""}


def is_date(name: str) -> bool:
    """Whether a column's name means a date."""
    return plain(name) in DATES


def stated_start(facts: Iterable[tuple[str, float]]) -> float:
    """Time of the first sample [s] stated by a name and value, else 0."""
    return next((value for name, value in facts if _key(name) in STARTS and np.isfinite(value)), 0.0)


def _key(name: str) -> str:
    return re.sub(r"[\s-]+", "_", name.strip().lower())


def stated_rate(facts: Iterable[tuple[str, object]]) -> float | None:
    """Sample rate [Hz] stated by a name and value (rate or interval); None if there is none."""
    for name, value in facts:
        key = _key(name)
        number = np.asarray(value)
        if number.size != 1 or number.dtype.kind not in "iuf":
            continue
        known = float(number.reshape(-1)[0])
        if not 0.0 < known < np.inf:
            continue
        if key in RATES or key.removesuffix("_hz") in RATES:
            return known
        if key in INTERVALS:
            return float(f"{1.0 / known:.12g}")
    return None


Order = Literal["y", "d", "m", ""]
"""First element of a date: year, day or month; empty if it is unknown or there is no date."""
Nanoseconds = npt.NDArray[np.int64]

EPOCH = datetime.fromtimestamp(0, UTC)
DAY_NS = 86_400_000_000_000
MISSING = np.iinfo(np.int64).min
"""Time of an empty cell."""
_SEP = r"[-./]\s?"
_FRACTION = r"(?:[.,:](?P<f>\d{1,9})\d*)?"
_CLOCK = (
    rf"(?P<H>\d{{1,3}}):(?P<M>\d\d)(?::(?P<S>\d\d){_FRACTION})?"
    r"(?:\s*(?P<p>[AaPp])\.?\s?[Mm]\.?)?"
)
_MINUTES = r"(?P<M>\d{1,3}):(?P<S>\d\d)[.,](?P<f>\d{1,9})\d*"
_ZONE = r"(?:\s*(?:Z|UTC|GMT|(?P<z>[+-]\d\d:?(?:\d\d)?)))?"
_YMD = rf"(?P<y>\d{{4}}){_SEP}(?P<b>\d{{1,2}}){_SEP}(?P<c>\d{{1,2}})\.?"
_COMPACT = r"(?P<y>(?:19|20)\d\d)(?P<b>\d\d)(?P<c>\d\d)"
_TWO = rf"(?P<a>\d{{1,2}}){_SEP}(?P<b>\d{{1,2}}){_SEP}(?P<y>\d{{4}}|\d\d)"
_WORD = r"(?:[^\W\d]{2,10}\.?,?\s+)?(?P<a>\d{1,2})\.?[-./ ]+(?P<w>[^\W\d]{3,10})\.?[-./ ,]+(?P<y>\d{4}|\d\d)"
_US_WORD = r"(?:[^\W\d]{2,10}\.?,?\s+)?(?P<w>[^\W\d]{3,10})\.?\s+(?P<a>\d{1,2}),?\s+(?P<y>\d{4})"
_BETWEEN = r"(?:[T_,;]\s?|\s+(?:-\s)?|[:-])"
_COMPACT_CLOCK = r"(?P<H>\d\d)(?P<M>\d\d)(?P<S>\d\d)(?:[.,](?P<f>\d{1,9})\d*)?"
_DATES = {"ymd": _YMD, "compact": _COMPACT, "two": _TWO, "word": _WORD, "us_word": _US_WORD}
_PATTERNS = {name: re.compile(rf"\s*{date}\s*") for name, date in _DATES.items()}
_PATTERNS |= {
    f"{name}+clock": re.compile(rf"\s*{date}{_BETWEEN}{_CLOCK}{_ZONE}\s*") for name, date in _DATES.items()
}
_PATTERNS |= {"clock": re.compile(rf"\s*{_CLOCK}{_ZONE}\s*"), "minutes": re.compile(rf"\s*{_MINUTES}\s*")}
_PATTERNS |= {"compact+compact": re.compile(rf"\s*{_COMPACT}(?:[T_\s-]){_COMPACT_CLOCK}{_ZONE}\s*")}
_SHAPE = re.compile(
    r"\s*(?:[^\W\d]{2,10}\.?,?\s+)?"
    r"(?:\d{1,4}[-./:]|(?:19|20)\d{6}[T_ -]|[^\W\d]{3,10}\.?,?\s+\d|\d{1,2}\.?[- ]\s?[^\W\d]{3})"
)
"""Start of a date or time, except compact ones: a fast test that rejects most cells that are not times."""


@dataclass(frozen=True)
class TextTime:
    """Format of the cells of a column with dates, times of day, or both."""

    pattern: str
    """Key of the matching pattern."""
    order: Order = ""
    """Meaning of the first element of a date: day, month or year."""
    sure: bool = True
    """Whether the cells determine the order; otherwise the usual order is assumed."""

    @property
    def has_date(self) -> bool:
        """Whether the cells include the day."""
        return self.pattern not in ("clock", "minutes")

    @property
    def has_clock(self) -> bool:
        """Whether the cells include a time of day or an elapsed time."""
        return "+" in self.pattern or not self.has_date


def looks_like_time(cell: str) -> bool:
    """Whether a cell holds a date, a time of day, or both."""
    return bool(_SHAPE.match(cell)) and any(pattern.fullmatch(cell) for pattern in _PATTERNS.values())


def find_text_time(cells: Sequence[str], *, european: bool = False) -> TextTime | None:
    """Find the format of cells; None if no pattern fits all. If `european`, ambiguous dates start with the day."""
    filled = [cell for cell in cells if cell.strip()]
    if not filled:
        return None
    for name, pattern in _PATTERNS.items():
        if all(pattern.fullmatch(cell) for cell in filled):
            return _ordered(TextTime(name), filled, european=european)
    return None


def _ordered(found: TextTime, cells: Sequence[str], *, european: bool) -> TextTime:
    """Decide between day first and month first by a number above 12, by successive days, or by the usual order."""
    if not found.pattern.startswith("two"):
        return replace(found, order="y" if found.pattern.startswith(("ymd", "compact")) else "d")
    match = [_PATTERNS[found.pattern].fullmatch(cell) for cell in cells]
    first, second = ({int(each[part]) for each in match if each} for part in "ab")
    if max(first) > 12 or max(second) > 12:
        return replace(found, order="d" if max(first) > 12 else "m")
    if len(first | second) > 1 and (len(first) > 1) != (len(second) > 1):
        # The number that changes is the day: a trial lasts days, not months.
        return replace(found, order="d" if len(first) > 1 else "m")
    american = "/" in cells[0] and re.search(r"[AaPp]\.?\s?[Mm]\.?\s*$", cells[0]) and not european
    return replace(
        found, order="m" if american else "d", sure=bool(re.match(r"\s*\d{1,2}\.", cells[0])) or european
    )


def nanoseconds(cells: pa.Array, how: TextTime) -> Nanoseconds:
    """Nanoseconds since 1970, or since midnight without dates; ValueError (row in `cells`, cell) if a cell does not fit."""
    cells = pc.utf8_trim_whitespace(cells)
    empty = pc.or_kleene(cells.is_null(), pc.equal(cells, "")).to_numpy(zero_copy_only=False)
    # Arrow's regular expressions name the class of letters of all languages differently.
    parts = pc.extract_regex(cells, f"^(?:{_PATTERNS[how.pattern].pattern})$".replace(r"[^\W\d]", r"\pL"))
    fits = parts.is_valid().to_numpy(zero_copy_only=False)
    if not (fits | empty).all():
        _refuse(cells, ~(fits | empty))
    names = {field.name for field in parts.type}

    def number(name: str) -> Nanoseconds:
        if name not in names:
            return np.zeros(len(cells), dtype=np.int64)
        digits = pc.if_else(pc.equal(pc.fill_null(parts.field(name), ""), ""), "0", parts.field(name))
        return np.asarray(pc.fill_null(digits.cast(pa.int64()), 0).to_numpy(zero_copy_only=False))

    hour, minute, second = number("H"), number("M"), number("S")
    wrong = (second > 60) | ((minute > 59) & ("H" in names))
    if "p" in names:
        half = pc.utf8_lower(pc.fill_null(parts.field("p"), "")).to_numpy(zero_copy_only=False)
        wrong |= (half != "") & ((hour < 1) | (hour > 12))
        hour = np.where(half == "", hour, hour % 12 + np.where(half == "p", 12, 0))
    if wrong.any():
        _refuse(cells, wrong)
    value = ((hour * 60 + minute) * 60 + second) * 1_000_000_000
    if "f" in names:
        fraction = pc.utf8_rpad(pc.fill_null(parts.field("f"), ""), 9, "0").cast(pa.int64())
        value += fraction.to_numpy(zero_copy_only=False)
    if "z" in names:
        value -= _of_each(parts.field("z"), lambda zone: _zone(zone) * 60_000_000_000)
    if "y" in names:
        keys = [parts.field(name) for name in "yabcw" if name in names]
        told = [name for name in "yabcw" if name in names]
        joined = pc.binary_join_element_wise(*keys, "/") if len(keys) > 1 else keys[0]
        days = _of_each(joined, lambda text: _day(dict(zip(told, text.split("/"), strict=True)), how.order))
        if (days == MISSING).any():
            _refuse(cells, (days == MISSING) & ~empty)
        value += np.where(empty, 0, days) * DAY_NS
    value[empty] = MISSING
    return value


def _refuse(cells: pa.Array, wrong: npt.NDArray[np.bool_]) -> None:
    row = int(np.flatnonzero(wrong)[0])
    raise ValueError(row, cells[row].as_py())


def _of_each(texts: pa.Array, function: Callable[[str], int]) -> Nanoseconds:
    """Apply a function to each text, once per distinct text."""
    coded = pc.fill_null(texts, "").dictionary_encode()
    values = np.array(
        [function(text) if text else 0 for text in coded.dictionary.to_pylist()], dtype=np.int64
    )
    return np.asarray(values[coded.indices.to_numpy()])


def _zone(text: str) -> int:
    """Minutes east of Greenwich."""
    digits = text[1:].replace(":", "").ljust(4, "0")
    return (-1 if text[0] == "-" else 1) * (int(digits[:2]) * 60 + int(digits[2:]))


def _day(part: dict[str, str], order: Order) -> int:
    """Days since 1970; `MISSING` if the date does not exist."""
    if not part["y"]:
        return 0
    year = int(part["y"])
    year += (2000 if year < 70 else 1900) if year < 100 else 0
    if "w" in part:
        word = part["w"].lower()
        month = next((MONTHS[word[:size]] for size in (5, 4, 3) if word[:size] in MONTHS), 0)
        day = int(part["a"])
    elif "c" in part:
        month, day = int(part["b"]), int(part["c"])
    else:
        one, two = int(part["a"]), int(part["b"])
        month, day = (one, two) if order == "m" else (two, one)
    try:
        return date(year, month, day).toordinal() - EPOCH.toordinal()
    except ValueError:
        return int(MISSING)


Cells = Callable[[str], Iterator[pa.Array]]
"""Function (column) that yields the column's cells in blocks; corresponding blocks of all columns have the same
length.
"""


@dataclass(frozen=True)
class TimePlan:
    """Interpretation of a table's time: columns, their formats (None for numbers), scale, offset and origin."""

    keys: tuple[str, ...]
    name: str
    how: tuple[TextTime | None, ...] = (None,)
    factor: float = 1.0
    offset: float = 0.0
    zero: datetime | None = None
    note: str = ""
    packed: bool = False
    """Whether each number is a time of day hhmmss.s, such as 100059.5."""

    @property
    def dated(self) -> bool:
        """Whether the cells include the day, not just the time of day."""
        return self.how[0] is None or any(how and how.has_date for how in self.how)

    def seconds(self, path: object, cells: Cells) -> Iterator[Array]:
        """Yield the times of all rows [s] since `zero`; NaN for empty cells."""
        state = _Rollover()
        row = 0
        for parts in zip(*(cells(key) for key in self.keys), strict=True):
            told = self.stamps(path, parts, row)
            if told is None:
                yield self._numbers(parts[0], state)
            elif self.dated:
                base = 0 if self.zero is None else (self.zero - EPOCH) // timedelta(microseconds=1) * 1000
                yield np.where(told == MISSING, np.nan, (told - base) * 1e-9)
            else:
                yield state.unrolled(told)
            row += len(parts[0])

    def stamps(self, path: object, parts: Sequence[pa.Array], row: int = 0) -> Nanoseconds | None:
        """Nanoseconds since 1970 (without date since midnight), `MISSING` for empty cells; None if the cells are numbers."""
        if self.how[0] is None:
            kind = parts[0].type
            if not pa.types.is_timestamp(kind):
                return None
            whole = parts[0].cast(pa.timestamp("ns", tz=kind.tz), safe=False).cast(pa.int64())
            return np.asarray(whole.fill_null(int(MISSING)).to_numpy(zero_copy_only=False))
        try:
            formats = zip(parts, self.how, strict=True)
            told = [nanoseconds(part.cast(pa.string()), how) for part, how in formats if how]
        except ValueError as error:
            if len(error.args) != 2:
                raise
            at, cell = error.args
            raise InputError(
                f"{path}: time column {self.name!r}: record {row + int(at) + 1} has {cell!r}, expected a time in the "
                "format of the previous records"
            ) from None
        missing = np.logical_or.reduce([part == MISSING for part in told])
        return np.where(missing, MISSING, np.sum(told, axis=0))

    def _numbers(self, values: pa.Array, state: _Rollover) -> Array:
        if self.packed:
            seconds = np.asarray(values.cast(pa.float64()).to_numpy(zero_copy_only=False))
            known = np.where(np.isfinite(seconds), seconds, 0.0)
            told = np.rint(((known // 1e4) * 3600 + (known // 100 % 100) * 60 + known % 100) * 1e9)
            return state.unrolled(np.where(np.isfinite(seconds), told.astype(np.int64), MISSING))
        if pa.types.is_integer(values.type) and self.offset:
            zero = int(self.offset)
            whole = values.cast(pa.int64()).fill_null(zero).to_numpy(zero_copy_only=False)
            seconds = (whole - zero) * self.factor
            if values.null_count:
                seconds[values.is_null().to_numpy(zero_copy_only=False)] = np.nan
            return np.asarray(seconds)
        numbers = values.to_numpy(zero_copy_only=False).astype(np.float64)
        return np.asarray((numbers - self.offset) * self.factor if self.offset else numbers * self.factor)


@dataclass
class _Rollover:
    """Conversion of times of day to times that continue across midnight, for successive blocks."""

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
