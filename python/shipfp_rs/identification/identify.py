"""`identify`: estimates a fingerprint from experiments and a structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import Frame, of_frames
from shipfp_rs.identification.fingerprint import Fingerprint, versions
from shipfp_rs.identification.inertias import inertias
from shipfp_rs.identification.input_checks import require_excited
from shipfp_rs.identification.open_loop import in_open_loop, question_in_open_loop, require_driver
from shipfp_rs.identification.question import (
    Intervals,
    NoiseModel,
    Options,
    Question,
    is_ship,
    question_of,
    question_of_ship,
)
from shipfp_rs.identification.ship_estimates import ship_told
from shipfp_rs.identification.ship_fit import fit_ship, ship_at, smooth_ship
from shipfp_rs.identification.structure_estimates import structure_told
from shipfp_rs.identification.structure_fit import StructureQuestion, fit_structure, structure_at
from shipfp_rs.identification.structure_models import Data
from shipfp_rs.identification.verdict import Told, with_verdict
from shipfp_rs.identification.whole_ship import whole_ship, with_far_side
from shipfp_rs.structures.parameter import Torque
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import Count, Positive, Whole, checked
from shipfp_rs.support.progress import part
from shipfp_rs.support.threads import with_one_blas_thread

OF_A_CALL = ("vessel", "elements", "torque", "outputs", "fixed", "priors")
"""Arguments of `identify` that are not options of a search."""
ONLY_WITH_A_STRUCTURE = ("noise", "starts")
"""Options that a fit without a structure does not have, since it has a single likelihood and search."""


@checked
@with_one_blas_thread
def identify(
    data: Data | Frame | Sequence[Data | Frame],
    structure: Structure | None = None,
    *,
    elements: Mapping[str, bool] | None = None,
    torque: Torque | None = None,
    outputs: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    noise: NoiseModel | None = None,
    intervals: Intervals = "profile",
    starts: Count | None = None,
    seed: Whole | None = 0,
    time_limit_s: Positive | None = None,
    vessel: str | None = None,
) -> Fingerprint:
    """Fit a structure to experiments and frequency responses, jointly, and report which parameters they determine.

    Parameters
    ----------
    data
        An `Experiment` or `FrequencyResponse`, or several that are fitted together. A `pandas.DataFrame` is an experiment
        whose columns are named as signals (n_set, n_e, M_s, ...), in their units; see `experiments.frames`.
    structure
        The model. Its free parameters are searched within their bounds and priors. None: the full ship of `ship_fit`, with
        the elements that the data support. For experiments with a `command` instead of a set point, it is the model of
        `structures.commanded`, a drive without a governor.
    elements, torque, outputs, fixed, priors
        Only without a structure. `elements`: elements that act (True) or not (False). `torque`: location of the torque
        sensor, "gauge" or "brake"; None: by the signal, "brake" if both were measured. `outputs`: outputs to fit. `fixed`:
        values of known parameters. `priors`: parameter to (mean, standard deviation).
    noise
        "coloured": the spectral matrix of the residuals, estimated in the band that the set point excites. "white": one
        covariance over all samples or frequencies, the thesis's determinant criterion (eq. 4.5 correctly substituted in
        4.4). "std": the standard deviations of a response. Default: "coloured" for experiments, "std" for responses with
        standard deviations, "white" for others.
    intervals
        "profile": each end is where the minimum of the cost over all other parameters has risen by the quantile's square.
        "symmetric": by the covariance, clipped to the bounds; it takes a fraction of the time, for Monte-Carlo sweeps.
    starts, seed
        Number of starts: the declared start, and random ones within the bounds. Default: 1, or 5 where a dead time is
        free, since the cost then has several minima. The search of a ship also starts from regressions of its spectra, so
        its default is 1.
    time_limit_s
        Time limit of each search [s].
    vessel
        Name of the ship.

    Returns
    -------
    Fingerprint
        Estimates with 95 % intervals. The value of a parameter that the data do not determine is None.

    Raises
    ------
    InputError
        For data or settings that can't be used.
    IdentificationError
        If no start leads to a minimum.

    Notes
    -----
    Intervals are profiles of the likelihood, from every minimum that the data do not reject, clipped to the bounds.
    "Coloured" noise allows for systematic errors of each output's response, which vary slowly with frequency: 0.3 %, or the
    experiment's `gauge_accuracy`. For each experiment an initial state is estimated, and an offset of each output unless the
    structure has unknowns for it. Substituting eq. 4.5 in 4.4 as printed in the thesis would make the cost constant.
    """
    options = Options(noise, intervals, starts, seed, time_limit_s)
    asked = {"elements": elements, "torque": torque, "outputs": outputs, "fixed": fixed, "priors": priors}
    data = of_frames(data)
    question = posed([data] if isinstance(data, Data) else list(data), structure, options, **asked)
    return fingerprint_of(question, vessel)


def posed(
    data: Sequence[Data], structure: Structure | None, options: Options, **asked: Any
) -> Question | StructureQuestion:
    """Return the question of a fit: data, model and options; `asked` are the arguments that a structure would define."""
    experiments = [one for one in data if isinstance(one, Experiment)]
    if structure is None:
        _require_experiments(data)
        for name in ONLY_WITH_A_STRUCTURE:
            if getattr(options, name) != getattr(Options, name):
                raise InputError(
                    f"{name}: given without a structure, expected only with one: the full ship has one likelihood and one "
                    "search"
                )
        if not in_open_loop(experiments):
            return question_of(experiments, options=options, **asked)
        require_excited(experiments)
        return question_in_open_loop(experiments, options=options, **asked)
    for name, value in asked.items():
        if value is not None:
            raise InputError(
                f"{name}: given together with a structure, which already defines it; leave {name} out"
            )
    require_driver(data, structure)
    coloured = options.noise in (None, "coloured") and not options.at_rest
    if coloured and experiments and len(experiments) == len(data) and is_ship(structure):
        return question_of_ship(experiments, structure, options)
    return StructureQuestion(tuple(data), structure, options)


def _require_experiments(data: Sequence[Data]) -> None:
    for item in data:
        if not isinstance(item, Experiment):
            raise InputError(
                f"identify: data of type {type(item).__name__} without a structure, expected an Experiment; "
                "give a structure for a FrequencyResponse"
            )
    if not data:
        raise InputError("identify: no data given, expected an Experiment")


def fingerprint_of(question: Question | StructureQuestion, vessel: str | None = None) -> Fingerprint:
    """Fit the model of a question, and return the fingerprint."""
    if isinstance(question, StructureQuestion):
        return _judged(structure_told(fit_structure(question)), question.options, vessel)
    with part(0.0, 0.5):
        fit = fit_ship(question)
    with part(0.5, 1.0):
        return _judged(ship_told(fit), question.options, vessel)


def _judged(told: Told, options: Options, vessel: str | None = None) -> Fingerprint:
    """Return the fingerprint of a fit with the load behind a meter, the verdict, and the inertia in kg m2 added."""
    found = replace(told.fingerprint, vessel=vessel, seed=options.seed, versions=versions())
    found = with_verdict(told._replace(fingerprint=with_far_side(found, told.experiments)))
    si = inertias(found) | inertias(whole_ship(found))
    return replace(found, experiments=tuple(told.experiments), si=si)


@with_one_blas_thread
def foresee(
    experiments: Sequence[Experiment],
    structure: Structure | None = None,
    *,
    values: Mapping[str, float]
    | None = None,  # None: those of a first fit without the elements that are tried
    **choice: Any,  # arguments of `question_of`, without a structure
) -> Fingerprint:
    """Return the fingerprint to expect of a ship with these parameters, with symmetric intervals, faster than `identify`."""
    require_excited(experiments)
    question = posed(experiments, structure, Options(intervals="symmetric"), **choice)
    if isinstance(question, StructureQuestion):
        question = replace(question, options=replace(question.options, starts=1))
        fit = fit_structure(question) if values is None else structure_at(question, values)
        return _judged(structure_told(fit), question.options)
    ship = smooth_ship(question) if values is None else ship_at(question, values)
    return _judged(ship_told(replace(ship, basins=ship.basins[:1])), question.options)


def options_of(given: Mapping[str, Any]) -> Options:
    """Return the options with defaults of `identify`, or raise `InputError` for an unknown option."""
    known = [name for name in identify.__kwdefaults__ or {} if name not in OF_A_CALL]
    for name in given:
        if name not in known:
            raise InputError(f"identify has no option {name!r} here, {hints.suggestion(name, known)}")
    return Options(**given)
