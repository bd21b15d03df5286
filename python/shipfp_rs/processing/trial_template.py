"""Windows found in a log, written into a TRIAL.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.windows import FoundWindow, longest_rest

TORQUE = "torq|moment|koppel|torsion|strain"
"""What a channel of the torque is called, in part."""
TO_RPM: Mapping[str, float] = {"rpm": 1.0, "1/min": 1.0, "rev/min": 1.0, "U/min": 1.0, "rev/s": 60.0}
TO_NM: Mapping[str, float] = {"Nm": 1.0, "N·m": 1.0, "kNm": 1e3, "kN·m": 1e3}
"""Factors of units that need no calibration of their own."""


def set_point_of(log: Log) -> str:
    """Return the one channel whose name says that it is a set point; `InputError` where there is none or several."""
    named = [
        name for name in log.channels if re.search(r"set[ _-]?point|n[ _-]?set|soll", name, re.IGNORECASE)
    ]
    if len(named) != 1:
        raise InputError(
            f"{log.name}: {'several channels are' if named else 'no channel is'} called a set point, found "
            f"{', '.join(named or log.channels)}; name it with --set-point"
        )
    return named[0]


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
    set_point: str,
    trains: Mapping[str, float],
    windows: Sequence[FoundWindow],
    rate_hz: float | None = None,
) -> str:
    """Return the template of a TRIAL.toml with what a log tells: its channels, steady stretch and windows.

    Parameters
    ----------
    template
        That of `support.toml.template`, whose tables stand apart by an empty line each.
    log, path
        The log and where it lies.
    set_point
        Channel of the set point.
    trains
        Channels that are pulse trains, with pulses per second.
    windows
        What was found in the set point.
    rate_hz
        Sample rate, where the log told none.
    """
    tables = {_header(table): table for table in template.split("\n\n")}
    tables["trial"] = _with(tables["trial"], "log", json.dumps(str(path)))
    if rate_hz is not None:
        tables["trial"] = re.sub(
            "^# rate_hz = .*", f"rate_hz = {rate_hz!r}", tables["trial"], flags=re.MULTILINE
        )
    there = (f"{one.name}{f' [{one.unit}]' if one.unit else ''}" for one in log.channels.values())
    about = f"# The log has {', '.join(there)}.\n"
    tables["channels.set_point"] = about + _of(log.channel(set_point), tables["channels.set_point"], TO_RPM)
    torques = [
        name
        for name in log.channels
        if name != set_point and name not in trains and re.search(TORQUE, name, re.IGNORECASE)
    ]
    if len(torques) == 1:
        tables["channels.torque"] = _of(log.channel(torques[0]), tables["channels.torque"], TO_NM)
    else:
        tables["channels.torque"] = re.sub("^", "# ", tables["channels.torque"], flags=re.MULTILINE)
    if trains:
        del tables["channels.PTM_e"]
        tables["channels.PTM_4"] = "\n\n".join(_train(*train) for train in trains.items())
    rest = longest_rest(windows)
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


def _train(name: str, pulses_hz: float) -> str:
    """Return the table of a pulse train, of which the log does not tell where it is."""
    return (
        f"[channels.{json.dumps(name)}]\n"
        f"column = {json.dumps(name)}\n"
        f"pulses_per_rev = 1              # {pulses_hz:.4g} pulses a second in its first two minutes\n"
        'shaft = "engine"                # or "propeller"'
    )
