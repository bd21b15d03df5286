"""`shipfp design`: a trial's plan, with time series, run sheet, generator files and predicted standard deviations."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from shipfp_rs.cli.options import (
    LARGEST,
    Force,
    Json,
    OutFolder,
    as_typed,
    file_option,
    footnotes,
    number_option,
    print_results,
    print_table,
    print_text,
    progress,
    vessels,
)
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import between
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    from shipfp_rs.designs import Generator, Noise, Plan
    from shipfp_rs.identification.draws import Draws
    from shipfp_rs.identification.fingerprint import Fingerprint


Kind = Literal["mix", "sines", "squares", "multisine", "chirp"]
TYPED = {
    "neither duration_s nor accuracy_pct": "neither --duration nor --accuracy",
    "duration_s": "--duration",
    "accuracy_pct": "--accuracy",
    "amplitude_rpm": "--amplitude",
    "parameters": "--parameter",
    "rate_rpm_s": "--rate-limit",
    "avoid_hz": "--avoid",
    "lowest_hz": "--lowest",
    "highest_hz": "--highest",
    "longest_samples": "--longest",
    "generator": "--volts",
    "noise corner_hz": "--noise-corner",
}
"""Command-line options by argument of `designs.design`."""


def design(
    expected: Annotated[
        str,
        typer.Argument(
            metavar="VESSEL",
            autocompletion=vessels,
            help="Built-in ship, vessel file, or the fingerprint.json of an earlier trial.",
        ),
    ],
    duration: Annotated[
        float | None, number_option("S", "Length of the whole trial, s; without it what --accuracy takes.")
    ] = None,
    amplitude: Annotated[
        float | None,
        number_option("RPM", "Largest deviation, engine rpm; default 3 % of the operating speed."),
    ] = None,
    accuracy: Annotated[
        float | None,
        number_option("PERCENT", "Wanted standard deviation of each parameter over its value, %."),
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter that --accuracy is for, may be repeated; default all that small motions tell."
        ),
    ] = None,
    kind: Annotated[Kind, typer.Option(help="What is put on the set point.")] = "mix",
    criterion: Annotated[
        Literal["D", "A"],
        typer.Option(help="Small volume of the ellipsoid (D) or small sum of variances (A)."),
    ] = "D",
    rate_limit: Annotated[float | None, number_option("RPM/S", "Largest rate of change, rpm/s.")] = None,
    avoid: Annotated[
        list[str] | None,
        typer.Option(metavar="LOW:HIGH", help="Band to stay out of, Hz, may be repeated: 2.4:2.8"),
    ] = None,
    lowest: Annotated[float | None, number_option("HZ", "Lowest frequency, Hz.")] = None,
    highest: Annotated[float | None, number_option("HZ", "Highest frequency, Hz.")] = None,
    longest: Annotated[
        int | None, typer.Option(min=1, max=10**9, help="Longest waveform of the signal generator, samples.")
    ] = None,
    volts: Annotated[
        str, typer.Option(metavar="LOW:HIGH", help="Range of the signal generator, V.")
    ] = "-10:10",
    trial: Annotated[
        Path | None, file_option("TRIAL.toml", "Trial whose set-point calibration the generator has.")
    ] = None,
    speed_noise: Annotated[
        float | None, number_option("PERCENT", "Noise of the speed over the operating speed, %.")
    ] = None,
    torque_noise: Annotated[
        float | None, number_option("PERCENT", "Noise of the torque over the operating torque, %.")
    ] = None,
    noise_corner: Annotated[float, number_option("HZ", "Frequency above which both fall, Hz.")] = 10.0,
    gauge_accuracy: Annotated[
        float, number_option("PERCENT", "Smooth error that calibration leaves open, %, of speed and torque.")
    ] = 0.3,
    out: OutFolder = Path("shipfp-design"),
    force: Force = False,
    json: Json = False,
) -> None:
    """Plan a trial: set point, expected accuracy, and files for crew and signal generator."""
    from shipfp_rs.designs import design as plan_of
    from shipfp_rs.identification.fingerprint import Fingerprint

    bands = [_pair("--avoid", text) for text in avoid or ()]
    with progress() as notify, as_typed(TYPED):
        notify("designing")
        earlier = Fingerprint.load(expected) if expected.endswith(".json") else None
        plan = plan_of(
            earlier or expected,
            amplitude_rpm=amplitude,
            duration_s=duration,
            accuracy_pct=accuracy,
            parameters=parameter,
            kind=kind,
            criterion=criterion,
            sensors=_sensors(speed_noise, torque_noise, noise_corner, gauge_accuracy),
            rate_rpm_s=rate_limit,
            avoid_hz=bands,
            lowest_hz=lowest,
            highest_hz=highest,
            longest_samples=longest,
            generator=_generator(trial, expected, _pair("--volts", volts)),
            draws=_draws(earlier),
        )
        plan.save(out, force=force)
    print_results({"folder": str(out), **plan.to_dict()}, lambda: _print(plan), out, json=json)


def _print(plan: Plan) -> None:
    estimates = {**plan.prediction.parameters, **plan.prediction.derived}
    print_text(f"{plan.subject}: {plan.kind}, {plan.criterion}-optimal", *plan.heading())
    marks, notes = footnotes(row.reason for row in estimates.values())
    shares, table = plan.prediction.relative_pct, []
    for (name, row), mark in zip(estimates.items(), marks, strict=True):
        value = "" if row.value is None else f"{row.value:.4g}"
        std = "" if row.std is None else f"{row.std:.2g}"
        share = _percent(shares[name]) if name in shares else ""
        table.append([name, value, std, share, unit_shown(row.unit), mark])
    head = ["parameter", "expected", "std", "% of value", "unit", ""]
    if plan.spread:
        head.insert(4, "95 % of draws")
        for cells in table:
            cells.insert(4, _percent(plan.spread[cells[0]][1]) if cells[0] in plan.spread else "")
    print_table("Predicted standard deviations", head, table)
    print_text(*notes)
    if plan.needed is not None:
        met = "is met" if plan.needed.met else "is not met"
        needed = plan.needed.duration_s
        takes = f"it takes about {needed:.0f} s" if math.isfinite(needed) else "no length meets it"
        print_text(
            f"A standard deviation of {plan.needed.accuracy_pct:g} % {met}; {takes}, set by {plan.needed.limited_by}."
        )


def _draws(earlier: Fingerprint | None) -> Draws | None:
    """Draws from an earlier fingerprint, if its experiments are in the same folder; None without them."""
    from shipfp_rs.designs.subject import MOST_DRAWN

    return earlier.draws(MOST_DRAWN) if earlier and earlier.experiments and earlier.engine_described else None


def _percent(value: float) -> str:
    return f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def _pair(option: str, text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not -LARGEST < low < high < LARGEST:
        raise InputError(
            f"{option}: found {text[:60]!r}, expected LOW:HIGH, two numbers with the lower one first"
        )
    return low, high


def _sensors(
    speed: float | None, torque: float | None, corner_hz: float, accuracy: float
) -> dict[str, Noise] | None:
    from shipfp_rs.designs import Noise
    from shipfp_rs.designs.subject import LEAST_LEVEL, MOST_INACCURATE, USUAL

    for option, percent in (("--speed-noise", speed), ("--torque-noise", torque)):
        if percent is not None:
            between(option, percent, 100.0 * LEAST_LEVEL, 100.0)
    between("--gauge-accuracy", accuracy, 0.0, 100.0 * MOST_INACCURATE)
    levels = {"n_e": speed, "M_g": torque}
    return {
        signal: Noise(USUAL[signal].level if level is None else 0.01 * level, corner_hz, 0.01 * accuracy)
        for signal, level in levels.items()
    }


def _generator(trial: Path | None, expected: str, volts: tuple[float, float]) -> Generator | None:
    from shipfp_rs.designs import Generator
    from shipfp_rs.vessel.vessel import Vessel

    if trial is not None:
        from shipfp_rs.processing.trial import Trial

        set_point = Trial.load(trial).channels.set_point
        if set_point is None:
            raise InputError(f"{trial}: no channels.set_point, expected one to turn rpm into volts")
        return Generator(set_point.calibration.calibration("rpm"), *volts)
    if expected.endswith(".json"):
        return None
    line = Vessel.load(expected).set_point
    return None if line is None else Generator(line.calibration, *volts)
