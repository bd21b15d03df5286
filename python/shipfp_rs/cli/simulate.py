"""`shipfp simulate`: virtual experiments, as clean signals or as a raw log with the faults of a measurement chain."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from shipfp_rs.cli.options import (
    Json,
    Replace,
    Seed,
    as_typed,
    file_option,
    new_file,
    not_negative,
    number_option,
    print_results,
    print_text,
    progress,
)
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.structures.ties import true_values

if TYPE_CHECKING:
    from shipfp_rs.signals import Excitation
    from shipfp_rs.vessel.vessel import Vessel

CLEAN_RATE_HZ, RAW_RATE_HZ = 100.0, 2000.0
AMPLITUDE = 0.03
"""Usual amplitude relative to the operating speed: large enough to measure, small enough to be linear."""

LEAST_AMPLITUDE = 2e-4
"""Least measurable amplitude relative to the operating speed."""

TYPED = {
    "amplitude_rpm": "--amplitude-rpm",
    "duration_s": "--duration",
    "rate_hz": "--rate",
    "noise['n_e']": "--noise",
}
"""Command-line options by argument of the Python functions."""


Kind = Literal["chirp", "steps", "multisine", "sines"]


def simulate(
    vessel: Annotated[
        str, typer.Argument(metavar="VESSEL", help="Built-in ship, or the path of a vessel file.")
    ],
    excitation: Annotated[Kind, typer.Option(help="What is put on the set point.")] = "chirp",
    amplitude_rpm: Annotated[
        float | None, number_option("RPM", "Amplitude, engine rpm; default 3 % of the operating speed.")
    ] = None,
    duration: Annotated[float, number_option("S", "Length of the excitation, s.")] = 300.0,
    rate: Annotated[
        float | None, number_option("HZ", "Sample rate, Hz; default 100, or 2000 for a raw log.")
    ] = None,
    noise: Annotated[
        float,
        number_option(
            "SHARE", "White noise on speeds and torques, over each signal's own deviation.", not_negative
        ),
    ] = 0.0,
    raw: Annotated[
        bool,
        typer.Option("--raw", help="Write the raw log of a measurement chain with faults, and its trial."),
    ] = False,
    out: Annotated[Path, file_option("FILE.parquet", "File to write.")] = Path("simulation.parquet"),
    seed: Seed = 0,
    force: Replace = False,
    json: Json = False,
) -> None:
    """Simulate a trial and write it with the true parameters beside it."""
    from shipfp_rs.support.files import json_text, replacing
    from shipfp_rs.vessel.vessel import Vessel

    if out.suffix != ".parquet":
        raise InputError(f"--out {out}: expected a name that ends in .parquet")
    if raw and noise:
        raise InputError("--noise: expected none with --raw, whose sensors have a noise of their own")
    files = {"data": out, "truth": out.with_suffix(".truth.json")}
    if raw:
        files["trial"] = out.with_suffix(".toml")
    for path in files.values():
        new_file(path, force=force)
    ship = Vessel.load(vessel)
    with as_typed(TYPED):
        signal = _excitation(
            excitation, ship, amplitude_rpm, duration, rate or (RAW_RATE_HZ if raw else CLEAN_RATE_HZ)
        )
    with progress() as notify, as_typed(TYPED):
        notify("simulating")
        try:
            made = _raw(ship, vessel, signal, out, seed) if raw else _clean(ship, signal, noise, out, seed)
        except SimulationError as error:
            raise InputError(f"vessel {vessel!r}: {error}") from error
        texts = {"truth": json_text(made.truth)} | ({"trial": made.trial} if raw else {})
        with contextlib.ExitStack() as whole:  # atomically, also if the disk fills up
            for name, text in texts.items():
                whole.enter_context(replacing(files[name])).write_text(text, encoding="utf-8")
            made.write()
    content = {"files": {name: str(path) for name, path in files.items()}, **made.truth}
    print_results(content, lambda: print_text(*(f"wrote {path}" for path in files.values())), json=json)


class _Made(NamedTuple):
    """Simulated trial: its truth, the function that writes its data, and its TRIAL.toml."""

    truth: dict[str, Any]
    write: Callable[[], object]
    trial: str = ""


def _clean(ship: Vessel, signal: Excitation, noise: float, out: Path, seed: int) -> _Made:
    from shipfp_rs.experiments.parquet import write_experiments
    from shipfp_rs.simulation.simulate import simulate as run
    from shipfp_rs.vessel.linear_model import linearise

    levels = dict.fromkeys(("n_e", "n_s", "M_b", "M_s", "M_g"), noise) if noise else None
    experiment = run(ship, signal, noise=levels, seed=seed)
    parameters = true_values(dataclasses.asdict(linearise(ship)))
    truth = {"vessel": ship.name, "seed": seed, "parameters": parameters}
    return _Made(truth, lambda: write_experiments(out, [experiment]))


def _raw(ship: Vessel, name: str, signal: Excitation, out: Path, seed: int) -> _Made:
    from shipfp_rs.simulation.raw_log import simulate_raw_log, trial_toml
    from shipfp_rs.simulation.sensors import Sensors

    sensors = Sensors(rate_hz=signal.rate_hz)
    log, truth = simulate_raw_log(ship, signal, sensors=sensors, seed=seed)
    told = {
        "vessel": ship.name,
        "seed": seed,
        "parameters": true_values(truth.linear),
        "windows": [dataclasses.asdict(window) for window in truth.windows],
        "faults": {
            fault: {channel: spans.tolist() for channel, spans in places.items()}
            for fault, places in truth.faults.items()
        },
        "reflector_angles": {train: places.tolist() for train, places in truth.reflector_angles.items()},
    }
    return _Made(told, lambda: log.write(out), trial_toml(name, out.name, sensors, truth))


def _excitation(
    kind: Kind, ship: Vessel, amplitude_rpm: float | None, duration: float, rate: float
) -> Excitation:
    from shipfp_rs import signals

    speed = ship.operating_point.n_e_rpm
    amplitude = speed * AMPLITUDE if amplitude_rpm is None else amplitude_rpm
    if 0.0 < amplitude < LEAST_AMPLITUDE * speed:
        raise InputError(
            f"--amplitude-rpm {amplitude:g}: expected more than {LEAST_AMPLITUDE * speed:.2g} rpm; a fraction for rpm? "
            f"that is {amplitude * speed:.4g} rpm"
        )
    return signals.standard(kind, duration, amplitude, rate_hz=rate)
