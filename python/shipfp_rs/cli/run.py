"""The commands that run a trial: `shipfp check`, `run`, `demo` and `simulate`."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from shipfp_rs.cli.options import (
    Force,
    Json,
    OtherSeed,
    OutFolder,
    Replace,
    Seed,
    TrialFile,
    a_language,
    as_typed,
    file_option,
    new_file,
    not_negative,
    number_option,
    print_estimates,
    print_fingerprint,
    print_results,
    print_table,
    print_text,
    progress,
    vessels,
)
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.structures.ties import true_values
from shipfp_rs.support.sentences import LANGUAGES, Sentence

if TYPE_CHECKING:
    from shipfp_rs.runs.dry_run import Check
    from shipfp_rs.signals import Excitation
    from shipfp_rs.vessel.vessel import Vessel


def run(
    trial: TrialFile,
    out: OutFolder = Path("shipfp-run"),
    seed: OtherSeed = None,
    force: Force = False,
    language: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(LANGUAGES), parser=a_language, help="Of the report; default the trial's."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Turn a raw log into a fingerprint: calibrate, clean, identify, report."""
    from shipfp_rs.runs import run

    with progress() as notify:
        result = run.run(trial, out, seed=seed, force=force, language=language, notify=notify)
    found = result.fingerprint
    content = {"folder": str(out), **found.to_dict()}
    print_results(content, lambda: print_fingerprint(found), out, json=json)


def check(trial: TrialFile, json: Json = False) -> None:
    """Read a trial as `shipfp run` does, without the fit, and show what was read, would be fitted, and is missing."""
    from shipfp_rs.runs.dry_run import check as dry_run

    with progress() as notify:
        found = dry_run(trial, notify=notify)
    print_results(found.to_dict(), lambda: _print(found), json=json)


def _print(found: Check) -> None:
    print_table(
        f"Channels of {found.trial}, {found.vessel}",
        ["column", "read as", "unit", "rate [Hz]", "samples"],
        [[c["column"], c["what"], c["unit"], f"{c['rate_hz']:g}", f"{c['samples']}"] for c in found.channels],
    )
    print_table(
        "Windows",
        ["window", "use", "kind", "start [s]", "stop [s]", "usable", "faults"],
        [
            [
                window["name"],
                "fitted" if window["use"] == "fit" else "held out",
                window["kind"],
                f"{window['start_s']:g}",
                f"{window['stop_s']:g}",
                ", ".join(f"{name} {share:.1%}" for name, share in window["usable"].items()),
                ", ".join(f"{count} {kind}" for kind, count in window["faults"].items()) or "none",
            ]
            for window in found.windows
        ],
    )
    point = ", ".join(f"{name} {value:.5g}" for name, value in found.operating_point.items())
    print_text(f"Operating point: {point}.")
    print_text(f"Would be fitted: {found.structure}, outputs {', '.join(found.outputs)}.")
    if found.tried:
        print_text(f"Would be tried beside it: {', '.join(found.tried)}.")
    told = {**found.expected.parameters, **found.expected.derived}
    print_estimates("What the data are expected to determine, at a first look", told)
    why: dict[str, list[str]] = {}
    for name, one in told.items():
        if one.status == "unidentifiable":
            why.setdefault(one.reason, []).append(name)
    print_text(*(f"{', '.join(names)}: {reason}." for reason, names in why.items()))
    if found.missing:
        print_text("Missing:", *(f"- {line}" for line in found.missing))
    else:
        print_text("Nothing is missing.")


PUBLISHED = Sentence("Published data of the tug's own trial")
OF_PUBLISHED = Sentence(
    "Sine fits of the only full-scale trial that is published, fitted by the same program, each point by its weight."
)
VESSEL = "stan-tug-1205"
LOG, TRUTH = "log.parquet", "truth.json"
AMPLITUDE_RPM = 40.0
"""Half of the amplitude of the tug's trial (Table 6.7); within it the plant is nearly linear."""
TOP_HZ = 1.5
TONES_HZ = (0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.55, 0.77, 1.08, TOP_HZ)


