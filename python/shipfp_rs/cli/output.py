"""Output of subcommands: tables and JSON on stdout, progress on stderr."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from shipfp_rs.identification.estimate import Estimate
    from shipfp_rs.identification.fingerprint import Fingerprint

PIPE_WIDTH = 200
"""Line width outside a terminal; wider tables are not wrapped."""
GAP = 3
"""Characters between columns, and around the table."""


def print_json(content: Any) -> None:
    """Print one JSON document."""
    from shipfp_rs.support.json_files import json_text

    print(json_text(content, ascii_only=False), end="")


def print_results(content: Any, show: Callable[[], None], out: Path | None = None, *, json: bool) -> None:
    """Print results as JSON, or as text with the folder they were written to."""
    if json:
        print_json(content)
        return
    show()
    if out is not None:
        print_text(f"wrote {out}")


def print_text(*lines: str) -> None:
    """Print lines unchanged, wrapped only on a terminal."""
    console = _console()
    for line in lines:
        console.print(line, soft_wrap=not sys.stdout.isatty())


def print_table(title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table; the first column is text, the others are numbers.

    On a terminal too narrow for all columns, the remaining ones follow below, with the first one repeated.
    """
    lines = [[*head], *([*row] for row in rows)]
    widths = [max(cell_len(cell) for cell in column) + GAP for column in zip(*lines, strict=True)]
    console = _console(sum(widths) + GAP)
    if sum(widths) + GAP > console.width:
        widths[0] = min(widths[0], console.width // 3)
    if title:  # outside the table, which would wrap it to its own width
        console.print(title, style="bold")
    for columns in _that_fit(widths, console.width - GAP):
        table = Table(box=box.SIMPLE_HEAD)
        for index in columns:
            table.add_column(
                lines[0][index],
                justify="right" if index else "left",
                overflow="fold",
                max_width=widths[index] - GAP,
            )
        for row in lines[1:]:
            table.add_row(*(row[index] for index in columns))
        console.print(table)


def _that_fit(widths: Sequence[int], room: int) -> list[list[int]]:
    """Columns of each table that fits in the width, each with the first column."""
    tables, left = [[0]], room - widths[0]
    for index, width in enumerate(widths[1:], 1):
        if width > left and len(tables[-1]) > 1:
            tables.append([0])
            left = room - widths[0]
        tables[-1].append(index)
        left -= width
    return tables


def print_fingerprint(
    fingerprint: Fingerprint, truth: Mapping[str, float] | None = None, title: str | None = None
) -> None:
    """Print estimates with their 95 % intervals, beside the truth if known, and the verdict."""
    title = title or f"Fingerprint of {fingerprint.vessel or 'a drive train not named'}"
    print_estimates(title, {**fingerprint.parameters, **fingerprint.derived}, truth)
    print_text(*fingerprint.verdict)


def print_estimates(
    title: str, estimates: Mapping[str, Estimate], truth: Mapping[str, float] | None = None
) -> None:
    """Print a table of estimates, beside the truth if known."""
    from shipfp_rs.identification.estimate import rounded_rows
    from shipfp_rs.support.units import unit_shown

    print_table(
        title,
        ["parameter", *(["truth"] if truth else []), "estimate", "95 % from", "to", "unit", "status"],
        [
            [
                row.name,
                *([row.truth] if truth else []),
                row.value,
                row.low,
                row.high,
                unit_shown(row.unit) or "-",
                row.status,
            ]
            for row in rounded_rows(estimates, truth)
        ],
    )


def _console(needed: int = 0) -> Console:
    # Markup off, since a file or an experiment may be called "[red]".
    width = None if sys.stdout.isatty() else max(PIPE_WIDTH, needed)
    return Console(markup=False, highlight=False, emoji=False, width=width)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Function that shows the current activity: a spinner on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Console(stderr=True, markup=False).status("") as status:
        yield status.update
