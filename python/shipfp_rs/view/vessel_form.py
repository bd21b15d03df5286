"""A vessel file by a form: its fields are the keys of the template that `shipfp init --vessel` writes."""

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
    """A line of the template: of a table's head the key is that of the table, any other text has none."""

    text: str
    key: str = ""
    is_table: bool = False
    example: str = ""
    about: str = ""


def fields() -> list[dict[str, Any]]:
    """Return what the form asks for: heads of tables, and keys with an example and what they are."""
    return [line._asdict() for line in _lines() if line.key]


def vessel_file(values: Mapping[str, str], source: str) -> str:
    """Return the text of a vessel file; what is not given stays in it as a comment.

    Parameters
    ----------
    values
        Dotted key, such as "gearbox.ratio", to what was typed.
    source
        Name of the file, for messages.

    Raises
    ------
    InputError
        Where a key is no field of the form, or the vessel's loader refuses a value: one line that names the key.
    """
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
    """Return what was typed as TOML: a number where it is one and the example is, else a text for the loader to judge."""
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
