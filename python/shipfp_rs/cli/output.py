"""What the subcommands print: tables and JSON on stdout, progress on stderr."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from shipfp_rs.identification.estimate import Estimate
    from shipfp_rs.identification.fingerprint import Fingerprint

PIPE_WIDTH = 200
"""Width of a table that is not shown on a terminal, so large that nothing is cut."""


def print_json(content: Any) -> None:
    """Print one JSON document."""
    from shipfp_rs.support.json_files import json_text

    print(json_text(content, ascii_only=False), end="")


def print_text(*lines: str) -> None:
    """Print lines as they are, wrapped to the terminal only."""
    console = _console()
    for line in lines:
        console.print(line, soft_wrap=not sys.stdout.isatty())


def print_table(title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table; the first column is text, the others are figures."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    for index, name in enumerate(head):
        table.add_column(
            name, justify="right" if index else "left", overflow="fold", no_wrap=not sys.stdout.isatty()
        )
    for row in rows:
        table.add_row(*row)
    _console().print(table)


def print_fingerprint(
    fingerprint: Fingerprint, truth: Mapping[str, float] | None = None, title: str | None = None
) -> None:
    """Print estimates with their 95 % intervals, beside the truth where it is known, and the verdict."""
    title = title or f"Fingerprint of {fingerprint.vessel or 'a drive train not named'}"
    print_estimates(title, {**fingerprint.parameters, **fingerprint.derived}, truth)
    print_text(*fingerprint.verdict)


def print_estimates(
    title: str, estimates: Mapping[str, Estimate], truth: Mapping[str, float] | None = None
) -> None:
    """Print a table of estimates, beside the truth where it is known."""
    from shipfp_rs.identification.estimate import rounded_rows

    print_table(
        title,
        ["parameter", *(["truth"] if truth else []), "estimate", "95 % from", "to", "unit", "status"],
        [
            [row.name, *([row.truth] if truth else []), row.value, row.low, row.high, row.unit, row.status]
            for row in rounded_rows(estimates, truth)
        ],
    )


def _console() -> Console:
    # Markup off: a file or an experiment may well be called "[red]".
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    return Console(markup=False, highlight=False, emoji=False, width=width)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Give a function that shows what is being done: a spinner on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Console(stderr=True, markup=False).status("") as status:
        yield status.update
