"""What the README and every page of the documentation print runs as printed; the README's figures are the command's."""

from __future__ import annotations

import ast
import importlib.util
import os
import pkgutil
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
import typer

import shipfp_rs as fp
from shipfp_rs import cli
from shipfp_rs.simulation.raw_log import simulate_raw_log
from tests.logger_files import REAL, sample_file

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
from page_code import LEANING, RUN, SHOWN, alike, blocks, bring_up_to_date, run_page, shipfp  # noqa: E402 the site's own, which builds with it

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


README = (ROOT / "README.md").read_text(encoding="utf-8")


PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def own_log(folder: Path) -> None:
    """Write a reader's log: what a tug's logger records in two minutes, as text, under names of its own."""
    tug, chirp = (
        fp.Vessel.load("stan-tug-1205"),
        fp.signals.chirp(0.05, 1.5, 60.0, 40.0, law="logarithmic", rate_hz=2000.0),
    )
    log, _ = simulate_raw_log(tug, chirp, seed=1)
    names = {
        "Setpoint [V]": "U_setpoint",
        "Torque [V]": "U_torque",
        "Shaft pulses [V]": "PTM_4",
        "Engine pulses [V]": "PTM_e",
    }
    columns = {own: np.asarray(log.read(name)) for own, name in names.items()}
    time = np.arange(len(columns["Torque [V]"])) / 2000.0
    pyarrow.csv.write_csv(pa.table({"Time [s]": time, **columns}), folder / "my-log.csv")


def fill_in(folder: Path) -> None:
    """Say what a log in volts can't: which line calibrates a channel, and which train is where."""
    path = folder / "my-trial" / "TRIAL.toml"
    head, *tables = re.split(r"(?m)^(?=\[)", path.read_text())
    answers = {
        "[channels.set_point]": ["{ scale = -251.38, offset = -85.29 }"],
        "[channels.torque]": ["{ scale = 1059.0 }"],
        '[channels."Shaft pulses"]': ["4", '"propeller"'],
        '[channels."Engine pulses"]': ["1", '"engine"'],
        "[trial]": [],
    }
    for index, table in enumerate(tables):
        for answer in answers.pop(table.splitlines()[0], []):
            tables[index] = tables[index].replace('"to be given"', answer, 1)
    assert not answers
    path.write_text("".join([head, *tables]).replace("[trial]\n", '[trial]\nvessel = "stan-tug-1205"\n', 1))


def logger_file(kind: str, name: str) -> Callable[[Path], None]:
    return lambda folder: folder.joinpath(name).write_bytes(sample_file(kind, folder).read_bytes())


def bus_and_its_dbc(folder: Path) -> None:
    recorded = REAL / "j1939"
    folder.joinpath("bus.mf4").write_bytes((recorded / "engine_idle.MF4").read_bytes())
    folder.joinpath("engine.dbc").write_bytes((recorded / "CSS-Electronics-SAE-J1939-DEMO.dbc").read_bytes())


def fewer_draws(folder: Path) -> None:
    plan = folder / "my-sweep" / "SWEEP.toml"
    plan.write_text(re.sub(r"draws = \d+", "draws = 2", plan.read_text()))


def fingerprint_of_before(folder: Path) -> None:
    tug = fp.Vessel.load("stan-tug-1205")
    trial = fp.simulate(
        tug, fp.signals.chirp(0.02, 2.0, 60.0, 40.0, rate_hz=50.0), noise={"n_e": 1e-3, "M_g": 1e-3}
    )
    (folder / "earlier").mkdir()
    structure = fp.Structure.linear(torque="gauge", products=True)
    fp.identify(trial, structure, noise="white", vessel="stan-tug-1205").save(
        folder / "earlier" / "fingerprint.json"
    )


READERS_OWN: dict[str, dict[str, Callable[[Path], None]]] = {
    "README.md": {"init my-trial": own_log, "run my-trial": fill_in},
    "docs/how-to/famos.md": {"convert": logger_file("imc FAMOS", "run.raw")},
    "docs/how-to/dewesoft.md": {"inspect": logger_file("DEWESoft", "run.d7d")},
    "docs/how-to/tdms.md": {"inspect": logger_file("TDMS", "run.tdms")},
    "docs/how-to/mdf.md": {"convert": logger_file("MDF 4", "run.mf4")},
    "docs/how-to/can.md": {"convert": bus_and_its_dbc},
    "docs/sweeps.md": {"sweep my-sweep/": fewer_draws},
    "docs/design.md": {"earlier": fingerprint_of_before},
}
"""What a reader has, or does, before the first command of a page that holds the word."""


