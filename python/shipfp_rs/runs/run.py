"""Run: TRIAL.toml to log, experiments, fingerprint and report, in a folder that is written atomically."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shipfp_rs.assessment.closed_loop import structure_of as rebuilt
from shipfp_rs.assessment.si import doubts, in_si, vessel_priors
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import write_experiments
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Identify, Trial
from shipfp_rs.structures.parameter import Torque
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.files import replacing_folder
from shipfp_rs.support.progress import part, tell
from shipfp_rs.support.sentences import Sentence, joined
from shipfp_rs.support.threads import import_beside
from shipfp_rs.vessel.vessel import Vessel


def choice(trial: Trial, experiments: Sequence[Experiment], vessel: Vessel) -> dict[str, Any]:
    """Arguments of `identify` from a trial's [identify] table, for a selection by the data."""
    options, place = trial.identify, located(trial)
    outputs = list(options.outputs) if "outputs" in options.model_fields_set else None
    return {
        "elements": options.elements,
        "torque": options.torque or place,
        "outputs": outputs if outputs is None else _measured(outputs, place),
        "fixed": {**({"v": 1.0, "g": 0.0} if trial.channels.asks_for_torque else {}), **options.fixed},
        "priors": {**vessel_priors(vessel, experiments, options.vessel_std_pct), **options.priors},
    }


def structure_from(options: Identify, located: Torque | None) -> Structure:
    """Ship declared by an [identify] table; `located` is where its torque was measured, None if no torque was measured.

    Raises
    ------
    InputError
        If the table names an unknown element, parameter or output.
    """
    structure = Structure.ship(
        options.acting,
        torque=options.torque or located or "brake",
        outputs=_measured(options.outputs, located),
        products=options.products,
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def located(trial: Trial) -> Torque | None:
    """Location of a trial's measured torque; None without one."""
    return None if trial.channels.torque is None else trial.channels.torque.place


def _measured(outputs: Sequence[str], located: Torque | None) -> list[str]:
    """Outputs, without the torque if none was measured."""
    return [output for output in outputs if output != "dM" or located is not None]


MARKER = "fingerprint.json"
RESULTS = (MARKER, "report.html", "experiments.parquet", "TRIAL.toml")
"""Names of the files in the folder of a run."""

NO_TORQUE = Sentence(
    "No torque was fitted, since the trial has no table [channels.torque]: the speed alone determines only ratios of "
    "tau_n, g and the gains."
)
NO_TORQUE_BUT_LOAD = Sentence(
    "No torque was fitted, since the trial has no table [channels.torque]: the measured load determines tau_n and the "
    "gains, but of p and g only their difference."
)
UNUSED = Sentence(
    "Inertia or stiffness of the vessel's file was not used; identify.vessel_std_pct = 5 makes it a prior of 5 %."
)
ASSUMED = Sentence("Assumed, not given: {values}.")

Notify = Callable[[str], None]


@dataclass(frozen=True)
class Run:
    """Result of a run."""

    fingerprint: Fingerprint
    experiments: tuple[Experiment, ...]


@checked
def run(
    path: str | Path,
    out: str | Path = "shipfp-run",
    *,
    seed: int | None = None,
    force: bool = False,
    language: str | None = None,
    notify: Notify = lambda _: None,
) -> Run:
    """Process and identify a trial and write `RESULTS` into a folder, atomically.

    Parameters
    ----------
    path
        TRIAL.toml.
    out
        Folder to write; that of a previous run is replaced.
    seed
        Seed of the random starts; None: that of the trial.
    force
        Whether to write into a folder that has other files; these are kept.
    language
        Language of the report; None: that of the trial.
    notify
        Called with the current activity.

    Returns
    -------
    Run
        `fingerprint` and `experiments`, as they also lie in the folder.

    Raises
    ------
    InputError
        If the trial, the log or the folder can't be used.
    IdentificationError
        If the search found no minimum from any start.

    Examples
    --------
    >>> run("TRIAL.toml", out="my-result").fingerprint["tau_n"].ci95  # doctest: +SKIP
    (1.62, 1.67)
    """
    trial = Trial.load(path)
    with replacing_folder(Path(out), marker=MARKER, others=RESULTS, force=force) as folder:
        shutil.copyfile(path, folder / "TRIAL.toml")
        return evaluate(trial, folder, seed=seed, language=language, notify=notify)


def evaluate(
    trial: Trial,
    folder: Path,
    *,
    seed: int | None = None,
    truth: Mapping[str, float] | None = None,
    also: Any = None,
    language: str | None = None,
    notify: Notify = lambda _: None,
) -> Run:
    """Process and identify a trial and write fingerprint, experiments and report into an existing folder.

    `truth` and `also` are content of the report, see `report.write_report`.
    """
    notify("reading and cleaning the log")
    vessel = Vessel.load(trial.trial.vessel)
    declared = None if trial.identify.chooses else structure_from(trial.identify, located(trial))
    with part(0.0, 0.15):
        tell("opening the log", 0.0)
        logs = trial.logs()
        import_beside("matplotlib.figure", "matplotlib.backends.backend_svg", "shipfp_rs.report")
        experiments = [
            # Results may be passed on to other people, so they contain file names without folders.
            replace(experiment, provenance={**experiment.provenance, "log": Path(log.name).name})
            for log in logs
            for experiment in process(log, trial, vessel)
        ]
    options = trial.identify
    own_seed = options.seed if seed is None else seed
    with part(0.15, 0.7):
        if declared is None:
            notify("choosing the elements and identifying")
            fingerprint = identify(
                experiments, vessel=vessel.name, seed=own_seed, **choice(trial, experiments, vessel)
            )
        else:
            fingerprint = identify(
                experiments, declared, vessel=vessel.name, seed=own_seed, **options.options
            )
    structure = declared or rebuilt(fingerprint)
    if trial.channels.torque is None and trial.channels.command is None:
        fingerprint = replace(
            fingerprint, verdict=(*fingerprint.verdict, *_without_torque(fingerprint, trial))
        )
    if options.vessel_std_pct is None and vessel_priors(vessel, experiments, 5.0):
        fingerprint = replace(fingerprint, verdict=(*fingerprint.verdict, UNUSED))
    fingerprint = replace(fingerprint, verdict=(*fingerprint.verdict, *doubts(fingerprint, vessel)))
    fingerprint = replace(fingerprint, si=in_si(fingerprint, vessel))
    notify("writing the report")
    tell("writing the report", 0.7)
    fingerprint.save(folder / MARKER)
    write_experiments(folder / "experiments.parquet", experiments)
    fingerprint.report(
        folder / "report.html",
        truth=truth,
        also=also,
        title=trial.trial.name,
        language=language or trial.report.language,
        structure=structure,
        vessel=vessel,
    )
    return Run(fingerprint, tuple(experiments))


def _without_torque(fingerprint: Fingerprint, trial: Trial) -> Iterator[Sentence]:
    """Yield what is determined without a torque: with a load all but a difference of parameters, else ratios."""
    if "load" not in fingerprint.structure.get("elements", ()):
        yield NO_TORQUE
        return
    yield NO_TORQUE_BUT_LOAD
    assumed = [
        f"{name} = {estimate.value:g}"
        for name, estimate in fingerprint.parameters.items()
        if name in ("k_L", "p") and estimate.status == "fixed" and name not in trial.identify.fixed
    ]
    if assumed:
        yield Sentence(ASSUMED, values=joined(assumed))
