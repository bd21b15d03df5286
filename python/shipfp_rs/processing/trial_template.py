"""Windows found in a log, written into a TRIAL.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit

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
    tables = tomlkit.aot()
    for window in windows:
        if window.kind == "steady":
            continue
        kind = tomlkit.string(window.kind)
        if window.frequency_hz is not None:
            first, last = window.frequency_hz
            kind.comment(f"{first:.4g} Hz" if window.kind == "sine" else f"{first:.4g} to {last:.4g} Hz")
        start_s, stop_s = round(window.start_s, 1), round(window.stop_s, 1)
        table = tomlkit.table()
        table.update({"name": window.name, "kind": kind, "start_s": start_s, "stop_s": stop_s})
        tables.append(table)
    return tomlkit.dumps({"windows": tables}) if tables else ""


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
    if rate_hz is not None:
        template = re.sub("^# rate_hz = .*", f"rate_hz = {rate_hz!r}", template, flags=re.MULTILINE)
    blocks = {_header(block): block for block in template.split("\n\n")}
    there = (f"{one.name}{f' [{one.unit}]' if one.unit else ''}" for one in log.channels.values())
    blocks["channels.set_point"] = f"# The log has {', '.join(there)}.\n" + blocks["channels.set_point"]
    torques = [
        name
        for name in log.channels
        if name != set_point and name not in trains and re.search(TORQUE, name, re.IGNORECASE)
    ]
    if len(torques) != 1:
        blocks["channels.torque"] = re.sub("^", "# ", blocks["channels.torque"], flags=re.MULTILINE)
    if trains:
        del blocks["channels.PTM_e"]
        blocks["channels.PTM_4"] = "\n\n".join(_train(*train) for train in trains.items())
    blocks["windows"] = windows_toml(windows).rstrip() or blocks["windows"]
    filled: Any = tomlkit.parse("\n\n".join(blocks.values()))
    filled["trial"]["log"] = str(path)
    _fill(filled["channels"]["set_point"], log.channel(set_point), TO_RPM)
    if len(torques) == 1:
        _fill(filled["channels"]["torque"], log.channel(torques[0]), TO_NM)
    if (rest := longest_rest(windows)) is not None:
        filled["operating_point"]["steady_s"] = [round(rest.start_s, 1), round(rest.stop_s, 1)]
    return tomlkit.dumps(filled)


def _header(block: str) -> str:
    found = re.search(r"^(?:# )?\[+([\w.]+)", block, re.MULTILINE)
    return found[1] if found else ""


def _fill(table: Any, channel: Channel, factors: Mapping[str, float]) -> None:
    """Put a channel into its table; one of a known unit needs no calibration but that unit's factor."""
    table["column"] = channel.name
    if channel.unit:
        table["unit"] = channel.unit
    factor = factors.get(channel.unit.replace(" ", ""))
    if factor is not None:
        table["calibration"] = tomlkit.inline_table()
        table["calibration"]["scale"] = factor


def _train(name: str, pulses_hz: float) -> str:
    """Return the table of a pulse train, of which the log does not tell where it is."""
    return (
        f"[channels.{json.dumps(name)}]\n"
        f"column = {json.dumps(name)}\n"
        f"pulses_per_rev = 1              # {pulses_hz:.4g} pulses a second in its first two minutes\n"
        'shaft = "engine"                # or "propeller"'
    )