@pytest.mark.filterwarnings(
    "default::shipfp_rs.errors.LogWarning"
)  # what a command tells is no failure of it
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_what_a_page_has_its_reader_type_runs(page, tmp_path):
    before = dict(READERS_OWN.get(name_of(page), {}))

    def typed(command: str) -> None:
        for word in [word for word in before if word in command]:
            before.pop(word)(tmp_path)
        type_in(command)

    printed = run_page(page, tmp_path, typed)
    assert not before
    if page.name == "README.md":
        assert "tau_n" in printed
        assert (tmp_path / "my-result" / "report.html").is_file()
    if page.parent.name == "tutorials":
        assert printed
    # A picture that the page shows is one that its code makes, or that of another page, whose test it is.
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", page.read_text(encoding="utf-8")):
        _, is_made, place = picture.partition("made/")
        if not is_made:
            assert (page.parent / picture).is_file(), picture
            continue
        maker = next(other for other in PAGES if place.startswith(f"{made_by(other)}/"))
        if maker == page:
            assert (tmp_path / place.removeprefix(f"{made_by(page)}/")).is_file(), picture
        else:
            assert f"made/{place}" in maker.read_text(encoding="utf-8"), picture


def test_the_readme_is_short():
    assert len(README.split()) <= 600


def made_by(page: Path) -> str:
    """Return the folder below `made` in which a page's code runs."""
    return name_of(page).removeprefix("docs/").removesuffix(".md")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_is_of_a_language_that_is_run_or_shown(page):
    assert {language for language, *_ in blocks(page)} <= {*RUN, *LEANING, *SHOWN}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_what_a_sentence_names_exists(page):
    """Commands, extras and names of the package between backticks, in prose and tables."""
    for words in re.findall(r"(?<!`)`([^`\n]+)`(?!`)", page.read_text(encoding="utf-8")):
        if words.startswith("pip install 'shipfp_rs"):
            extras_exist(words.split("'")[1])
        elif words.startswith("shipfp "):
            understood(re.sub(r"\s*\.\.\.$", "", words))
        elif not words.endswith((".toml", ".json", ".csv")):
            for name in re.findall(r"\b(?:fp|shipfp_rs)\.([A-Za-z_][\w.]*)", words):
                pkgutil.resolve_name(f"shipfp_rs.{name.rstrip('.')}")


def test_output_below_code_is_kept_up_to_date(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nprint('tau_n', 1.5109)\n```\n\nMore.\n")
    with pytest.raises(AssertionError, match="To bring it up to date"):
        run_page(page, tmp_path)
    bring_up_to_date(page)
    assert "```\n\n```text\ntau_n 1.5109\n```\n\nMore." in page.read_text()
    for number, passes in (("1.5111", True), ("1.5300", True), ("1.7", False)):
        assert alike("tau_n 1.5109", f"tau_n {number}") is passes
    page.write_text(page.read_text().replace("print('tau_n'", "print('tau_prop'"))
    with pytest.raises(AssertionError, match="tau_prop"):
        run_page(page, tmp_path)
    bring_up_to_date(page)
    assert page.read_text().count("```text") == 1


def test_a_page_that_says_something_wrong_is_found_out(tmp_path):
    page = tmp_path / "page.md"
    for wrong in (
        "```python\n1 / 0\n```\n",
        "```sh\nshipfp simulate stan-lunch\n```\n",
        "```sh\nrm log\n```\n",
        "    rm log\n",
        "```bash\npip install 'shipfp_rs[famous]'\n```\n",
        "```bash\nshipfp sweep SWEEP.toml --adress 10.0.0.1:8786\n```\n",
        "    python -m pytest -m study -k no_such_study\n",
        "    python -m benches.peers --quickly\n",
        "    cargo test --release no_such_fuzz -- --ignored\n",
        "```bash\ndask worker 10.0.0.1:8786 --threads-each 1\n```\n",
        "    export DASK_DISTRIBUTED__WORKER__PROFIL__ENABLED=False\n",
        "    ./try tests\n",
    ):
        page.write_text(wrong)
        with pytest.raises((ZeroDivisionError, RuntimeError, AssertionError)):
            run_page(page, tmp_path, type_in)
