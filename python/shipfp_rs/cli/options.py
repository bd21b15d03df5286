"""Options, checks of numbers, names and paths, and output to stdout and stderr, used by all subcommands."""

from __future__ import annotations

import contextlib
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import is_one_line
from shipfp_rs.support.sentences import LANGUAGES

if TYPE_CHECKING:
    from shipfp_rs.identification.estimate import Estimate
    from shipfp_rs.identification.fingerprint import Fingerprint


LARGEST, SMALLEST = 1e15, 1e-15
MOST_SEED = 2**63 - 1
MOST_DRAWS = 10_000
MOST_WORKERS = 1024
LONGEST_NAME, LONGEST_PATH = 255, 4095
"""Longest file name, and longest path [bytes]."""


def a_path(text: str | Path) -> Path:
    """Parse a path; reject a path that no file can have."""
    typed = str(text)
    if not typed:
        raise typer.BadParameter("found nothing, expected the name of a file or folder")
    if not is_one_line(os.fsencode(typed).decode(errors="replace")):
        raise typer.BadParameter(f"found {typed[:60]!r}, expected a name without control characters")
    parts = [len(os.fsencode(part)) for part in Path(typed).parts]
    if max(parts, default=0) > LONGEST_NAME or len(os.fsencode(typed)) > LONGEST_PATH:
        raise typer.BadParameter(
            f"found a name of {len(typed)} characters, expected at most {LONGEST_NAME} for each file or folder"
        )
    return Path(typed)


def vessels(incomplete: str) -> list[str]:
    """Names of built-in ships with this beginning, for completion in a shell."""
    from shipfp_rs.vessel.vessel import Vessel

    return [name for name in Vessel.names() if name.startswith(incomplete)]


def a_language(text: str) -> str:
    """Parse a language of reports."""
    if text not in LANGUAGES:
        raise typer.BadParameter(f"found {text[:60]!r}, expected one of {', '.join(LANGUAGES)}")
    return text


def _number(refuses: Callable[[float], bool], expected: str) -> Callable[[str | float], float]:
    def parsed(text: str | float) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST or refuses(value):
            raise typer.BadParameter(f"found {str(text)[:60]!r}, expected {expected}")
        return value

    return parsed


positive = _number(lambda value: value <= 0.0, "a positive number")
not_negative = _number(lambda value: value < 0.0, "zero or a positive number")
probability = _number(lambda value: not 0.0 < value < 1.0, "a probability between 0 and 1")


@contextlib.contextmanager
def as_typed(options: Mapping[str, str]) -> Iterator[None]:
    """Replace names of Python arguments in errors by options: {"duration_s": "--duration"}."""
    try:
        yield
    except InputError as error:
        message = str(error)
        for name, typed in options.items():
            message = re.sub(rf"(?<![\w.-]){re.escape(name)}(?![\w(])", typed, message)
        raise InputError(message) from error


def new_file(path: Path, *, force: bool) -> Path:
    """Check the name of a file to write; existing files, except devices, are rejected without --force."""
    if path.is_file() and not force:
        raise InputError(f"{path}: exists already; choose another name, or --force to replace it")
    return path


def folder_for(
    out: Path | None, marker: str, others: Sequence[str], *, force: bool = False
) -> AbstractContextManager[Path | None]:
    """Folder for results, written atomically; None without `out`."""
    from shipfp_rs.support.files import replacing_folder

    if out is None:
        return nullcontext()
    return replacing_folder(out, marker=marker, others=others, force=force)


def number_option(
    metavar: str, told: str, parser: Callable[[str | float], float] = positive, *names: str
) -> Any:
    """Declare an option with a number, positive unless another parser is given."""
    return typer.Option(*names, parser=parser, metavar=metavar, help=told)


def file_argument(metavar: str, told: str) -> Any:
    """Declare an argument with a path."""
    return typer.Argument(metavar=metavar, parser=a_path, help=told, show_default=False)


def file_option(metavar: str, told: str, *names: str) -> Any:
    """Declare an option with a path."""
    return typer.Option(*names, metavar=metavar, parser=a_path, help=told)


Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON, and nothing else, on stdout.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=MOST_SEED, help="Seed of everything that is drawn.")]
Force = Annotated[
    bool, typer.Option("--force", help="Write into a folder that holds other files, too; these stay.")
]
Replace = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
OtherSeed = Annotated[
    int | None, typer.Option("--seed", min=0, max=MOST_SEED, help="Seed in place of the file's.")
]
OutFolder = Annotated[
    Path, file_option("DIR", "Folder to write; it appears only when the run is complete.", "--out")
]
LogFile = Annotated[Path, file_argument("LOG", "Log in any supported format.")]
TrialFile = Annotated[Path, file_argument("TRIAL.toml", "Description of the trial.")]

