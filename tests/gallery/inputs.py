"""Inputs of the gallery: a command line, and the files that it meets in a folder."""

from __future__ import annotations

import json
import random
import shutil
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import typer

import shipfp_rs
from shipfp_rs import cli
from shipfp_rs.processing.trial import Trial
from shipfp_rs.support.files import finite
from shipfp_rs.sweeps import Plan
from shipfp_rs.vessel.vessel import Vessel
from tests.cli.small_trial import SMALL, SWEEP, write_small_trial
from tests.gallery.calls import TEXTS, Call, damaged, held, places, slipped, slipped_call, table, toml

LAUNCH = (Path(shipfp_rs.__file__).parent / "data" / "vessels" / "stan-launch-804.toml").read_text(
    encoding="utf-8"
)
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "inspect": ("log.parquet",),
    "convert": ("log.parquet", "new.parquet"),
    "simulate": ("vessel.toml", "--duration", "5"),
    "design": ("vessel.toml", "--duration", "100"),
    "sweep": ("SWEEP.toml", "--executor", "threads", "--no-figures"),
    "compare": ("fingerprint.json", "fingerprint.json"),
    "check": ("TRIAL.toml",),
    "run": ("TRIAL.toml",),
    "init": ("new",),
}
"""Commands whose options are tried, with what makes them run; the others show or repeat what is there."""
KEPT = (
    "log.parquet",
    "log.csv",
    "records.parquet",
    "TRIAL.toml",
    "SWEEP.toml",
    "vessel.toml",
    "fingerprint.json",
)
"""What every input can meet; none of it may be changed."""
SWEEPING = ("--workers", "1", "--executor", "threads", "--no-figures")


@dataclass(frozen=True)
class Input:
    """A command line, what is written into the folder before it, and what was done to it."""

    arguments: tuple[str, ...]
    about: str
    files: Mapping[str, str] = field(default_factory=dict)


def prepare(folder: Path) -> None:
    """Write what every input can meet: a log, its trial, a sweep, a ship, a fingerprint."""
    write_small_trial(folder)
    (folder / "vessel.toml").write_text(LAUNCH, encoding="utf-8")
    if cli.main(["run", str(folder / "TRIAL.toml"), "--out", str(folder / "first")]) != 0:
        raise RuntimeError("the trial without a slip does not run")
    (folder / "first" / "fingerprint.json").rename(folder / "fingerprint.json")
    (folder / "first" / "experiments.parquet").rename(folder / "records.parquet")
    shutil.rmtree(folder / "first")
    log = shipfp_rs.Log.open(folder / "log.parquet")
    columns = [log.read(name)[:300] for name in log.channels]
    rows = (
        f"{at / 50.0:g},{','.join(f'{value:.6g}' for value in row)}"
        for at, row in enumerate(zip(*columns, strict=True))
    )
    (folder / "log.csv").write_text(
        "\n".join([",".join(["time", *log.channels]), *rows, ""]), encoding="utf-8"
    )


def inputs(folder: Path, count: int, seed: int) -> list[Input | Call]:
    """Return so many inputs of the command line and calls from Python; the same seed gives the same ones."""
    chance = random.Random(seed)
    public = table(folder)
    text = (folder / "log.csv").read_text(encoding="utf-8")
    fingerprint = json.loads((folder / "fingerprint.json").read_text(encoding="utf-8"))
    makers: list[Callable[[], Input | Call]] = [
        *[lambda: _slip("trial", "check", chance)] * 5,
        *[lambda: _slip("trial", "run", chance, "--out", "out")],
        *[lambda: _slip("sweep", "sweep", chance, "--out", "out", *SWEEPING)] * 2,
        *[lambda: _slip("vessel", "simulate", chance, "--duration", "5")] * 3,
        *[lambda: _option(chance)] * 5,
        *[lambda: _fingerprint(fingerprint, chance)] * 2,
        *[lambda: _damaged(chance)],
        *[lambda: _damaged_log(text, chance)],
        *[lambda: slipped_call(public, chance)] * 10,
    ]
    return [chance.choice(makers)() for _ in range(count)]


@cache
def _parsed(kind: str) -> tuple[dict[str, Any], list[Any]]:
    text, model = {"trial": (SMALL, Trial), "sweep": (SWEEP, Plan), "vessel": (LAUNCH, Vessel)}[kind]
    content = tomllib.loads(text)
    return content, places(model, content)


def _slip(kind: str, command: str, chance: random.Random, *options: str) -> Input:
    about, content = slipped(*_parsed(kind), chance)
    return Input((command, "slip.toml", *options), about, {"slip.toml": toml(content)})


def _fingerprint(content: dict[str, Any], chance: random.Random) -> Input:
    about, changed = slipped(content, _places_of(content), chance)
    changed = finite(changed) if chance.random() < 0.5 else changed
    return Input(
        ("compare", "slip.json", "fingerprint.json"), about, {"slip.json": json.dumps(changed, default=str)}
    )


def _places_of(content: dict[str, Any]) -> list[Any]:
    return [place for place in held(content, ()) if place[0] not in ("residuals", "data")]


def _damaged(chance: random.Random) -> Input:
    command, text = chance.choice((("check", SMALL), ("sweep", SWEEP), ("simulate", LAUNCH)))
    more = ("--out", "out", *SWEEPING) if command == "sweep" else ()
    return Input((command, "slip.toml", *more), "a line is damaged", {"slip.toml": damaged(text, chance)})


def _damaged_log(text: str, chance: random.Random) -> Input:
    lines = text.splitlines(keepends=True)
    line = chance.choice((0, 0, 1, chance.randrange(len(lines))))
    cells = lines[line].rstrip("\n").split(",")
    cells[chance.randrange(len(cells))] = chance.choice(TEXTS)
    lines[line] = ",".join(cells) + "\n"
    changed = "".join(lines) if chance.random() < 0.5 else damaged(text, chance)
    command = chance.choice(("inspect", "convert"))
    return Input(
        (command, "slip.csv", *(("new.parquet",) if command == "convert" else ())),
        f"line {line} of a log",
        {"slip.csv": changed},
    )


@cache
def _options() -> list[tuple[str, str, bool]]:
    """Return command, option (or place of an argument), and whether it takes a value."""
    group: Any = typer.main.get_command(cli.app)
    found: list[tuple[str, str, bool]] = []
    for name, base in COMMANDS.items():
        options = [option for option in group.commands[name].params if option.param_type_name == "option"]
        found += [(name, max(option.opts, key=len), not option.is_flag) for option in options]
        found += [(name, str(place), True) for place, text in enumerate(base) if not text.startswith("-")]
    return [row for row in found if row[1] != "--address"]


def _option(chance: random.Random) -> Input:
    command, option, valued = chance.choice(_options())
    base = list(COMMANDS[command])
    text = chance.choice(TEXTS).replace("\0", "")
    if option.isdigit():
        if base[int(option) - 1].startswith("-"):
            return Input((command, *base), "nothing")
        base[int(option)] = text
    else:
        base += [option, text] if valued else [option]
    return Input((command, *base), f"{option} {text[:60]!r}")
