"""Options shared by several subcommands, and limits of numbers, names and paths."""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from shipfp_rs.errors import InputError
from shipfp_rs.support.checks import is_one_line
from shipfp_rs.support.languages import LANGUAGES

LARGEST, SMALLEST = 1e15, 1e-15
MOST_SEED = 2**63 - 1
MOST_DRAWS = 10_000
MOST_WORKERS = 1024
LONGEST_NAME, LONGEST_PATH = 255, 4095
"""Longest name and path in bytes."""


def a_path(text: str | Path) -> Path:
    """Parse a path; reject one that no file can have."""
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
    """Name of a file to write; existing files, except devices, are rejected without --force."""
    if path.is_file() and not force:
        raise InputError(f"{path}: exists already; choose another name, or --force to replace it")
    return path


def folder_for(
    out: Path | None, marker: str, others: Sequence[str], *, force: bool = False
) -> AbstractContextManager[Path | None]:
    """Folder for results, written atomically; None if none is wanted."""
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
        # Escaped, since help would take it for markup.
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
