"""Drafts of TRIAL.toml and of a vessel file, edited on the page; content that the page can't edit and comments are kept."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import tomlkit
from pydantic import Field, StringConstraints
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable, Table

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.roles import named_roles
from shipfp_rs.processing.trial import MOST_WINDOWS, Processing, Trial
from shipfp_rs.processing.trial_channels import CALIBRATED, Command, Level, Load, Rack, SetPoint, Torque
from shipfp_rs.processing.trial_template import common_rate
from shipfp_rs.support.toml import TO_BE_GIVEN, Section, parsed_toml, read_tables, template, validated
from shipfp_rs.support.units import TO_RPM, TO_W, told
from shipfp_rs.vessel.vessel import Vessel

LINE = re.compile(
    r"(?:# )?(?:\[(?P<table>\w+)\]|(?P<key>\w+) = (?P<example>\S+|\".*?\"))(?:\s+# (?P<about>.*))?"
)


class Line(NamedTuple):
    """Line of the template. A heading's key is the table's name; comments and empty lines have no key."""

    text: str
    key: str = ""
    is_table: bool = False
    example: str = ""
    about: str = ""


def fields() -> list[dict[str, Any]]:
    """Fields of the vessel form: table headings, and keys with example and description."""
    return [line._asdict() for line in _lines() if line.key]


def vessel_file(values: Mapping[str, str], source: str) -> str:
    """Text of a vessel file from values by dotted key; a key without a value stays a comment."""
    given = {key: value.strip() for key, value in values.items() if value.strip()}
    if unknown := given.keys() - {line.key for line in _lines() if not line.is_table}:
        raise InputError(f"{source}: {min(unknown)}: found an unknown key, expected a key of the form")
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
    """Entered text as TOML: a number if text and example are numbers, else a string, which the loader validates."""
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


LEVELS: Mapping[str, type[Level]] = {
    "set_point": SetPoint,
    "command": Command,
    "torque": Torque,
    "rack": Rack,
    "load": Load,
}
"""Roles whose tables in TRIAL.toml have fixed names; the user names tables of pulse trains and speeds."""
SHOWN = {"train": "pulse train", "speed": "speed"}

Short = Annotated[str, StringConstraints(max_length=200)]
Number = Annotated[float, Field(strict=False)]
Stretch = Annotated[tuple[Number, Number], Field(strict=False)]
Rows = Annotated[tuple[Stretch, ...], Field(strict=False, max_length=200)]


class DraftCalibration(Section):
    """Scale and offset, or a table of readings and values."""

    scale: Number | None = None
    offset: Number = 0.0
    table: Rows | None = None


class DraftChannel(Section):
    """Role and properties of a channel."""

    column: Short
    role: Literal["set_point", "command", "torque", "rack", "load", "speed", "train"]
    unit: Short = ""
    calibration: DraftCalibration = DraftCalibration()
    location: Literal["gauge", "brake", "shaft"] = "gauge"
    quantity: Literal["torque", "power", "other"] = "torque"
    """Quantity of a load."""
    name: Short = ""
    """Name of the table of a pulse train or speed; if empty, the column's name."""
    pulses_per_rev: Annotated[int, Field(ge=1, le=100_000)] | None = None
    shaft: Literal["engine", "propeller", ""] = ""
    """Shaft of a train; empty, like None for the pulses, until the user gives it."""
    threshold: Number | None = None


class DraftWindow(Section):
    """One experiment."""

    name: Short
    kind: Short = ""
    start_s: Number
    stop_s: Number
    log: Short | None = None


class Draft(Section):
    """Part of a trial that the page edits."""

    name: Short = "Trial"
    vessel: Short = ""
    """Vessel in the trial's header; if empty, the trial has none, and engine and propeller turn at the same speed."""
    channels: Annotated[tuple[DraftChannel, ...], Field(strict=False, max_length=1000)] = ()
    steady_s: Stretch | None = None
    windows: Annotated[tuple[DraftWindow, ...], Field(strict=False, max_length=MOST_WINDOWS)] = ()


