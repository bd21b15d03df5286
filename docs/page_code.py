"""Runs the code of a page of the documentation, in order and in one folder, as a reader would who copies it."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path
from typing import Any

RUN = ("python", "sh", "toml")
SHOWN = ("text", "bash", "{toctree}", "{eval-rst}")
"""Languages that are not run: output, the site's own, and commands that need a network, a cluster or a file of yours."""
_FENCE = re.compile(r"^```([\w{}-]*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str, int]]:
    """Return language, text and first line of every fenced block of a Markdown page."""
    text = page.read_text(encoding="utf-8")
    return [(found[1], found[2], text.count("\n", 0, found.start()) + 2) for found in _FENCE.finditer(text)]


def run_page(page: Path, folder: Path) -> str:
    """Run a page's Python and its shipfp commands in `folder`, write its TOML files there, and return what was printed.

    A block of TOML opens with its file name as a comment; what a command refuses, or Python raises, ends the run.
    """
    from shipfp_rs import cli

    names: dict[str, Any] = {"__name__": "__main__"}
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        for language, text, line in blocks(page):
            if language == "python":
                # Empty lines in front make a traceback name the page's own line.
                exec(compile("\n" * (line - 1) + text, str(page), "exec"), names)
            elif language == "toml":
                Path(text.split("\n", 1)[0].removeprefix("# ")).write_text(text, encoding="utf-8")
            elif language == "sh":
                for command in filter(None, text.replace("\\\n", " ").split("\n")):
                    program, *arguments = shlex.split(command, comments=True)
                    if program != "shipfp" or cli.main(arguments) != 0:
                        raise RuntimeError(f"{page}:{line}: {command!r} failed")
    return printed.getvalue()
