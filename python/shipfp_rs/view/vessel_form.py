"""Form for a vessel file, with the keys of the template of `shipfp init --vessel` as fields."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import tomlkit

from shipfp_rs.errors import InputError
from shipfp_rs.support.toml import parsed_toml, template, validated
from shipfp_rs.vessel.vessel import Vessel

LINE = re.compile(
    r"(?:# )?(?:\[(?P<table>\w+)\]|(?P<key>\w+) = (?P<example>\S+|\".*?\"))(?:\s+# (?P<about>.*))?"
)


class Line(NamedTuple):
    """Line of the template: for a table's heading the key is that of the table, other text has none."""

    text: str
    key: str = ""
    is_table: bool = False
    example: str = ""
    about: str = ""


def fields() -> list[dict[str, Any]]:
    """Fields of the form: headings of tables, and keys with example and description."""
    return [line._asdict() for line in _lines() if line.key]


def vessel_file(values: Mapping[str, str], source: str) -> str:
    """Text of a vessel file from the values entered for dotted keys; keys without a value remain as comments."""
    given = {key: value.strip() for key, value in values.items() if value.strip()}
    if unknown := given.keys() - {line.key for line in _lines() if not line.is_table}:
        raise InputError(f"{source}: {min(unknown)}: found an unknown key, expected one of the form")
    written = [_filled(line, given) for line in _lines()]
    text = "\n".join(written) + "\n"
    validated(parsed_toml(text, source), Vessel, source)
    return text


def _filled(line: Line, given: Mapping[str, str]) -> str:
    bare = line.text.removeprefix("# ")
    if line.is_table:
        acts = bare == line.text or any(key.startswith(f"{line.key}.") for key in given)
        return bare if acts else f"# {bare}"
    if line.key and line.key in given:
        head = f"{line.key.rpartition('.')[2]} = {_value(given[line.key], line.example)}"
        return f"{head:<31} # {line.about}" if line.about else head
    return f"# {bare}" if line.key else line.text


def _value(typed: str, example: str) -> str:
    """Entered text as TOML: a number if it and the example are numbers, else a text for the loader to validate."""
    if not example.startswith('"'):
        for number in (int, float):
            with suppress(ValueError):
                return tomlkit.item(number(typed.replace(",", "."))).as_string()
    return tomlkit.item(typed).as_string()


def _lines() -> Iterator[Line]:
    table = ""
    for text in template("VESSEL").splitlines():
        found = LINE.fullmatch(text)
        if found is None:
            yield Line(text)
        elif found["table"]:
            table = found["table"]
            yield Line(text, table, True, about=found["about"] or "")
        else:
            key = f"{table}.{found['key']}" if table else found["key"]
            yield Line(text, key, False, found["example"], found["about"] or "")