def version_of(path: Path) -> str:
    """Hash of a file's content, which identifies its version; empty if there is no file."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def read_draft(path: Path) -> Draft:
    """Read the editable part of a TRIAL.toml, which may be incomplete."""
    content = read_tables(path)
    header, point = _table(content, "trial"), _table(content, "operating_point")
    channels = []
    for key, table in _table(content, "channels").items():
        if not isinstance(table, Mapping):
            raise InputError(f"{path}: channels.{key}: found {str(table)[:60]!r}, expected a table")
        if (role := _role(key, table)) is None:
            continue
        known = {
            name: table[name]
            for name in DraftChannel.model_fields
            if table.get(name, TO_BE_GIVEN) != TO_BE_GIVEN
        }
        # Without the key, the shaft is the engine's.
        known.setdefault("shaft", "" if "shaft" in table else "engine")
        channels.append({"column": "", **known, "role": role} | ({} if role in LEVELS else {"name": key}))
    marked = content.get("windows", [])
    if not isinstance(marked, list) or not all(isinstance(window, Mapping) for window in marked):
        raise InputError(f"{path}: windows: found {str(marked)[:60]!r}, expected tables [[windows]]")
    windows = [
        {name: window[name] for name in DraftWindow.model_fields if name in window} for window in marked
    ]
    told = {name: header[name] for name in ("name", "vessel") if name in header}
    steady = {"steady_s": point["steady_s"]} if "steady_s" in point else {}
    return validated({**told, **steady, "channels": channels, "windows": windows}, Draft, str(path))


def written(
    draft: Draft,
    old: str | None,
    log: str,
    rate_hz: float | None = None,
    rates_hz: Mapping[str, float] = MappingProxyType({}),
) -> str:
    """Text of a TRIAL.toml from a draft and the old text; a new file has the comments of the template."""
    try:
        document = tomlkit.parse(template("TRIAL") if old is None else old)
    except (TOMLKitError, RecursionError) as error:
        raise InputError(f"TRIAL.toml: not TOML: {error}") from error
    header = _sub_table(document, "trial")
    _put(header, "name", draft.name)
    if draft.vessel:
        _put(header, "vessel", draft.vessel)
    else:
        header.pop("vessel", None)
    if old is None:
        _put(header, "log", log)
        if rate_hz is not None:
            _put(header, "rate_hz", rate_hz)
        known = [(one.role, rates_hz[one.column]) for one in draft.channels if one.column in rates_hz]
        speeds = [own for role, own in known if role == "speed"]
        counted = any(role == "train" for role, _ in known)
        levels = [own for role, own in known if role in ("torque", "rack")]
        if (rate := common_rate(levels, [] if counted else speeds)) < Processing().rate_hz:
            _put(document["processing"], "rate_hz", rate)
    _put_channels(_sub_table(document, "channels"), draft.channels)
    point = _sub_table(document, "operating_point")
    if draft.steady_s is not None:
        _put(point, "steady_s", list(draft.steady_s))
    elif "steady_s" in point:
        point.remove("steady_s")
    _put_windows(document, draft.windows)
    return tomlkit.dumps(document)


def checked(text: str, source: str) -> Trial:
    """Trial that a text describes; `InputError` with the first wrong or missing value."""
    return validated(parsed_toml(text, source), Trial, source)


def problems(text: str, source: str) -> list[dict[str, str]]:
    """What a TRIAL.toml still lacks: the label of the field on the page ("at", may be empty) and a sentence ("text")."""
    content = parsed_toml(text, source)
    tables, point = _table(content, "channels"), _table(content, "operating_point")
    windows, shipless = content.get("windows", []), "vessel" not in content["trial"]
    rests = "steady_s" in point or "command" in tables or isinstance(point.get("n_e_rpm"), int | float)
    found = [
        (not {"set_point", "command"} & tables.keys(), "", "No channel is the set point yet."),
        (not tables.keys() - {*LEVELS, "actuator"}, "", "No channel is a speed or a pulse train yet."),
        (not rests, "mark the steady stretch", "Mark a stretch where the set point is constant."),
        (not windows, "mark a window", "No window yet: mark a stretch where the set point moves."),
    ]
    for key, table in tables.items():
        name, unit, shaft = table.get("column"), told(str(table.get("unit", ""))), table.get("shaft")
        level, line, pulses = LEVELS.get(key), table.get("calibration"), table.get("pulses_per_rev")
        asks = level.factor(unit, table)[0] is None if level else unit in CALIBRATED and not pulses
        found += [
            (asks and name and not line, f"calibration of {name}", "Say what a reading means."),
            (pulses == TO_BE_GIVEN, f"pulses a turn of {name}", "Give the pulses in a turn."),
            (shaft == TO_BE_GIVEN, f"shaft of {name}", "Say on which shaft it is."),
            (shaft == "propeller" and shipless, "ship", f"{name} is behind a gear: choose the ship."),
        ]
    late = [window["name"] for window in windows if window["start_s"] >= window["stop_s"]]
    found += [(True, f"end of {name}", "It is not after the start.") for name in late]
    return [{"at": at, "text": said} for lacks, at, said in found if lacks]


def _role(key: str, table: Mapping[str, Any]) -> str | None:
    """Role of a channel's table on the page; None if the page keeps the table unchanged, such as that of an encoder."""
    if key == "actuator":
        return None
    if key in LEVELS:
        return key
    if "pulses_per_rev" in table and "file" not in table:
        return "train"
    unit = told(str(table.get("unit", "")))
    is_reading = unit == "%" or (unit in CALIBRATED and "calibration" in table)
    is_other = table.get("kind", "speed") != "speed" or {"counts_per_rev", "file"} & table.keys()
    return "speed" if unit in TO_RPM or (is_reading and not is_other) else None


