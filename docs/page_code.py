"""Runs the code of a page of the documentation, in order and in one folder, as a reader would who copies it."""

from __future__ import annotations

import contextlib
import io
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

RUN = ("python", "sh", "toml")
LEANING = ("bash", "", "py")
"""Commands, fenced or indented, and Python that lean on a network, a cluster or a file of yours: only the tests run them."""
SHOWN = ("text", "{toctree}", "{eval-rst}")
"""Languages that nobody runs: output, and the site's own."""


def blocks(page: Path) -> list[tuple[str, str, int]]:
    """Return language, text and first line of every block of code of a Markdown page, fenced or indented."""
    tokens = MarkdownIt().parse(page.read_text(encoding="utf-8"))
    return [
        (token.info, token.content, (token.map or [0])[0] + (2 if token.type == "fence" else 1))
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
    `command` is given every line of commands, those too that can't be run by themselves.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        for language, text, line in blocks(page):
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
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")  # what a page does not save again no other page needs
    return printed.getvalue()
