"""Runs the code of a page of the documentation, in order and in one folder, as a reader would who copies it."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import sys
import tempfile
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

RUN = ("python", "sh", "toml")
LEANING = ("bash", "", "py")
"""Commands, fenced or indented, and Python that lean on a network, a cluster or a file of yours: only the tests run them."""
SHOWN = ("text", "{toctree}", "{eval-rst}", "{include}", "{literalinclude}")
"""Languages that nobody runs: output, and the site's own."""


def blocks(page: Path) -> list[tuple[str, str, int]]:
    """Return language, text and first line of every block of code of a Markdown page, fenced or indented."""
    tokens = MarkdownIt().parse(page.read_text(encoding="utf-8"))
    return [
        (
            token.info.partition(" ")[0],
            token.content,
            (token.map or [0])[0] + (2 if token.type == "fence" else 1),
        )
        for token in tokens
        if token.type in ("fence", "code_block")
    ]


def commands(text: str) -> list[str]:
    """Return the lines of a block of commands, those joined that a backslash continues."""
    return [line for line in text.replace("\\\n", " ").split("\n") if line.strip()]


def shipfp(command: str) -> None:
    """Run one of the package's own commands; RuntimeError where it is none or ends badly."""
    from shipfp_rs import cli

    program, *arguments = shlex.split(command, comments=True)
    if program != "shipfp" or cli.main(arguments) != 0:
        raise RuntimeError(f"{command!r} failed")


def run_page(page: Path, folder: Path, command: Callable[[str], None] | None = None) -> str:
    """Run a page's Python and its shipfp commands in `folder`, write its TOML files there, and return what was printed.

    A block of TOML opens with its file name as a comment; what a command refuses, or Python raises, ends the run.
    `command` is given every line of commands, those too that can't be run by themselves. What Python prints must stand
    below it, in a block of text; `AssertionError` if it is missing, or differs by more than the noise of its numbers.
    """
    found = outputs(page, folder, command)
    for line, printed, shown in found:
        assert alike(printed, shown), (
            f"{page}:{line}: prints\n{printed}\nbut shows\n{shown}\nTo bring it up to date: python docs/page_code.py PAGE"
        )
    return "".join(printed for _, printed, _ in found)


def outputs(
    page: Path, folder: Path, command: Callable[[str], None] | None = None
) -> list[tuple[int, str, str]]:
    """Run a page; return the last line of each block of Python, what it printed, and the block of text below it."""
    names: dict[str, Any] = {"__name__": "__main__"}
    found, every = [], blocks(page)
    lines = page.read_text(encoding="utf-8").splitlines()
    with contextlib.chdir(folder):
        for index, (language, text, line) in enumerate(every):
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                if language == "python" or (language == "py" and command is not None):
                    # Empty lines in front make a traceback name the page's own line.
                    exec(compile("\n" * (line - 1) + text, str(page), "exec"), names)
                elif language == "toml":
                    Path(text.split("\n", 1)[0].removeprefix("# ")).write_text(
                        text, encoding="utf-8"
                    )
                elif language == "sh" or (language in LEANING and command is not None):
                    for typed in commands(text):
                        (command or shipfp)(typed)
            end = line + text.count("\n")
            below = every[index + 1] if index + 1 < len(every) else ("", "", 0)
            beside = below[0] == "text" and not "".join(lines[end : below[2] - 2]).strip()
            if language == "python":
                found.append((end, printed.getvalue(), below[1] if beside else ""))
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")  # what a page does not save again no other page needs
    return found


NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
NOISE = 0.05
"""Largest relative difference, or twice this many units of the last place, of a number that another machine may print."""


def alike(printed: str, shown: str) -> bool:
    """Whether two outputs have the same words, in any lines, and numbers that differ by noise alone."""
    one, other = (NUMBER.split(text) for text in (printed, shown))
    if ["".join(part.split()) for part in one] != ["".join(part.split()) for part in other]:
        return False
    pairs = zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True)
    return all(_near(a, b) for a, b in pairs)


def _near(a: str, b: str) -> bool:
    places = max(len(number.partition(".")[2]) for number in (a, b))
    last = 2.0 * 10.0**-places if places else 0.0
    return abs(float(a) - float(b)) <= max(NOISE * abs(float(b)), last)


WIDEST = 96


def _wrapped(printed: str) -> str:
    """Output whose sentences are broken where the column of a page ends; tables stay as they are."""
    lines = []
    for line in printed.rstrip("\n").split("\n"):
        sentence = len(line) > WIDEST and "   " not in line.strip()
        lines += textwrap.wrap(line, WIDEST) if sentence else [line.rstrip()]
    return "\n".join(lines) + "\n"


def bring_up_to_date(page: Path) -> None:
    """Run a page and write below each block of Python what it prints."""
    with tempfile.TemporaryDirectory() as folder:
        found = outputs(page, Path(folder))
    lines = page.read_text(encoding="utf-8").splitlines()
    for end, printed, shown in reversed(found):
        if alike(printed, shown):
            continue
        after = lines.index("```", lines.index("```text", end)) + 1 if shown else end
        below = ["", "```text", *_wrapped(printed).splitlines(), "```"] if printed else []
        lines[end:after] = below
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        bring_up_to_date(Path(name).resolve())