def _table(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    found = content.get(key, {})
    if not isinstance(found, Mapping):
        raise InputError(f"{key}: found {found!r}, expected a table")
    return found


def _sub_table(document: Any, key: str) -> Any:
    if key not in document:
        document[key] = tomlkit.table()
    return document[key]


def _put(table: Any, key: str, value: Any) -> None:
    """Set a key if its value differs; unchanged keys keep their spelling and comment."""
    old = table.get(key)
    if old is None or getattr(old, "unwrap", lambda: old)() != value:
        table[key] = value


def _put_channels(tables: Any, channels: Sequence[DraftChannel]) -> None:
    wanted: dict[str, DraftChannel] = {}
    for channel in channels:
        key = channel.role if channel.role in LEVELS else channel.name or channel.column
        if key in wanted:
            what = key.replace("_", " ") if channel.role in LEVELS else f"{SHOWN[channel.role]} {key!r}"
            raise InputError(
                f"{what}: found two channels, {wanted[key].column!r} and {channel.column!r}; choose one"
            )
        if channel.role not in LEVELS and key in (*LEVELS, "actuator"):
            raise InputError(f"{SHOWN[channel.role]} {key!r}: the name is taken; choose another one")
        wanted[key] = channel
    for key in [key for key in tables if key not in wanted and _role(key, tables[key]) is not None]:
        tables.remove(key)
    for key, channel in wanted.items():
        is_new = key not in tables
        if is_new:
            tables[key] = tomlkit.table()
        _put_channel(tables[key], channel)
        if is_new:
            tables[key].add(tomlkit.nl())


def _put_channel(table: Table, channel: DraftChannel) -> None:
    _put(table, "column", channel.column)
    if channel.role == "train":
        _put(table, "pulses_per_rev", channel.pulses_per_rev or TO_BE_GIVEN)
        _put(table, "shaft", channel.shaft or TO_BE_GIVEN)
        if channel.threshold is not None:
            _put(table, "threshold", channel.threshold)
        elif "threshold" in table:
            table.remove("threshold")
        return
    _put(table, "unit", channel.unit)
    if channel.role == "speed":
        _put(table, "shaft", channel.shaft or "engine")
    line, old = _line(channel.calibration), table.get("calibration")
    if line is None:
        table.pop("calibration", None)
    elif not isinstance(old, InlineTable | Table) or _plain_line(old.unwrap()) != _plain_line(line.unwrap()):
        table["calibration"] = line
    if channel.role == "torque":
        _put(table, "location", channel.location)
    if channel.role == "load":
        _put(table, "quantity", channel.quantity)


def _plain_line(line: Mapping[str, Any]) -> Any:
    return line.get("scale"), line.get("offset", 0.0), [[*row] for row in line.get("table") or ()]


def _line(calibration: DraftCalibration) -> InlineTable | None:
    """Calibration as TOML; None without scale and table."""
    line = tomlkit.inline_table()
    if calibration.table is not None:
        line["table"] = [list(row) for row in calibration.table]
    elif calibration.scale is not None:
        line["scale"] = calibration.scale
        line["offset"] = calibration.offset
    else:
        return None
    return line


def _put_windows(document: Any, windows: Sequence[DraftWindow]) -> None:
    there = document.get("windows", [])
    old = {table.get("name"): table for table in there}
    if not windows:
        document.pop("windows", None)
        return
    for window in windows:
        table = old.get(window.name)
        if table is None:
            table = old[window.name] = tomlkit.table()
        for key in ("name", "kind", "start_s", "stop_s", "log"):
            value = getattr(window, key)
            if value is not None and (value != "" or key in table):
                _put(table, key, value)
    if [table.get("name") for table in there] == [window.name for window in windows]:
        return
    tables = tomlkit.aot()
    for window in windows:
        tables.append(old[window.name])
    if not tables[-1].as_string().endswith("\n\n"):
        tables[-1].add(tomlkit.nl())
    document["windows"] = tables


def guessed(channels: Sequence[Channel]) -> list[DraftChannel]:
    """Draft channels with roles guessed from names and units; channels without a guess are omitted."""
    roles = named_roles(channels)
    levels = {getattr(roles, role): role for role in ("set_point", "command", "torque", "load")}
    found = []
    for name, one in roles.named.items():
        if name in levels:
            role = levels[name]
            known = factors(one.unit)[role]
            content = {"column": name, "role": role, "unit": one.unit, "quantity": known["quantity"]}
            if role == "torque":
                content["location"] = roles.location
            found.append(DraftChannel.model_validate(content | {"calibration": {"scale": known["factor"]}}))
        elif name in roles.speeds and (one.unit in TO_RPM or one.unit == "%"):
            found.append(DraftChannel(column=name, role="speed", unit=one.unit, shaft=roles.speeds[name]))
        elif one.is_open and "pulses" in one.tells:
            found.append(DraftChannel(column=name, role="train"))
    return found


def factors(unit: str) -> dict[str, dict[str, Any]]:
    """What a unit implies, by role: its factor (None: needs a calibration), a load's quantity, whether a speed needs one."""
    unit = told(unit)
    given = {"quantity": "power" if unit in TO_W else "torque"}
    own = {level: given if level is Load else {} for level in LEVELS.values()}
    levels = {role: {"factor": one.factor(unit, own[one])[0], **given} for role, one in LEVELS.items()}
    return {**levels, "speed": {"asks": unit not in TO_RPM}}
