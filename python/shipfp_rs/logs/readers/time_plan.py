"""How the cells of a table's time columns become seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers import text_time
from shipfp_rs.logs.readers.text_time import DAY_NS, MISSING, TextTime

Array = npt.NDArray[np.float64]
Cells = Callable[[str], Iterator[pa.Array]]
"""Column to its cells, block by block, all columns in blocks of the same lengths."""


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
            return _from_zero(stamps_ns(values), self.zero)
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


def stamps_ns(values: pa.Array) -> npt.NDArray[np.int64]:
    """Return timestamps [ns since 1970], `MISSING` where a cell is empty."""
    whole = values.cast(pa.timestamp("ns", tz=values.type.tz), safe=False).cast(pa.int64())
    return np.asarray(whole.fill_null(int(MISSING)).to_numpy(zero_copy_only=False))


def _from_zero(told: npt.NDArray[np.int64], zero: datetime | None) -> Array:
    base = (
        0 if zero is None else (zero - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    )
    return np.where(told == MISSING, np.nan, (told - base) * 1e-9)
