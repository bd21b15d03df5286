"""The main job, TRIAL.toml to results: log to experiments to fingerprint to report, in a folder that appears whole."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from shipfp_rs.assessment.indirect import indirect_inference
from shipfp_rs.assessment.prediction import predict
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import write_experiments
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Identify, Trial
from shipfp_rs.report import compared_responses, write_report
from shipfp_rs.structures.structure import Structure, Torque
from shipfp_rs.support.files import replacing_folder
from shipfp_rs.vessel.vessel import Vessel

MARKER = "fingerprint.json"
RESULTS = (MARKER, "report.html", "experiments.parquet", "TRIAL.toml")
"""Names of the files in the folder of a run."""

Notify = Callable[[str], None]


@dataclass(frozen=True)
class Run:
    """What a run found."""

    fingerprint: Fingerprint
    experiments: tuple[Experiment, ...]


def run(
    path: str | Path,
    out: str | Path,
    *,
    seed: int | None = None,
    force: bool = False,
    notify: Notify = lambda _: None,
) -> Run:
    """Process and identify a trial and write `RESULTS` into a folder, which appears whole or not at all.

    Parameters
    ----------
    path
        TRIAL.toml.
    out
        Folder to write; a previous run's is replaced.
    seed
        Seed of the random starts; None: the trial's own.
    force
        Write into a folder that holds other files, too; these stay.
    notify
        Called with what is being done.

    Raises
    ------
    InputError
        Where the trial, the log or the folder can't be used.
    IdentificationError
        Where no start led to a minimum.
    """
    trial = Trial.load(path)
    with replacing_folder(Path(out), marker=MARKER, others=RESULTS, force=force) as folder:
        shutil.copyfile(path, folder / "TRIAL.toml")
        return evaluate(trial, folder, seed=seed, notify=notify)


def evaluate(
    trial: Trial,
    folder: Path,
    *,
    seed: int | None = None,
    truth: Mapping[str, float] | None = None,
    notify: Notify = lambda _: None,
) -> Run:
    """Process and identify a trial and write fingerprint, experiments and report into an existing folder."""
    notify("reading and cleaning the log")
    vessel = Vessel.load(trial.trial.vessel)
    structure = structure_of(trial, vessel)
    experiments = [
        # A result is handed on: it names the file, not where it lay on this machine.
        replace(experiment, provenance={**experiment.provenance, "log": Path(log.name).name})
        for log in trial.logs()
        for experiment in process(log, trial, vessel)
    ]
    options = trial.identify
    fingerprint = identified(
        options,
        experiments,
        structure,
        vessel,
        starts=options.starts if trial.structure is None or "starts" in options.model_fields_set else None,
        seed=options.seed if seed is None else seed,
        progress=lambda done, starts: notify(f"identifying, {done} of {starts} starts done"),
    )
    notify("writing the report")
    fingerprint.save(folder / MARKER)
    write_experiments(folder / "experiments.parquet", experiments)
    write_report(
        folder / "report.html",
        fingerprint,
        experiments,
        simulated=[predict(fingerprint, experiment, structure) for experiment in experiments],
        responses=compared_responses(fingerprint, experiments, structure),
        truth=truth,
        title=trial.trial.name,
    )
    return Run(fingerprint, tuple(experiments))


def identified(
    options: Identify,
    experiments: Experiment | Sequence[Experiment],
    structure: Structure,
    vessel: Vessel,
    **more: Any,
) -> Fingerprint:
    """Fit a structure as an [identify] table asks for; `more` are options of `identify` that the table leaves open."""
    if options.lead_back:
        return indirect_inference(experiments, structure, vessel, **options.options, **more)
    return identify(experiments, structure, vessel=vessel.name, **options.options, **more)


def structure_of(trial: Trial, vessel: Vessel) -> Structure:
    """Return the structure that a trial's [structure] table, or else its [identify] table, asks for.

    Raises
    ------
    InputError
        Where it names an unknown parameter or output, or an element that the vessel has not.
    """
    torque, box, options = trial.channels.torque, trial.structure, trial.identify
    located: Torque | None = None if torque is None else "gauge" if torque.location == "gauge" else "brake"
    if box is None:
        return structure_from(options, located)
    structure = Structure.grey_box(
        vessel,
        box.free,
        torque=box.torque or located or "brake",
        outputs=_measured(box.outputs, located),
        pass_hz=box.pass_hz,
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def structure_from(options: Identify, located: Torque | None) -> Structure:
    """Return the structure that an [identify] table asks for, the torque measured there, or not at all (None).

    Raises
    ------
    InputError
        Where it names an unknown parameter or output.
    """
    torque = options.torque or located or "brake"
    # The engine's torque is no part of three parameters unless it is asked for.
    asked = not options.three_parameters or torque == "gauge" or "outputs" in options.model_fields_set
    declare = (
        Structure.three_parameters
        if options.three_parameters
        else partial(Structure.linear, products=options.products, **options.elements)
    )
    structure = declare(
        torque=torque,
        free_exponent=options.free_exponent,
        dead_time_loop=options.dead_time_loop,
        dead_time_set_point=options.dead_time_set_point,
        outputs=_measured(options.outputs, located if asked else None),
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def _measured(outputs: Sequence[str], located: Torque | None) -> list[str]:
    """Outputs without the torque where none was measured."""
    return [output for output in outputs if output != "dM" or located is not None]
