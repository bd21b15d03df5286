"""Run of a trial: reads TRIAL.toml and its logs, writes experiments, fingerprint and report into a folder, atomically."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shipfp_rs.assessment.closed_loop import structure_of as rebuilt
from shipfp_rs.assessment.si import against_priors, doubts, in_si, torsional_priors, vessel_priors
from shipfp_rs.assessment.validation import HeldOut, held_out
from shipfp_rs.errors import ShipfpError
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
    """Arguments of `identify` from a trial's [identify] table, if the data select the structure."""
    options, place = trial.identify, located(trial)
    outputs = list(options.outputs) if "outputs" in options.model_fields_set else None
    return {
        "elements": options.elements,
        "torque": options.torque or place,
        "outputs": outputs if outputs is None else _measured(outputs, place),
        "fixed": {**({"v": 1.0, "g": 0.0} if trial.channels.asks_for_torque else {}), **options.fixed},
        "priors": {**drawn(trial, experiments, vessel), **options.priors},
    }


def drawn(trial: Trial, experiments: Sequence[Experiment], vessel: Vessel) -> dict[str, tuple[float, float]]:
    """Priors from the vessel's file and from the torsional calculation, which takes precedence."""
    found, line = vessel_priors(vessel, experiments, trial.identify.vessel_std_pct), trial.torsion
    if line is not None:
        found |= torsional_priors(line.file, experiments, vessel, gauge=line.gauge, std_pct=line.std_pct)
    return found


def structure_from(options: Identify, located: Torque | None) -> Structure:
    """Ship declared by an [identify] table; `located` is the location of the measured torque, None if none was measured."""
    structure = Structure.ship(
        options.acting,
        torque=options.torque or located or "brake",
        outputs=_measured(options.outputs, located),
        products=options.products,
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def with_drawn(structure: Structure, known: Mapping[str, tuple[float, float]]) -> Structure:
    """Add priors to those free parameters of a declared structure that have none."""
    free = {one.name for one in structure.free if one.prior is None}
    return structure.with_prior(**{name: prior for name, prior in known.items() if name in free})


def located(trial: Trial) -> Torque | None:
    """Location of a trial's measured torque; None if none was measured."""
    return None if trial.channels.torque is None else trial.channels.torque.place


def _measured(outputs: Sequence[str], located: Torque | None) -> list[str]:
    """Outputs, without the torque if none was measured."""
    return [output for output in outputs if output != "dM" or located is not None]


MARKER = "fingerprint.json"
RESULTS = (MARKER, "report.html", "experiments.parquet", "validation.parquet", "TRIAL.toml")
"""Names of the files in the folder of a run."""

DRAWN = 100
"""Number of drawn ships, whose scatter is the band about a held-out window."""

PREDICTED = Sentence("Held out and predicted: {windows}.")
OF_WINDOW = Sentence("{name}, {output} to {fit} %, {inside} % of its samples in the 95 % band")
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
    """Result of a run; `experiments` has the fitted ones, `held_out` the predictions of the others."""

    fingerprint: Fingerprint
    experiments: tuple[Experiment, ...]
    held_out: tuple[HeldOut, ...] = ()


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
        Folder to write; the folder of a previous run is replaced.
    seed
        Seed of the random starts; by default that of the trial.
    force
        Whether to write into a folder that has other files, which are kept.
    language
        Language of the report; by default that of the trial.
    notify
        Function called with a text on the current activity.

    Returns
    -------
    Run
        Run with `fingerprint` and `experiments`, which are also in the folder.

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
    """Process and identify a trial, and write the results into an existing folder; `truth`, `also`: see `write_report`."""
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
    experiments, others = split(trial, experiments)
    options, known = trial.identify, drawn(trial, experiments, vessel)
    declared = declared and with_drawn(declared, known)
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
    predicted = _predicted(fingerprint, others, structure)
    lines = [
        *_without_torque(fingerprint, trial),
        *against_priors(fingerprint, {**known, **options.priors}),
        *([UNUSED] if not known and vessel_priors(vessel, experiments, 5.0) else []),
        *doubts(fingerprint, vessel),
        *_of_predictions(predicted),
    ]
    fingerprint = replace(
        fingerprint,
        verdict=(*fingerprint.verdict, *lines),
        si=in_si(fingerprint, vessel),
        settings={**fingerprint.settings, **_dials(trial)},
        held_out={one.measured.name: one.score for one in predicted},
    )
    notify("writing the report")
    tell("writing the report", 0.7)
    fingerprint.save(folder / MARKER)
    write_experiments(folder / "experiments.parquet", experiments)
    if others:
        write_experiments(folder / "validation.parquet", others)
    fingerprint.report(
        folder / "report.html",
        truth=truth,
        also=also,
        title=trial.trial.name,
        language=language or trial.report.language,
        structure=structure,
        vessel=vessel,
        held_out=predicted,
    )
    return Run(fingerprint, tuple(experiments), predicted)


def _dials(trial: Trial) -> dict[str, Any]:
    """Settings of the governor's dials, as settings of the fingerprint."""
    told = trial.governor.model_dump(exclude_none=True)
    return {"governor": told} if told else {}


def split(trial: Trial, experiments: Sequence[Experiment]) -> tuple[list[Experiment], list[Experiment]]:
    """Return the experiments to fit, and those held out."""
    held = {window.name for window in trial.windows if window.use == "validation"}
    return [one for one in experiments if one.name not in held], [
        one for one in experiments if one.name in held
    ]


def _predicted(
    fingerprint: Fingerprint, others: Sequence[Experiment], structure: Structure
) -> tuple[HeldOut, ...]:
    """Predict the held-out windows, with the band of drawn ships, or of the covariance if none can be drawn."""
    ships = None
    if others and fingerprint.engine_described:
        with contextlib.suppress(ShipfpError):
            ships = fingerprint.draws(DRAWN, structure=structure)
    return tuple(held_out(fingerprint, one, structure, draws=ships) for one in others)


def _of_predictions(predicted: Sequence[HeldOut]) -> Iterator[Sentence]:
    told = [
        Sentence(
            OF_WINDOW,
            name=one.measured.name,
            output=output,
            fit=f"{row['nrmse_pct']:.4g}",
            inside=f"{row['inside_pct']:.3g}",
        )
        for one in predicted
        for output, row in one.score.items()
        if row["nrmse_pct"] is not None
    ]
    if told:
        yield Sentence(PREDICTED, windows=joined(told, "; "))


def _without_torque(fingerprint: Fingerprint, trial: Trial) -> Iterator[Sentence]:
    """Yield what a fit without torque determines: with a load, all but a difference of parameters, else ratios."""
    if trial.channels.torque is not None or trial.channels.command is not None:
        return
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
