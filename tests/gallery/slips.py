"""Slips: values that are wrong in kind, sign, size, unit or length, and files in which one key has such a value."""

from __future__ import annotations

import copy
import datetime
import json
import math
import random
from collections.abc import Iterator, Mapping
from typing import Any, get_args, get_type_hints

from pydantic import BaseModel

VALUES: tuple[Any, ...] = (
    True, False, 0, 1, -1, 2, 3, 7, 0.0, -0.0, 0.5, 1.5, -5.0, 1e-300, 1e300, -1e300, 1e-9, 1e9, 1e14,
    math.nan, math.inf, -math.inf, 10**15, 10**30, -(10**30), 2**63, "", "a", "x" * 5000,
    "n\u00e4\u2603\u202e\u0131", "a\nb", "a\tb", "nan", "auto", "1.5", "-", ".", "..", "/", "/dev/null", "*", "?.csv",
    "[red]", "%s{}", "gauge", "none", [], [1], [1.0, 2.0], [2.0, 1.0], [math.nan, 1.0], ["a"], [[1.0, 2.0]],
    [[0.0, 1.0], [0.0, 2.0]], [True], list(range(3000)), {}, {"a": 1}, {"scale": 0.0},
    {"low": 1.0, "high": 1.0}, datetime.date(2024, 2, 29),
)  # fmt: skip
FACTORS = (60.0, 1.0 / 60.0, 1e3, 1e-3, 0.01, 100.0, -1.0, 1e6, 1e-6, 2.0 * math.pi)
"""Slips of unit and sign."""
TEXTS: tuple[str, ...] = (
    *(str(value) for value in VALUES if not isinstance(value, list | dict)),
    "1e400", "0x10", "1,5", "1_000", "\u0661", "5:1", "1:5", "nan:1", "0:0", "1:2:3", "true", "-10:10", "tau_n",
    "chirp", "log.parquet", "TRIAL.toml", "none.toml", "none.parquet", "D", "A", "sines", "/proc/in", "log.parquet/in",
)  # fmt: skip

Place = tuple[str | int, ...]


def places(model: type[BaseModel], content: Mapping[str, Any]) -> list[Place]:
    """Return every key that a file can hold: those of the model's tables, and those that are in it."""
    return list(dict.fromkeys([*_declared(model, ()), *held(content, ())]))


def _declared(model: type[BaseModel], place: Place) -> Iterator[Place]:
    for key, field in model.model_fields.items():
        yield (*place, key)
        for inner in _models_in(field.annotation):
            listed = inner.__name__ == "Window"
            yield from _declared(inner, (*place, key, 0) if listed else (*place, key))
    if extra := get_type_hints(model).get("__pydantic_extra__"):
        for inner in _models_in(extra):
            yield from _declared(inner, (*place, "speed"))


def _models_in(annotation: Any) -> set[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    return {model for argument in get_args(annotation) for model in _models_in(argument)}


def held(content: Any, place: Place) -> Iterator[Place]:
    if not isinstance(content, Mapping | list):
        return
    for key, value in content.items() if isinstance(content, Mapping) else enumerate(content):
        yield (*place, key)
        yield from held(value, (*place, key))


def slipped(
    content: Mapping[str, Any], places: list[Place], chance: random.Random
) -> tuple[str, dict[str, Any]]:
    """Return content with one slip, and what the slip is."""
    changed = copy.deepcopy(dict(content))
    place = chance.choice(places)
    owner: Any = changed
    for part in place[:-1]:
        if isinstance(owner, dict):
            owner = owner.setdefault(part, {})
        elif isinstance(owner, list) and isinstance(part, int) and part < len(owner):
            owner = owner[part]
        else:
            return f"{place}: not there", changed
    last = place[-1]
    if not isinstance(owner, dict | list):
        return f"{place}: not there", changed
    there = last in owner if isinstance(owner, dict) else isinstance(last, int) and last < len(owner)
    kind = chance.choice(("value", "value", "value", "value", "unit", "missing", "misspelt"))
    if kind == "missing" and there:
        del owner[last]
    elif kind == "unit" and there and isinstance(owner[last], float):
        owner[last] *= chance.choice(FACTORS)
    elif kind == "misspelt" and there and isinstance(owner, dict) and isinstance(last, str):
        owner[chance.choice((last[1:], last + last[-1:], last.upper(), f"{last}\u00e9", "x" * 3000))] = (
            owner.pop(last)
        )
    elif isinstance(owner, dict) or there:
        owner[last] = chance.choice(VALUES)
        return f"{place} = {repr(owner[last])[:60]}", changed
    return f"{place}: {kind}", changed


def toml(content: Mapping[str, Any]) -> str:
    """Write parsed TOML as text, every table in one line."""
    return "".join(f"{json.dumps(key)} = {_written(value)}\n" for key, value in content.items())


def _written(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, float):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan" if math.isnan(value) else repr(value))
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {_written(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_written, value)) + "]"
    return str(value)


def damaged(text: str, chance: random.Random) -> str:
    """Return a text of a file with one of its lines doubled, cut, or swapped for bytes of another file."""
    lines = text.splitlines(keepends=True)
    at = chance.randrange(len(lines))
    lines[at] = chance.choice(
        (lines[at] * 2, lines[at][: len(lines[at]) // 2], "\ufeff" + lines[at], "PAR1\x00\n", "= 1\n", "[[\n")
    )
    return "".join(lines)
