"""`shipfp init`: a commented TRIAL.toml with what a log shows, a vessel file, or a SWEEP.toml, to fill in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.options import Names, Rate, Time, a_path
from shipfp_rs.cli.output import print_text, progress
from shipfp_rs.errors import InputError


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", parser=a_path, help="Folder of the trial.")
    ] = Path(),
    log: Annotated[
        Path | None,
        typer.Option("--log", metavar="LOG", parser=a_path, help="Log whose windows are to be found."),
    ] = None,
    set_point: Annotated[
        str | None,
        typer.Option(
            "--set-point", metavar="CHANNEL", help="Its set point; by default the channel called so."
        ),
    ] = None,
    rate_hz: Rate = None,
    time: Time = None,
    names: Names = None,
    vessel: Annotated[bool, typer.Option("--vessel", help="Write a commented vessel file instead.")] = False,
    sweep: Annotated[bool, typer.Option("--sweep", help="Write a commented SWEEP.toml instead.")] = False,
) -> None:
    """Write a commented TRIAL.toml to fill in; with --log that log's channels, excitations and steady stretch are in it."""
    from shipfp_rs.support.toml import template

    given = {"--set-point": set_point, "--rate": rate_hz, "--time": time, "--names": names}
    if log is None and (idle := [option for option, value in given.items() if value is not None]):
        raise InputError(f"{idle[0]}: expected --log with it, the log that it is about")
    if sweep:
        if log is not None:
            raise InputError("--sweep: expected it without --log; a sweep has no log")
        _write(folder / "SWEEP.toml", template("SWEEP"), "sweep", "ship, factors and noise")
        return
    if vessel:
        _write(folder / "vessel.toml", template("VESSEL"), "", "the gear ratio, and what else is known")
        return
    path = _new(folder / "TRIAL.toml")
    text = template("TRIAL")
    if log is not None:
        text = _of_log(text, log, set_point, rate_hz, time, names)
    _write(path, text, "run", "ship, calibrations and pulses")


def _of_log(
    text: str, path: Path, set_point: str | None, rate_hz: float | None, time: str | None, names: Path | None
) -> str:
    """Fill in what a log tells; whatever it does not tell stays an example, and is said."""
    from shipfp_rs.inspection.pulse_channels import pulse_rate
    from shipfp_rs.logs.channel_reader import Rows
    from shipfp_rs.logs.log import Log
    from shipfp_rs.processing.roles import guess_roles
    from shipfp_rs.processing.trial_template import filled_in
    from shipfp_rs.processing.windows import FoundWindow, find_windows

    log = Log.open(path, rate_hz=rate_hz, time=time, names=names)
    if set_point is not None:
        log.channel(set_point)
    with progress() as notify:
        notify("looking for pulse trains, the set point and windows")
        rates = {name: pulse_rate(Rows(log, name)) for name in log.channels if name != set_point}
        trains = {name: rate for name, rate in rates.items() if rate is not None}
        roles = guess_roles(log, trains, set_point)
        found: list[FoundWindow] = []
        told = "no set point found: name its channel in the file, or with --set-point"
        if roles.set_point is not None:
            try:
                found = find_windows(log, roles.set_point)
                kinds = ", ".join(
                    f"{window.name} {window.start_s:g} to {window.stop_s:g} s" for window in found
                )
                told = f"{path}, {roles.set_point}: {kinds}"
            except InputError as error:
                told = f"no windows found: {error}"
    print_text(*log.notes, told)
    if trains:
        pulses = ", ".join(f"{name} at {rate:.4g} Hz" for name, rate in trains.items())
        print_text(f"pulse trains: {pulses}; say in the file where each is and how many it gives a turn")
    elif roles.speeds:
        print_text(f"no channel is a pulse train; the speed is {', '.join(roles.speeds)}, as recorded")
    else:
        print_text("no channel is a pulse train or a speed by its unit; give one in the file")
    if found and all(window.kind == "steady" for window in found):
        print_text("nothing but rest: the windows in the file are examples")
    return filled_in(text, log, path.resolve(), roles, trains, found, rate_hz, time, names)


def _new(path: Path) -> Path:
    if path.exists():
        raise InputError(f"{path}: exists already; rename it or choose another folder")
    return path


def _write(path: Path, text: str, command: str, what: str) -> None:
    from shipfp_rs.support.files import write_text_atomically

    write_text_atomically(_new(path), text)
    then = (
        f", then: shipfp {command} {path}" if command else f"; name it in TRIAL.toml: vessel = {path.name!r}"
    )
    print_text(f"wrote {path}", f"Fill in {what}{then}")
