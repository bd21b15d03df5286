"""`shipfp demo`: the whole chain on a simulated log of a tug, then on the only published full-scale data."""

from __future__ import annotations

from pathlib import Path

from shipfp_rs.cli.options import Force, Json, OutFolder, Seed
from shipfp_rs.cli.output import print_fingerprint, print_results, print_text, progress
from shipfp_rs.structures.combinations import true_values

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
    from shipfp_rs.support.json_files import json_text
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
