"""Windows found in a log, written into a TRIAL.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.roles import Roles
from shipfp_rs.processing.windows import FoundWindow, longest_rest
from shipfp_rs.support.units import TO_NM, TO_RPM, TO_W


def windows_toml(windows: Sequence[FoundWindow]) -> str:
    """Return the [[windows]] tables of a TRIAL.toml, rests left out; frequencies as comments."""
    lines = []
    for window in windows:
        if window.kind == "steady":
            continue
        note = ""
        if window.frequency_hz is not None:
            first, last = window.frequency_hz
            note = f" # {first:.4g} Hz" if window.kind == "sine" else f" # {first:.4g} to {last:.4g} Hz"
        lines.append(
            f'[[windows]]\nname = "{window.name}"\nkind = "{window.kind}"{note}\n'
            f"start_s = {window.start_s:.1f}\nstop_s = {window.stop_s:.1f}\n"
        )
    return "\n".join(lines)


def filled_in(
    template: str,
    log: Log,
    path: Path,
    roles: Roles,
    trains: Mapping[str, float],
    windows: Sequence[FoundWindow],
    rate_hz: float | None = None,
    time: str | None = None,
    names: Path | None = None,
) -> str:
    """Return the template of a TRIAL.toml with what a log tells: its channels, steady stretch and windows.

    Parameters
    ----------
    template
        That of `support.toml.template`, whose tables stand apart by an empty line each.
    log, path
        The log and where it lies.
    roles
        What its channels are taken for, and why.
    trains
        Channels that are pulse trains, with pulses per second.
    windows
        What was found in the set point.
    rate_hz, time, names
        As it was opened.
    """
    tables = {_header(table): table for table in template.split("\n\n")}
    tables["trial"] = _with(tables["trial"], "log", json.dumps(str(path)))
    if rate_hz is not None:
        tables["trial"] = re.sub(
            "^# rate_hz = .*", f"rate_hz = {rate_hz!r}", tables["trial"], flags=re.MULTILINE
        )
    for key, value in (("time_column", time), ("names", None if names is None else str(names.resolve()))):
        if value is not None:
            line = f"{key} = {json.dumps(value)}"
            tables["trial"] = re.sub(f"^# {key} = .*", lambda _: line, tables["trial"], flags=re.MULTILINE)  # noqa: B023
    there = (
        f"# {one.name}{f' [{one.unit}]' if one.unit else ''}, {one.rate_hz:g} Hz: {roles.reasons.get(one.name, '')}"
        for one in log.channels.values()
    )
    about = "# The log's channels, and what each is taken for:\n" + "\n".join(there) + "\n"
    if roles.set_point is None:
        about += "# No set point was found: name its channel below.\n"
        tables["channels.set_point"] = about + tables["channels.set_point"]
    else:
        channel = log.channel(roles.set_point)
        tables["channels.set_point"] = about + _of(channel, tables["channels.set_point"], TO_RPM)
    if roles.torque is not None:
        tables["channels.torque"] = _of(log.channel(roles.torque), tables["channels.torque"], TO_NM)
    else:
        tables["channels.torque"] = re.sub("^", "# ", tables["channels.torque"], flags=re.MULTILINE)
    if roles.load is not None:
        tables["channels.load"] = _load(log.channel(roles.load), tables["channels.load"])
    if not trains and roles.speeds:
        del tables["channels.PTM_e"]
        tables["channels.PTM_4"] = "\n\n".join(_speed(log.channel(name)) for name in roles.speeds)
    if trains:
        del tables["channels.PTM_e"]
        tables["channels.PTM_4"] = "\n\n".join(_train(*train) for train in trains.items())
    rest = longest_rest(windows) if windows else None
    if rest is not None:
        stretch = f"[{rest.start_s:.1f}, {rest.stop_s:.1f}]"
        tables["operating_point"] = _with(tables["operating_point"], "steady_s", stretch)
    tables["windows"] = windows_toml(windows).rstrip() or tables["windows"]
    return "\n\n".join(tables.values())


def _header(table: str) -> str:
    found = re.search(r"^(?:# )?\[+([\w.]+)", table, re.MULTILINE)
    return found[1] if found else ""


def _with(table: str, key: str, value: str) -> str:
    """Return a table with another value of one key, the comment behind it where it was if there is room."""

    def line(old: re.Match[str]) -> str:
        new = f"{key} = {value}"
        return new.ljust(max(len(old[0]), len(new) + 1)) if old[1] else new

    return re.sub(
        rf"^{key} = (?:\"[^\"]*\"|\[[^\]]*\]|\{{[^}}]*\}}|\S+)( *)", line, table, count=1, flags=re.MULTILINE
    )


def _of(channel: Channel, table: str, factors: Mapping[str, float]) -> str:
    """Return a table for a channel; one of a known unit needs no calibration but that unit's factor."""
    table = _with(table, "column", json.dumps(channel.name))
    if channel.unit:
        table = _with(table, "unit", json.dumps(channel.unit))
    factor = factors.get(channel.unit.replace(" ", ""))
    return table if factor is None else _with(table, "calibration", f"{{ scale = {factor} }}")


def _load(channel: Channel, table: str) -> str:
    """Return the table of a load, which the template has as a comment."""
    told = re.sub("^# ", "", table, flags=re.MULTILINE)
    power = channel.unit in TO_W
    return _with(_of(channel, told, TO_W if power else TO_NM), "quantity", '"power"' if power else '"torque"')


def _speed(channel: Channel) -> str:
    """Return the table of a speed that is recorded as such."""
    return (
        f"[channels.{json.dumps(channel.name)}]            # recorded as a speed\n"
        f"column = {json.dumps(channel.name)}\n"
        f"unit = {json.dumps(channel.unit)}\n"
        'shaft = "engine"                # or "propeller"'
    )


def _train(name: str, pulses_hz: float) -> str:
    """Return the table of a pulse train, of which the log does not tell where it is."""
    return (
        f"[channels.{json.dumps(name)}]\n"
        f"column = {json.dumps(name)}\n"
        f"pulses_per_rev = 1              # {pulses_hz:.4g} pulses a second in its first two minutes\n"
        'shaft = "engine"                # or "propeller"'
    )
