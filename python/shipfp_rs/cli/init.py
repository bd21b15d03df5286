"""`shipfp init`: writes a commented TRIAL.toml, filled in from a log; a vessel file; or a SWEEP.toml."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.options import Names, Rate, Time, file_argument, file_option, print_text, progress
from shipfp_rs.errors import InputError


def init(
    folder: Annotated[Path, file_argument("DIR", "Folder of the trial.")] = Path(),
    log: Annotated[
        list[Path] | None,
        file_option("LOG", "Log whose windows are to be found; once for each logger of a common clock."),
    ] = None,
    set_point: Annotated[
        str | None, typer.Option(metavar="CHANNEL", help="Its set point; by default the channel called so.")
    ] = None,
    rate_hz: Rate = None,
    time: Time = None,
    names: Names = None,
    vessel: Annotated[bool, typer.Option("--vessel", help="Write a commented vessel file instead.")] = False,
    sweep: Annotated[bool, typer.Option("--sweep", help="Write a commented SWEEP.toml instead.")] = False,
) -> None:
    """Write a commented TRIAL.toml; with --log it is filled in from the log, and missing values are marked."""
    from shipfp_rs.support.toml import TO_BE_GIVEN, template

    if folder.is_file():
        raise InputError(
            f"{folder}: found a file, expected a folder; to write TRIAL.toml from this log: shipfp init --log {folder}"
        )
    given = {"--set-point": set_point, "--rate": rate_hz, "--time": time, "--names": names}
    if not log and (idle := [option for option, value in given.items() if value is not None]):
        raise InputError(f"{idle[0]}: expected only together with --log")
    if sweep:
        if log:
            raise InputError("--sweep: expected it without --log; a sweep has no log")
        path = folder / "SWEEP.toml"
        _write(path, template("SWEEP"), f"Fill in ship, factors and noise, then: shipfp sweep {path}")
        return
    if vessel:
        path = folder / "vessel.toml"
        told = (
            f"Fill in the gear ratio, and what else is known; name it in TRIAL.toml: vessel = {path.name!r}"
        )
        _write(path, template("VESSEL"), told)
        return
    path = _new(folder / "TRIAL.toml")
    text, what = template("TRIAL"), "Fill in ship, calibrations and pulses"
    if log:
        text = _of_logs(text, log, set_point, rate_hz, time, names)
        left = text.count(f'= "{TO_BE_GIVEN}"')
        what = f"Give what is marked {TO_BE_GIVEN!r} ({left})" if left else "Look it through"
    _write(path, text, f"{what}, then: shipfp run {path}")


def _of_logs(
    text: str,
    paths: Sequence[Path],
    set_point: str | None,
    rate_hz: float | None,
    time: str | None,
    names: Path | None,
) -> str:
    """Fill in TRIAL.toml from logs; unknown values are marked and listed."""
    from shipfp_rs.inspection.channels import pulse_rate
    from shipfp_rs.logs.log import Log, Rows
    from shipfp_rs.processing.roles import guess_roles
    from shipfp_rs.processing.trial_template import drafted, moved
    from shipfp_rs.processing.windows import FoundWindow

    logs = [Log.open(path, rate_hz=rate_hz, time=time, names=names) for path in paths]
    log = logs[0] if len(logs) == 1 else Log.merge(*logs)
    if set_point is not None:
        log.channel(set_point)
    found: list[FoundWindow] = []
    mover = None
    with progress() as notify:
        notify("looking for the set point, pulse trains and windows")
        roles = guess_roles(log, lambda name: pulse_rate(Rows(log, name)), set_point)
        inputs = (roles.set_point, roles.command, roles.torque, roles.actuator, roles.load)
        roled = {*filter(None, inputs), *roles.speeds, *roles.trains}
        spans = [(log.channel(name).start_s, log.channel(name).stop_s) for name in roled]
        shared = (max(start for start, _ in spans), min(stop for _, stop in spans)) if spans else ()
        try:
            mover, found = moved(log, roles.set_point or roles.command, roles.load, *shared)
            kinds = ", ".join(f"{window.name} {window.start_s:g} to {window.stop_s:g} s" for window in found)
            told = f"{', '.join(map(str, paths))}, {mover}: {kinds}"
            if all(window.kind == "steady" for window in found):
                told += "; nothing but rest"
        except InputError as error:
            told = f"no windows found: {error}"
    idle = [
        f"{name} [{channel.unit}]" if channel.unit else name
        for name, channel in log.channels.items()
        if name not in roled
    ]
    print_text(*log.notes, told, *([f"not used: {', '.join(idle)}"] if idle else []))
    if roles.trains:
        pulses = ", ".join(f"{name} at {rate:.4g} Hz" for name, rate in roles.trains.items())
        print_text(f"pulse trains: {pulses}")
    elif roles.speeds:
        print_text(f"no channel is a pulse train; the speed is {', '.join(roles.speeds)}, as recorded")
    else:
        print_text("no channel is a pulse train or a speed by its unit; give one in the file")
    return drafted(
        text,
        log,
        [path.resolve() for path in paths],
        roles,
        found,
        mover=mover,
        rate_hz=rate_hz,
        time=time,
        names=names,
    )


def _new(path: Path) -> Path:
    if path.exists():
        raise InputError(f"{path}: exists already; rename it or choose another folder")
    return path


def _write(path: Path, text: str, told: str) -> None:
    from shipfp_rs.support.files import write_text_atomically

    write_text_atomically(_new(path), text)
    print_text(f"wrote {path}", told)
