"""Windows found in a log, written into a TRIAL.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from shipfp_rs.errors import InputError
from shipfp_rs.log import Channel, Log
from shipfp_rs.windows import FoundWindow, longest_rest


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


def filled_in(template: str, path: Path, set_point: Channel, windows: Sequence[FoundWindow]) -> str:
    """Return the template of a TRIAL.toml with a log's set point, steady stretch and windows in it."""
    text = re.sub(r'^log = "[^"]*"', f"log = {json.dumps(str(path))}", template, flags=re.MULTILINE)
    text = text.replace('column = "U_setpoint"', f"column = {json.dumps(set_point.name)}", 1)
    rest = longest_rest(windows)
    if rest is not None:
        stretch = f"steady_s = [{rest.start_s:.1f}, {rest.stop_s:.1f}]"
        text = re.sub(r"^steady_s = \[[^\]]*\]", stretch, text, flags=re.MULTILINE)
    tables = windows_toml(windows)
    if not tables:
        return text
    begin, end = text.index("[[windows]]"), text.index("[identify]")
    return text[:begin] + tables + "\n" + text[end:]