def demo(
    out: OutFolder = Path("shipfp-demo"), seed: Seed = 0, force: Force = False, json: Json = False
) -> None:
    """Show the whole chain: simulate a tug's 2 kHz log with faults, and compare its fingerprint with the truth."""
    from shipfp_rs.processing.trial import Trial
    from shipfp_rs.reproduce import fullscale
    from shipfp_rs.runs import run
    from shipfp_rs.support.files import replacing_folder

    with (
        progress() as notify,
        replacing_folder(out, marker=run.MARKER, others=[*run.RESULTS, LOG, TRUTH], force=force) as folder,
    ):
        notify("simulating a raw log")
        truth = _write_log(folder, seed)
        trial = Trial.load(folder / "TRIAL.toml")
        published = fullscale.reproduce(
            lambda done, jobs: notify(f"published data, {done} of {jobs} fits done")
        )
        drawn = fullscale.responses(published)
        also = (
            PUBLISHED,
            OF_PUBLISHED,
            fullscale.best_of(published),
            [(drawn.measured, drawn.models["ours"])],
        )
        result = run.evaluate(trial, folder, seed=seed, truth=truth, also=also, notify=notify)

    def show() -> None:
        title = "A simulated trial of the tug, truth beside estimate"
        print_fingerprint(result.fingerprint, truth, title=title)
        best = fullscale.best_of(published)
        name = best.structure["name"]
        print_fingerprint(best, title=f"The tug's own trial, its published sine fits, each weighted ({name})")
        print_text("", "How that compares with what was printed: shipfp reproduce fullscale")

    found = {"fingerprint": result.fingerprint.to_dict(), "fullscale": published.to_dict()}
    print_results({"folder": str(out), "truth": truth, **found}, show, out, json=json)


def _write_log(folder: Path, seed: int) -> dict[str, float]:
    """Write the log, its TRIAL.toml and the truth to a trial's folder; return the truth."""
    from shipfp_rs import signals
    from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
    from shipfp_rs.support.files import json_text
    from shipfp_rs.vessel.vessel import Vessel

    sensors = Sensors()
    rate = sensors.rate_hz
    excitations = [
        signals.chirp(0.01, TOP_HZ, 240.0, AMPLITUDE_RPM, rate_hz=rate, name="chirp"),
        signals.multisine(TONES_HZ, 60.0, AMPLITUDE_RPM, rate_hz=rate, name="multisine"),
    ]
    log, made_from = simulate_raw_log(Vessel.load(VESSEL), excitations, sensors=sensors, seed=seed)
    log.write(folder / LOG)
    (folder / "TRIAL.toml").write_text(trial_toml(VESSEL, LOG, sensors, made_from), encoding="utf-8")
    truth = true_values(made_from.linear)
    (folder / TRUTH).write_text(json_text(truth), encoding="utf-8")
    return truth


CLEAN_RATE_HZ, RAW_RATE_HZ = 100.0, 2000.0
AMPLITUDE = 0.03
"""Usual amplitude relative to the operating speed: large enough to measure, and small enough for a linear response."""

LEAST_AMPLITUDE = 2e-4
"""Least amplitude that can be measured, relative to the operating speed."""

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
        str,
        typer.Argument(
            metavar="VESSEL", autocompletion=vessels, help="Built-in ship, or the path of a vessel file."
        ),
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
    """Simulate a trial and write it with its true parameters."""
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
        with contextlib.ExitStack() as whole:  # all files are written or none, also if the disk fills up
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
    from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml

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
            f"--amplitude-rpm {amplitude:g}: expected more than {LEAST_AMPLITUDE * speed:.2g} rpm; as a fraction of the "
            f"speed, this is {amplitude * speed:.4g} rpm"
        )
    return signals.standard(kind, duration, amplitude, rate_hz=rate)
