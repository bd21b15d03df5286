"""Draft of a TRIAL.toml from a log. Each guess has its reason; values that the user must give are marked."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import tomlkit

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.roles import Roles
from shipfp_rs.processing.trial import Processing
from shipfp_rs.processing.trial_channels import SCALING, wanted_line
from shipfp_rs.processing.windows import FoundWindow, is_held, longest_rest, proposed
from shipfp_rs.support.toml import TO_BE_GIVEN
from shipfp_rs.support.units import TO_NM, TO_REV, TO_RPM, TO_W

KEPT = ("processing", "processing.torque_spikes", "processing.set_point_jumps", "processing.faults")
"""Tables of the template that have only settings and do not depend on a log."""
SELDOM_HZ = 100.0
"""Highest rate [Hz] of a set point that may come from a bus or PLC, whose stairs would be visible in the torque."""
LEAST_LOAD = 0.1
"""Least level of a constant load at which a stretch is under load, relative to the load's largest level."""


def windows_toml(windows: Sequence[FoundWindow]) -> str:
    """Text of the [[windows]] tables of a TRIAL.toml, without stretches at rest; frequencies are comments."""
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
            "start_s = {:.1f}\nstop_s = {:.1f}\n".format(*_within(window))
        )
    return "\n".join(lines)


def _within(window: FoundWindow) -> tuple[float, float]:
    """Start and stop of a window [s], rounded inwards to a tenth of a second."""
    return math.ceil(10.0 * window.start_s - 1e-6) / 10.0, math.floor(10.0 * window.stop_s + 1e-6) / 10.0


def moved(
    log: Log, driver: str | None, load: str | None, start_s: float = -math.inf, stop_s: float = math.inf
) -> tuple[str, list[FoundWindow]]:
    """Channel that defines the windows (the load if set point or command is constant), and the windows of a stretch."""
    driver = driver or load
    if driver is None:
        raise InputError("no set point found: name its channel in the file, or with --set-point")
    drives = list(dict.fromkeys([driver, load or driver]))
    found = proposed(log, drives, driver, start_s, stop_s)
    if load is not None and all(window.kind == "steady" for window in found):
        by_load = proposed(log, drives, load, start_s, stop_s)
        if any(window.kind != "steady" for window in by_load):
            return load, by_load
    return driver, found


def operating_rest(windows: Sequence[FoundWindow], *, by_load: bool) -> FoundWindow | None:
    """Stretch at rest whose mean becomes the operating point; if the load defines the windows, preferably one under load."""
    if by_load:
        largest = max(abs(window.level) for window in windows)
        loaded = [w for w in windows if w.kind != "steady" or abs(w.level) > LEAST_LOAD * largest]
        return longest_rest(loaded) or longest_rest(windows)
    return longest_rest(windows)


def drafted(
    template: str,
    log: Log,
    paths: Sequence[Path],
    roles: Roles,
    windows: Sequence[FoundWindow],
    *,
    mover: str | None = None,
    rate_hz: float | None = None,
    time: str | None = None,
    names: Path | None = None,
) -> str:
    """Text of a TRIAL.toml for a log, from the template, the guessed roles and the detected windows."""
    kept = {_header(table): table for table in template.split("\n\n")}
    torque = [log.channel(roles.torque).rate_hz] if roles.torque is not None else []
    speeds = (log.channel(name).rate_hz for name in ([] if roles.trains else roles.speeds))
    rate, usual = common_rate(torque, speeds), f"rate_hz = {Processing().rate_hz}"
    kept["processing"] = kept["processing"].replace(
        usual, f"rate_hz = {rate:.9g}", rate < Processing().rate_hz
    )
    given = {
        "rate_hz": rate_hz,
        "time_column": time,
        "names": None if names is None else str(names.resolve()),
    }
    places = [str(path) for path in paths]
    header = {"name": paths[0].stem[:200], "log": places[0] if len(places) == 1 else places, **given}
    trial = "[trial]\n" + _keys({key: value for key, value in header.items() if value is not None})
    clock = (
        ["[align]  # the loggers share one clock\n" + _keys({"reference": paths[0].name})]
        if len(paths) > 1
        else []
    )
    if "propeller" in roles.speeds.values():
        trial += (
            "\n# vessel = the path of a vessel file with the gear ratio: the speed is that of the other shaft"
        )
    tables = [
        "# A trial: one ship, its raw log, and what to find in it. Run it with `shipfp run TRIAL.toml`.",
        trial,
        *clock,
        _about(log, roles),
        *_channels(log, roles, windows),
        _operating_point(log, roles, windows, mover),
        *(kept[key] for key in KEPT),
        windows_toml(windows).rstrip()
        or "# No window was found: add tables [[windows]] with name, start_s and stop_s.",
        *(table for header, table in kept.items() if header in ("identify", "report")),
    ]
    return "\n\n".join(tables)


