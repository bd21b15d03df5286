"""Status columns of a historian's table: for each value, a column beside it says whether it is good."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shipfp_rs.logs.channel import BLOCK, Blocks, Samples
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.readers.time_cells import is_date, is_time
from shipfp_rs.support.arrays import runs
from shipfp_rs.support.sentences import Sentence

Batches = Callable[[str, int, int], Iterator[pa.Array]]
"""Function (column, first row, size) that yields the values from the first row on, in arrays of at most `size`."""
Statuses = Mapping[str, tuple[str, pa.Array]]
"""Status column of each column of values, and the cells of it that mean "bad"."""
MOST_CODES = 16
"""Largest number of different cells in the status columns of a table."""
QUALITY = re.compile(r"(good|uncertain|bad)\b", re.IGNORECASE)
"""First words of a quality in OPC Data Access; a bad value counts as missing."""
GOOD_DA, SEVERITY_DA = 192, 0xC0
"""Code of good quality, and mask of the bits that are zero in a bad quality (OPC Data Access 3.0, 6.8)."""
UNCERTAIN_UA = 1
"""Upper two bits of an uncertain status (OPC 10000-4, 7.39); they are zero in a good status."""


def is_value(kind: pa.DataType) -> bool:
    """Whether a column of this type may hold values: numbers, but not booleans."""
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def find_statuses(schema: Sequence[pa.Field], names: Mapping[str, str], batches: Batches) -> Statuses:
    """Find the status column of each column of values; empty if no column has one."""
    # A status column is named like its column of values, or like their tag, with the same ending throughout the table.
    # Its cells are a few words or codes, of which the usual one is good; unless OPC's words, most values need such a column.
    plain = {field.name: name for name, key in names.items() for field in schema if field.name == key}
    kinds = {field.name: field.type for field in schema}
    numbers = [
        key for key, name in plain.items() if is_value(kinds[key]) and not (is_time(name) or is_date(name))
    ]
    codes = [
        key
        for key in plain
        if (pa.types.is_integer(kinds[key]) or pa.types.is_string(kinds[key])) and plain[key] == key
    ]
    groups: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    for value in numbers:
        name = plain[value]
        for stem in {name, re.sub(r"[^\W_]+$", "", name)} - {""}:
            for key in codes:
                end = key.removeprefix(stem)
                if key != value and key != end and re.search(r"[^\W\d]", end):
                    groups[name.removeprefix(stem), end][value] = key
    for pairs in sorted(groups.values(), key=len, reverse=True):
        most = len(pairs) > 1 and 2 * len(pairs) > len(set(numbers) - set(pairs.values()))
        found: Counter[Any] = Counter()
        for part in (part for key in pairs.values() for part in batches(key, 0, BLOCK)):
            counts = pc.value_counts(part)[: MOST_CODES + 1].to_pylist()
            found.update({each["values"]: each["counts"] for each in counts})
            if len(found) > MOST_CODES:
                break
        else:
            if (bad := _bad(found, most)) is not None:
                cells = pa.array(
                    bad, pa.string() if any(isinstance(one, str) for one in found) else pa.int64()
                )
                return {value: (key, cells) for value, key in pairs.items()}
    return {}


def _bad(found: Counter[Any], most: bool) -> list[Any] | None:
    """Cells that mean "bad"; None if the cells are not a status."""
    told = [cell for cell in found if cell is not None]
    words = [cell for cell in told if isinstance(cell, str)]
    if told and len(words) == len(told) and all(map(QUALITY.match, words)):
        return [word for word in words if word.lower().startswith("bad")]
    usual = found.most_common(1)[0][0] if most and found else None
    if usual is None or 0 < len(words) < len(told):
        return None
    if words:
        return [word for word in words if word != usual]
    if usual == GOOD_DA:
        return [code for code in told if not code & SEVERITY_DA]
    return [code for code in told if code and code >> 30 != UNCERTAIN_UA] if usual == 0 else None


def without_bad(batches: Batches, statuses: Statuses) -> Batches:
    """Wrap `Batches` so that values with a bad status become gaps."""

    def read(column: str, first: int, size: int) -> Iterator[pa.Array]:
        if column not in statuses:
            yield from batches(column, first, size)
            return
        key, bad = statuses[column]
        for values, cells in zip(batches(column, first, size), batches(key, first, size), strict=True):
            yield pc.if_else(_are(cells, bad), pa.scalar(None, values.type), values)

    return read


def _are(cells: pa.Array, bad: pa.Array) -> pa.Array:
    return pc.is_in(cells.cast(bad.type), value_set=bad)


def status_faults(
    batches: Batches, statuses: Statuses, column: str, channel: str, on_grid: Callable[[Blocks], Blocks]
) -> tuple[Fault, ...]:
    """Fault of the samples of a channel whose status is bad."""
    if column not in statuses:
        return ()
    key, bad = statuses[column]

    def flags(_: str, first: int, size: int) -> Iterator[Samples]:
        for cells in batches(key, first, size):
            yield np.asarray(_are(cells, bad).cast(pa.float64()))

    spans = runs(np.concatenate([np.empty(0), *on_grid(flags)(channel, 0, BLOCK)]) > 0.0)
    count = int(np.diff(spans).sum())
    method = Sentence("missing: the status of {count} values is bad", count=str(count))
    return (Fault("gap", channel, method, spans, excluded=False),) if count else ()