Time = Annotated[
    str | None,
    typer.Option(
        "--time",
        metavar="COLUMN",
        # Escaped, since the help's renderer interprets square brackets as markup.
        help=r"Column of time, where it is not found: 'COLUMN', 'COLUMN \[ms]', 'DATE \[d.m.y] + CLOCK'.",
    ),
]
Names = Annotated[
    Path | None, file_option("FILE", "DBC of a CAN log, or channel list of ISO 19848.", "--names")
]
Rate = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", parser=positive, help="Sample rate, where the log holds none."),
]


PIPE_WIDTH = 200
"""Line width outside a terminal; wider tables are not wrapped."""
GAP = 2
"""Characters between columns, and around the table."""


REPORT = "report.html"


def print_results(content: Any, show: Callable[[], None], out: Path | None = None, *, json: bool) -> None:
    """Print results as JSON, or as text that ends with the path of the folder written or of the report in it."""
    if json:
        from shipfp_rs.support.files import json_text

        print(json_text(content, ascii_only=False), end="")
        return
    show()
    if out is not None:
        report = out / REPORT
        print_text(f"Open {report} in a browser." if report.is_file() else f"wrote {out}")


def print_text(*lines: str) -> None:
    """Print lines unchanged, wrapped only on a terminal."""
    console = _console()
    for line in lines:
        console.print(line, soft_wrap=not sys.stdout.isatty())


def print_table(title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table; the first column is text, the others are numbers.

    If the terminal is too narrow for all columns, the table is divided; each piece repeats the first column.
    """
    lines = [[*head], *([*row] for row in rows)]
    widths = [max(cell_len(cell) for cell in column) + GAP for column in zip(*lines, strict=True)]
    console = _console(sum(widths) + GAP)
    if sum(widths) + GAP > console.width:
        widths[0] = min(widths[0], console.width // 3)
    if title:  # as a separate text: the table would wrap the title to its own width
        console.print(title, style="bold")
    for columns in _that_fit(widths, console.width - GAP):
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
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
    """Groups of columns into which a table wider than the terminal is divided; each starts with the first column."""
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
    """Print estimates with 95 % intervals, the true values if known, and the verdict."""
    title = title or f"Fingerprint of {fingerprint.vessel or 'a drive train not named'}"
    print_estimates(title, {**fingerprint.parameters, **fingerprint.derived}, truth)
    print_text(*fingerprint.verdict)


def print_estimates(
    title: str, estimates: Mapping[str, Estimate], truth: Mapping[str, float] | None = None
) -> None:
    """Print a table of estimates, with the true values if known; letters refer to footnotes on how values were obtained."""
    from shipfp_rs.identification.estimate import STATUS, rounded_rows
    from shipfp_rs.support.units import unit_shown

    rows = [*rounded_rows(estimates, truth)]
    usual = STATUS["free"]
    marks, notes = footnotes("" if row.status == usual else row.status for row in rows)
    table = []
    for row, mark in zip(rows, marks, strict=True):
        true = [row.truth and _zero(row.truth)] if truth else []
        figures = (_least(row.value, row.low, row.high), _zero(row.low), row.high)
        table.append([row.name, *true, *figures, unit_shown(row.unit) or "-", mark])
    head = ["parameter", *(["truth"] if truth else []), "estimate", "95 % from", "to", "unit", ""]
    print_table(title, head, table)
    print_text(*notes)


def footnotes(texts: Iterable[str]) -> tuple[list[str], list[str]]:
    """Letters of footnotes, one for each text (empty for an empty text), and the footnotes' lines."""
    texts = list(texts)
    letters = {text: chr(ord("a") + place) for place, text in enumerate(dict.fromkeys(filter(None, texts)))}
    return [letters.get(text, "") for text in texts], [
        f"{letter}  {text}" for text, letter in letters.items()
    ]


def _zero(number: str) -> str:
    """A rounded number; any zero becomes "0"."""
    return number if number.strip("-0.") or not number else "0"


def _least(value: str, low: str, high: str) -> str:
    """A rounded estimate; if it and the interval's lower end are zero, the upper end as a limit, "< high"."""
    return f"< {high}" if "0" == _zero(value) == _zero(low) and high and _zero(high) != "0" else _zero(value)


def _console(needed: int = 0) -> Console:
    # Markup off, since a file or an experiment may be called "[red]".
    width = None if sys.stdout.isatty() else max(PIPE_WIDTH, needed)
    return Console(markup=False, highlight=False, emoji=False, width=width)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the current activity: a spinner on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Console(stderr=True, markup=False).status("") as status:
        yield status.update
