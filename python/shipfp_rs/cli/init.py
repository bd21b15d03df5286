"""`shipfp init`: a commented TRIAL.toml to fill in, with the windows that a log shows, or a SWEEP.toml."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from shipfp_rs.cli.output import print_text, progress
from shipfp_rs.errors import InputError

if TYPE_CHECKING:
    from shipfp_rs.logs.log import Log


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the trial.")] = Path(),
    log: Annotated[
        Path | None, typer.Option("--log", metavar="LOG", help="Log whose windows are to be found.")
    ] = None,
    set_point: Annotated[
        str | None,
        typer.Option(
            "--set-point", metavar="CHANNEL", help="Its set point; by default the channel called so."
        ),
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Sample rate, where the log tells none.")
    ] = None,
    sweep: Annotated[bool, typer.Option("--sweep", help="Write a commented SWEEP.toml instead.")] = False,
) -> None:
    """Write a commented TRIAL.toml to fill in; with --log that log's channels, excitations and steady stretch are in it."""
    if sweep:
        if log is not None:
            raise InputError("--sweep: expected it without --log; a sweep has no log")
        from shipfp_rs.sweeps.template import SWEEP_TEMPLATE

        _write(folder / "SWEEP.toml", SWEEP_TEMPLATE, "sweep", "ship, factors and noise")
        return
    from shipfp_rs.processing.trial import TRIAL_TEMPLATE

    path = _new(folder / "TRIAL.toml")
    text = TRIAL_TEMPLATE
    if log is not None:
        from shipfp_rs.inspection.pulse_channels import pulse_rate
        from shipfp_rs.logs.channel_reader import Rows
        from shipfp_rs.logs.log import Log
        from shipfp_rs.processing.trial_template import filled_in, set_point_of
        from shipfp_rs.processing.windows import find_windows

        recording = Log.open(log, rate_hz=rate_hz)
        with progress() as notify:
            notify("looking for windows")
            channel = set_point or set_point_of(recording)
            found = find_windows(recording, channel) if _is_long(recording, channel) else []
            rates = {
                name: pulse_rate(Rows(recording, name)) for name in recording.channels if name != channel
            }
        trains = {name: rate for name, rate in rates.items() if rate is not None}
        text = filled_in(text, recording, log.resolve(), channel, trains, found, rate_hz)
        kinds = (
            "no windows"
            if not found
            else ", ".join(f"{window.name} {window.start_s:g} to {window.stop_s:g} s" for window in found)
        )
        print_text(f"{log}, {channel}: {kinds}")
        if trains:
            told = ", ".join(f"{name} at {rate:.4g} Hz" for name, rate in trains.items())
            print_text(f"pulse trains: {told}; say in the file where each is and how many it gives a turn")
        else:
            print_text(
                "no channel is a pulse train, from which speed is found; of a speed recorded as such make a "
                "shipfp_rs.Experiment in Python"
            )
        if not found:
            print_text("too short to find windows in: those in the file are examples")
        elif all(window.kind == "steady" for window in found):
            print_text("nothing but rest: the windows in the file are examples")
    _write(path, text, "run", "ship, calibrations and pulses")


def _is_long(recording: Log, channel: str) -> bool:
    from shipfp_rs.processing.windows import LEAST_REST_S

    about = recording.channel(channel)
    # Of one that is sampled too slowly it is told that it is.
    return about.samples >= LEAST_REST_S * about.rate_hz or about.rate_hz < 20.0


def _new(path: Path) -> Path:
    if path.exists():
        raise InputError(f"{path}: is there already; rename it or choose another folder")
    return path


def _write(path: Path, text: str, command: str, what: str) -> None:
    from shipfp_rs.support.files import write_text_atomically

    write_text_atomically(_new(path), text)
    print_text(f"wrote {path}", f"Fill in {what}, then: shipfp {command} {path}")
