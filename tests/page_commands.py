"""What a page has its reader type: run, or where it asks for more than a test has, checked by the program's own parser."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import shlex
import subprocess
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from page_code import shipfp

from shipfp_rs import cli

ROOT = Path(__file__).parents[1]
CI = "".join((ROOT / ".ci" / name).read_text(encoding="utf-8") for name in ("run", "nightly"))

NOT_HERE = ("--address", "sweep duration", "shipfp demo", "shipfp view")
"""A cluster of the reader's; hundreds of trials of eight minutes; what `.ci/run` runs on its own; a page until Ctrl-C."""


def type_in(command: str) -> None:
    """Do, in the current folder, what a reader would; AssertionError or RuntimeError where it can't be right."""
    words = shlex.split(command.rstrip("& "), comments=True)
    if not words:
        return  # a comment
    while re.match(r"[A-Z_]+=", words[0]):
        words.pop(0)
    program, *arguments = words
    check = PROGRAMS.get(program.removeprefix(".venv/bin/"))
    assert check is not None, f"{command!r}: nobody checks {program!r}"
    check(arguments)


def _shipfp(arguments: list[str]) -> None:
    line = shlex.join(["shipfp", *arguments])
    understood(line)
    if not any(part in line for part in NOT_HERE):
        shipfp(line)


def understood(command: str) -> None:
    """Parse a line of `shipfp` with its own parser: subcommand, options and values exist, whether or not files do."""
    _, *arguments = shlex.split(command, comments=True)
    parser = typer.main.get_command(cli.app)
    while isinstance(parser, typer.core.TyperGroup) and arguments:
        name = arguments.pop(0)
        assert name in parser.commands, f"{command!r}: no command {name!r}"
        parser = parser.commands[name]
    if arguments:  # a sentence may name a command alone
        _parsed(command, parser, arguments)


def _parsed(command: str, parser: Any, arguments: list[str]) -> None:
    try:
        parser.make_context(None, arguments)
    except Exception as error:  # each package has its own for what it does not know
        raise AssertionError(f"{command!r}: {error}") from error


def _pip(arguments: list[str]) -> None:
    assert arguments[0] == "install"
    for wanted in arguments[1:]:
        extras_exist(wanted)


def extras_exist(wanted: str) -> None:
    """Check that `shipfp_rs[one,other]` names what pyproject.toml has."""
    found = re.fullmatch(r"shipfp_rs(?:\[([a-z0-9,]+)\])?", wanted)
    assert found, f"{wanted!r} is not this package"
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "optional-dependencies"
    ]
    assert set(filter(None, (found[1] or "").split(","))) <= set(extras), wanted


def _python(arguments: list[str]) -> None:
    assert arguments[0] == "-m"
    module, options = arguments[1], arguments[2:]
    if module == "pytest" and options[0] == "-m":
        _study(options)
    elif module == "pytest":
        assert all((ROOT / option).is_file() for option in options), options
    elif module == "sphinx":
        assert f"-m sphinx {options[0]}" in CI  # CI builds the site
    else:
        source = importlib.util.find_spec(module)
        assert source is not None, module
        assert source.origin is not None
        text = Path(source.origin).read_text(encoding="utf-8")
        assert all(option in text for option in options if option.startswith("--")), options


def _study(options: list[str]) -> None:
    """Check that `-m study -k WORD FILE` picks a test."""
    assert options[:2] == ["-m", "study"]
    word = options[options.index("-k") + 1] if "-k" in options else ""
    (file,) = [option for option in options if option.endswith(".py")] or [""]
    assert any(word in name and file in name for name in studies()), options


@cache
def studies() -> tuple[str, ...]:
    """Return path and names of every test that is marked as a study."""

    def marked(parent: ast.AST, name: str) -> Iterator[str]:
        for node in ast.iter_child_nodes(parent):
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                inner = f"{name}::{node.name}"
                if any(ast.unparse(mark) == "pytest.mark.study" for mark in node.decorator_list):
                    yield inner
                yield from marked(node, inner)

    return tuple(
        name
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
        for name in marked(ast.parse(path.read_text(encoding="utf-8")), str(path.relative_to(ROOT)))
    )


def _cargo(arguments: list[str]) -> None:
    """Check that a test which is left out of the usual ones has the name that is asked for, and benchmarks their file."""
    if arguments == ["bench"]:
        manifest = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
        assert all((ROOT / bench["path"]).is_file() for bench in manifest["bench"])
        return
    name = next(word for word in arguments[1:] if not word.startswith("-"))
    ignored = re.compile(rf"#\[ignore[^\]]*\]\s*(?:#\[[^\]]*\]\s*)*fn \w*{name}")
    assert any(ignored.search(path.read_text(encoding="utf-8")) for path in (ROOT / "rust").rglob("*.rs")), (
        name
    )


def _script(name: str) -> Callable[[list[str]], None]:
    def check(arguments: list[str]) -> None:
        path = ROOT / name
        assert os.access(path, os.X_OK)
        assert subprocess.run(["bash", "-n", path], check=False).returncode == 0
        assert arguments in ([], ["demo"], ["test"])

    return check


def _program(name: str) -> Callable[[list[str]], None]:
    """Check a program in Python that is called without arguments."""

    def check(arguments: list[str]) -> None:
        assert os.access(ROOT / name, os.X_OK)
        ast.parse((ROOT / name).read_text(encoding="utf-8"))
        assert arguments == []

    return check


def _dask(arguments: list[str]) -> None:
    """Parse a line of `dask` with its own parser."""
    pytest.importorskip("distributed")
    from distributed.cli import dask_scheduler, dask_worker

    parser = {"scheduler": dask_scheduler, "worker": dask_worker}[arguments[0]].main
    _parsed(shlex.join(["dask", *arguments]), parser, arguments[1:])


def _export(settings: list[str]) -> None:
    """Check that Dask knows the setting."""
    dask = pytest.importorskip("dask")
    pytest.importorskip("distributed")
    for setting in settings:
        name = setting.split("=")[0]
        assert name.startswith("DASK_")
        missing = object()
        key = name.removeprefix("DASK_").lower().replace("__", ".")
        assert dask.config.get(key, default=missing) is not missing, name


PROGRAMS: dict[str, Callable[[list[str]], None]] = {
    "shipfp": _shipfp,
    "pip": _pip,
    "python": _python,
    "cargo": _cargo,
    "dask": _dask,
    "export": _export,
    "./try": _script("try"),
    ".ci/run": _script(".ci/run"),
    ".ci/nightly": _script(".ci/nightly"),
    ".ci/machines": _program(".ci/machines"),
}
