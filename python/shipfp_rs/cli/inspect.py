"""`shipfp inspect` shows a log's contents and faults; `shipfp convert` converts a log to Parquet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shipfp_rs.cli.options import (
    Force,
    Json,
    LogFile,
    Names,
    Rate,
    Replace,
    Time,
    file_argument,
    file_option,
    folder_for,
    new_file,
    number_option,
    positive,
    print_results,
    print_table,
    print_text,
    progress,
)
from shipfp_rs.errors import InputError

if TYPE_CHECKING:
    from shipfp_rs.inspection import Inspection


def convert(
    log: LogFile,
    out: Annotated[Path, file_argument("OUT.parquet", "File to write.")],
    rate_hz: Rate = None,
    time: Time = None,
    names: Names = None,
    force: Replace = False,
) -> None:
    """Convert a log to Parquet, each channel with its unit, rate, start and type."""
    from shipfp_rs.logs.log import Log

    if out.is_file() and log.exists() and out.samefile(log):
        raise InputError(f"{out}: is the log itself; choose another name")
    new_file(out, force=force)
    source = Log.open(log, rate_hz=rate_hz, time=time, names=names)
    source.write(out)
    print_text(f"wrote {out}: {len(source.channels)} channels")
    for channel in source.channels.values():
        unit = f" [{channel.unit}]" if channel.unit else ""
        print_text(f"  {channel.name}{unit}: {channel.samples} samples at {channel.rate_hz:g} Hz")
    print_text(*source.notes)


MARKER = "inspection.json"
PICTURES = ("windows.png", "static-torque.png", *(f"spectrum-{number}.png" for number in range(1, 1000)))


def inspect(
    log: LogFile,
    trial: Annotated[Path | None, file_argument("[TRIAL.toml]", "Its trial, for calibrated checks.")] = None,
    rate_hz: Rate = None,
    time: Time = None,
    names: Names = None,
    torque_coefficient: Annotated[
        float | None,
        number_option("C_Q*", "Torque coefficient of eq. 6.3, in place of the vessel's.", positive, "--cq"),
    ] = None,
    out: Annotated[Path | None, file_option("DIR", "Folder for inspection.json and pictures.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a log's channels, gaps, faults, windows and spectra; with its TRIAL.toml, calibrated checks as well."""
    from shipfp_rs.inspection import inspect_log
    from shipfp_rs.logs.log import Log
    from shipfp_rs.processing.trial import Trial

    if log.suffix == ".toml":
        raise InputError(f"{log}: a TRIAL.toml, expected the log first: shipfp inspect LOG {log}")
    if torque_coefficient is not None and trial is None:
        raise InputError("--cq: expected together with a TRIAL.toml, whose torque it checks")
    description = Trial.load(trial) if trial is not None else None
    told = description.trial if description else None
    recording = Log.open(
        log,
        rate_hz=rate_hz or (told.rate_hz if told else None),
        time=time if time is not None or told is None else told.time_column,
        names=names or (told.names if told else None),
    )
    with folder_for(out, MARKER, PICTURES, force=force) as folder, progress() as notify:
        notify("reading the log")
        found = inspect_log(recording, description, C_Q=torque_coefficient)
        if folder is not None:
            from shipfp_rs.inspection.pictures import draw  # Matplotlib
            from shipfp_rs.support.files import json_text

            (folder / MARKER).write_text(json_text(found.to_dict()), encoding="utf-8")
            draw(found, recording, folder)

    def show() -> None:
        _print(found)
        if description is not None and description.channels.command is None and not found.points:
            print_text(
                "Nothing rests for 8 s: set point, speed and torque can't be compared at a steady point."
            )
        print_text(*recording.notes)

    print_results(found.to_dict(), show, out, json=json)


def _print(found: Inspection) -> None:
    from shipfp_rs.inspection.channels import sentences
    from shipfp_rs.processing.trial_template import windows_toml

    late = any(report.channel.start_s for report in found.channels)
    table = []
    for report in found.channels:
        about, pulses = report.channel, report.pulses_hz
        recorded = (f"{about.rate_hz:g}", f"{about.samples}", *[f"{about.start_s:g}"] * late)
        noise = f"{report.noise:.2g}" if pulses is None else ""
        seen = (f"{report.low:.5g}", f"{report.high:.5g}", noise, "" if pulses is None else f"{pulses:.2f}")
        table.append([about.name, about.unit, *recorded, *seen, f"{len(report.gaps)}"])
    head = ["channel", "unit", "Hz", "samples", *["start [s]"] * late]
    print_table(f"Channels of {found.log}", [*head, "low", "high", "noise", "pulses/s", "gaps"], table)
    if found.faults:
        rows = [[fault["kind"], fault["channel"], f"{fault['count']}"] for fault in found.faults]
        print_table("Faults (Table 6.10)", ["kind", "channel", "count"], rows)
    else:
        print_text("No faults found of those looked for.")
    print_text(*sentences(found.checks["looked_for"], trial=bool(found.points)))
    for channel, peaks in found.peaks.items():
        unit = found.checks["spectra"][channel]["unit"]
        rows = [[peak.name or "-", f"{peak.frequency_hz:.2f}", f"{peak.amplitude:.3g}"] for peak in peaks]
        if rows:
            print_table(f"Lines of {channel}", ["line", "Hz", f"amplitude [{unit}]"], rows)
    _print_checks(found)
    if tables := windows_toml(found.windows):
        print_text("Windows, to paste into TRIAL.toml:", "", tables)


def _print_checks(found: Inspection) -> None:
    checks = found.checks
    if "set_point_to_speed" not in checks:
        return
    line, trains = checks["set_point_to_speed"], checks["pulse_trains"]
    if line["slope"] is None:
        fitted = f"within {line['largest_difference_rpm']:.1f} rpm of each other"
    else:
        fitted = f"n_e = {line['slope']:.4f} n_set {line['offset_rpm']:+.1f} rpm"
        if line["largest_residual_rpm"] is not None:
            fitted += f", largest residual {line['largest_residual_rpm']:.1f} rpm"
    reflectors = ", ".join(f"{error:+.2f}" for error in trains["reflector_error_pct_of_pitch"])
    noise = ", ".join(f"{name} {value['std']:.3g} {value['unit']}" for name, value in checks["noise"].items())
    bandwidth = checks["bandwidth_hz"]
    print_text(
        f"Set point and speed, {line['points']} steady points: {fitted}.",
        f"Pulse trains agree to {trains['largest_disagreement_pct']:.3f} %; {trains['train']} is the best, its "
        f"reflectors off by {reflectors} % of their pitch.",
        f"Standard deviation at rest: {noise}.",
        f"Bandwidth: speed {bandwidth['speed']:.1f} Hz, signals {bandwidth['signals']:.1f} Hz.",
    )
    if "static_torque" in checks:
        static = checks["static_torque"]
        columns = (static[key] for key in ("n_e_rpm", "measured_Nm", "calculated_Nm", "error_pct"))
        rows = [
            [f"{speed:.1f}", f"{ours:.1f}", f"{theirs:.1f}", f"{error:.2f}"]
            for speed, ours, theirs, error in zip(*columns, strict=True)
        ]
        print_table(
            "Static torque (eq. 6.3)", ["n_e [rpm]", "measured [Nm]", "calculated [Nm]", "error [%]"], rows
        )
        if static["exponent"] is not None:
            print_text(f"The measured torque goes with n^{static['exponent']:.3f}.")