def _channels(log: Log, roles: Roles, windows: Sequence[FoundWindow]) -> list[str]:
    if roles.command is not None:
        tables = [
            _level("command", log.channel(roles.command), roles, {roles.named[roles.command].unit: 1.0}, "")
        ]
    elif roles.set_point is None:
        tables = [_resting(log, roles, windows)]
    else:
        tables = [_level("set_point", log.channel(roles.set_point), roles, TO_RPM, "rpm") + _held(log, roles)]
    if roles.torque is not None:
        torque = _level("torque", log.channel(roles.torque), roles, TO_NM, "Nm")
        tables.append(f'{torque}\nlocation = "{roles.location}"  # {roles.located_by}')
    if roles.load is not None:
        power = roles.named[roles.load].unit in TO_W
        units, to, what = (TO_W, "W", "power") if power else (TO_NM, "Nm", "torque")
        table = f'{_level("load", log.channel(roles.load), roles, units, to)}\nquantity = "{what}"'
        # Electric power is less than the shaft's by the generator's losses, so the template offers the efficiency.
        losses = f"\n# efficiency = 0.95  # {SCALING['efficiency'][1]}" if power else ""
        tables.append(table + losses)
    told = {name for name in roles.speeds if roles.named[name].unit in {*TO_RPM, *TO_REV}}
    # Sources that need a value from the user are omitted if another channel gives the speed without it.
    tables += [_speed(name, roles) for name in roles.speeds if name in told or not (told or roles.pulses)]
    tables += [_train(name, roles) for name in roles.trains if name in roles.pulses or not told]
    if not roles.speeds and not roles.trains:
        tables.append(f'[channels.speed]\ncolumn = "{TO_BE_GIVEN}"\nunit = "rpm"')
    return tables


def _held(log: Log, roles: Roles) -> str:
    """Key `held` if the set point is as slow as a bus or PLC and not faster than the torque; a comment if uncertain."""
    if roles.set_point is None or roles.torque is None:
        return ""
    if log.channel(roles.set_point).rate_hz > min(SELDOM_HZ, log.channel(roles.torque).rate_hz):
        return ""
    mark = "" if is_held(log.channel(roles.set_point)) else "# "
    return f"\n{mark}held = true                 # of a bus or PLC: the drive holds each value until the next one comes"


def _resting(log: Log, roles: Roles, windows: Sequence[FoundWindow]) -> str:
    """Table of a constant set point that was not recorded; its value is the mean speed while the load is constant."""
    rest = operating_rest(windows, by_load=True) if windows and roles.load is not None else None
    moving = windows if roles.load is not None else []
    rpm = _mean(log, roles, next(iter(roles.speeds), None), moving if rest is None else [rest], TO_RPM)
    if rpm is None:
        return f'[channels.set_point]\ncolumn = "{TO_BE_GIVEN}"\nunit = ""'
    told = f"{rpm:.6g}  # the speed's mean"
    if roles.named[next(iter(roles.speeds))].quantity == "frequency":
        told = f'"{TO_BE_GIVEN}"  # {rpm:.6g} / pole_pairs, the speed\'s mean'
    return f"[channels.set_point]            # not in the log; the load alone moves\nrpm = {told}"


def _level(key: str, channel: Channel, roles: Roles, factors: Mapping[str, float], to: str) -> str:
    """Table of a calibrated channel; a known unit needs no calibration."""
    unit = roles.named[channel.name].unit
    table = f"[channels.{key}]\n" + _keys({"column": channel.name, "unit": unit})
    if unit == "%" and to == "Nm":
        return f'{table}\nrated_torque_Nm = "{TO_BE_GIVEN}"  # {SCALING["rated_torque_Nm"][1]}'
    return table if unit in factors else f"{table}\n{_asked_line(unit, to)}"


