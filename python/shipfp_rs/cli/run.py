"""`shipfp run`: identification from the user's log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from shipfp_rs.cli.options import (
    Force,
    Json,
    OtherSeed,
    OutFolder,
    Seed,
    TrialFile,
    a_language,
    print_estimates,
    print_fingerprint,
    print_results,
    print_table,
    print_text,
    progress,
)
from shipfp_rs.structures.ties import true_values
from shipfp_rs.support.languages import LANGUAGES

if TYPE_CHECKING:
    from shipfp_rs.runs.dry_run import Check


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
    """Read a trial as a run would and stop before the fit: what was read, what would be fitted, what is missing."""
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
        ["window", "kind", "start [s]", "stop [s]", "usable", "faults"],
        [
            [
                window["name"],
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
    print_text(*(f"{name}: {one.reason}." for name, one in told.items() if one.status == "unidentifiable"))
    if found.missing:
        print_text("Missing:", *(f"- {line}" for line in found.missing))
    else:
        print_text("Nothing is missing.")


VESSEL = "stan-tug-1205"
LOG, TRUTH = "log.parquet", "truth.json"
AMPLITUDE_RPM = 40.0
"""Half of the amplitude of the tug's trial (Table 6.7), over which the plant is nearly linear."""
TOP_HZ = 1.5
TONES_HZ = (0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.55, 0.77, 1.08, TOP_HZ)


def demo(
    out: OutFolder = Path("shipfp-demo"), seed: Seed = 0, force: Force = False, json: Json = False
) -> None:
    """Show the whole chain: a simulated 2 kHz log of a tug with faults, its fingerprint beside the truth."""
    from shipfp_rs.processing.trial import Trial
    from shipfp_rs.reproduce import fullscale
    from shipfp_rs.runs import run
    from shipfp_rs.support.files import replacing_folder

    with progress() as notify:
        with replacing_folder(
            out, marker=run.MARKER, others=[*run.RESULTS, LOG, TRUTH], force=force
        ) as folder:
            notify("simulating a raw log")
            truth = _write_log(folder, seed)
            trial = Trial.load(folder / "TRIAL.toml")
            result = run.evaluate(trial, folder, seed=seed, truth=truth, notify=notify)
        published = fullscale.reproduce(
            lambda done, jobs: notify(f"published data, {done} of {jobs} fits done")
        )

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
    """Write the log, its TRIAL.toml and the truth, laid out as a trial's folder; return the truth."""
    from shipfp_rs import signals
    from shipfp_rs.simulation.raw_log import simulate_raw_log, trial_toml
    from shipfp_rs.simulation.sensors import Sensors
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