def _asked_line(unit: str, to: str) -> str:
    return f'calibration = "{TO_BE_GIVEN}"  # {_comment(wanted_line(unit, to))}'


def _speed(name: str, roles: Roles) -> str:
    """Table of a recorded speed, or of an encoder's angle."""
    unit = roles.named[name].unit
    known = unit in TO_RPM or unit in TO_REV
    keys = {"column": name, "unit": unit if known or unit == "%" else "rpm", "shaft": roles.speeds[name]}
    table = f"[channels.{_key(name)}]\n{_keys(keys)}"
    if roles.named[name].quantity == "frequency":
        return f'{table}\npole_pairs = "{TO_BE_GIVEN}"  # {SCALING["pole_pairs"][1]}'
    return table if known else f"{table}\n{_asked_line(unit, 'rpm')}"


def _train(name: str, roles: Roles) -> str:
    """Table of a pulse train; its shaft is known only if another channel gives the speed."""
    count = roles.pulses.get(name)
    keys = {
        "column": name,
        "pulses_per_rev": count or TO_BE_GIVEN,
        "shaft": "engine" if count else TO_BE_GIVEN,
    }
    return f"[channels.{_key(name)}]\n{_keys(keys)}"


def _operating_point(log: Log, roles: Roles, windows: Sequence[FoundWindow], mover: str | None) -> str:
    """Table of the operating point: a steady stretch, or means over the windows if nothing rests."""
    rest = operating_rest(windows, by_load=mover is not None and mover == roles.load)
    if rest is not None:
        start_s, stop_s = _within(rest)
        return (
            f"[operating_point]               # means over a rest\nsteady_s = [{start_s:.1f}, {stop_s:.1f}]"
        )
    if roles.command is not None:
        return "[operating_point]               # nothing rests in the log: means over its windows"
    means = {
        "n_e_rpm": _mean(log, roles, next(iter(roles.speeds), roles.set_point), windows, TO_RPM),
        "M_Nm": _mean(log, roles, roles.torque, windows, TO_NM),
    }
    known = _keys({key: float(f"{value:.6g}") for key, value in means.items() if value is not None})
    lines = known or "# steady_s = [start, stop] of a stretch with a constant set point"
    return f"[operating_point]               # nothing rests in the log: means over its windows\n{lines}"


def _mean(
    log: Log, roles: Roles, name: str | None, windows: Sequence[FoundWindow], factors: Mapping[str, float]
) -> float | None:
    factor = None if name is None else factors.get(roles.named[name].unit)
    if name is None or factor is None or not windows:
        return None
    pieces = [
        np.asarray(log.read(name, window.start_s, window.stop_s), dtype=np.float64) for window in windows
    ]
    return factor * float(np.nanmean(np.concatenate(pieces)))


def common_rate(levels_hz: Iterable[float], speeds_hz: Iterable[float]) -> float:
    """Rate of the processing [Hz]: at most that of torque and rack, and that of the fastest recorded speed."""
    return min([Processing().rate_hz, max(speeds_hz, default=math.inf), *levels_hz])


def _about(log: Log, roles: Roles) -> str:
    lines = [
        _comment(
            f"# {one.name}{f' [{one.unit}]' if one.unit else ''}, {one.rate_hz:g} Hz: {roles.reasons.get(one.name, '')}"
        )
        for one in log.channels.values()
    ]
    if not (roles.set_point or roles.command or roles.load):
        lines.append("# No set point was found: name its channel below.")
    return "\n".join(["# The log's channels, and what each is taken for:", *lines])


def _comment(text: str) -> str:
    return re.sub(r"[\x00-\x1f\x7f\ud800-\udfff]", "?", text)


def _keys(keys: Mapping[str, object]) -> str:
    return "\n".join(f"{key} = {tomlkit.item(value).as_string()}" for key, value in keys.items())


def _key(name: str) -> str:
    """Key of a channel's table: the channel's name, changed if it is a key such as "load"."""
    taken = ("set_point", "command", "torque", "rack", "actuator", "load")
    return tomlkit.item(f"{name} of a shaft" if name in taken else name).as_string()


def _header(table: str) -> str:
    found = re.search(r"^(?:# )?\[+([\w.]+)", table, re.MULTILINE)
    return found[1] if found else ""
