"""`identify`: estimates a fingerprint from experiments and a structure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import Frame, of_frames
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.automatic import identified
from shipfp_rs.identification.estimate import ASSUMED
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.first_guesses import inertias
from shipfp_rs.identification.input_checks import require_excited
from shipfp_rs.identification.open_loop import (
    in_open_loop,
    require_driver,
    structure_in_open_loop,
    with_caveat,
)
from shipfp_rs.identification.question import (
    Intervals,
    NoiseModel,
    Options,
    Question,
    question_of,
    question_of_ship,
)
from shipfp_rs.identification.structure_estimates import fitted
from shipfp_rs.identification.structure_likelihood import Data
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.structures.parameter import Torque
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import Count, Positive, Whole, checked
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
        the elements that the data support; for experiments with a `command` instead of a set point, the drive without a
        governor of `structures.commanded`.
    elements, torque, outputs, fixed, priors
        Without a structure: elements that act (True) or not (False), location of the torque sensor ("gauge" or "brake";
        None: by the signal, brake before gauge), outputs, and parameters that are known or have a prior (mean, deviation).
    noise
        "coloured": the spectral matrix of the residuals, estimated in the band that the set point excites. "white": one
        covariance over all samples or frequencies, the thesis's determinant criterion (eq. 4.5 correctly substituted in
        4.4). "std": the standard deviations of a response. Default: "coloured" for experiments, "std" for responses with
        standard deviations, "white" for others.
    intervals
        "profile": each end is where the minimum of the cost over all other parameters has risen by the quantile's square.
        "symmetric": by the covariance, cut by the bounds, in a fraction of the time, for Monte-Carlo sweeps.
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
        Estimates with 95 % intervals. Where the data do not determine a parameter its value is None.

    Raises
    ------
    InputError
        For data or settings that can't be used.
    IdentificationError
        If no start leads to a minimum.

    Notes
    -----
    Intervals are profiles of the likelihood, from every minimum that the data do not reject, cut by the bounds. "Coloured"
    noise allows for systematic errors of each output's response, which vary slowly with frequency: 0.3 %, or the
    experiment's `gauge_accuracy`. For each experiment an initial state is estimated, and an offset of each output unless the
    structure has unknowns for it. Substituting eq. 4.5 in 4.4 as printed in the thesis would make the cost constant.
    """
    data = of_frames(data)
    options = Options(noise, intervals, starts, seed, time_limit_s)
    asked = {"elements": elements, "torque": torque, "outputs": outputs, "fixed": fixed, "priors": priors}
    if structure is None:
        return _full_ship(data, options, vessel, asked)
    for name, value in asked.items():
        if value is not None:
            raise InputError(
                f"{name}: given together with a structure, which already defines it; leave {name} out"
            )
    require_driver([data] if isinstance(data, Experiment | FrequencyResponse) else list(data), structure)
    return _given_ship(data, structure, options, vessel) or _with(
        fitted(data, structure, options, vessel=vessel), data
    )


def _with(fingerprint: Fingerprint, data: Data | Sequence[Data]) -> Fingerprint:
    """Return the fingerprint with its experiments, and with its inertia in kg m2 where these determine it."""
    si = inertias(fingerprint) | inertias(whole_ship(fingerprint))
    return replace(fingerprint, experiments=tuple(_experiments(data)), si=si)


def _experiments(data: Data | Sequence[Data]) -> list[Experiment]:
    given = [data] if isinstance(data, Experiment | FrequencyResponse) else data
    return [one for one in given if isinstance(one, Experiment)]


def _full_ship(
    data: Data | Sequence[Data], options: Options, vessel: str | None, asked: Mapping[str, Any]
) -> Fingerprint:
    """Fit the full ship; `asked` are the arguments of `identify` that a structure would define."""
    given = [data] if isinstance(data, Experiment | FrequencyResponse) else list(data)
    for item in given:
        if not isinstance(item, Experiment):
            raise InputError(
                f"identify: data of type {type(item).__name__} without a structure, expected an Experiment; "
                "give a structure for a FrequencyResponse"
            )
    for name in ONLY_WITH_A_STRUCTURE:
        if getattr(options, name) != getattr(Options, name):
            raise InputError(
                f"{name}: given without a structure, expected only with one: the full ship has one likelihood and one search"
            )
    experiments = [item for item in given if isinstance(item, Experiment)]
    if not experiments:
        raise InputError("identify: no data given, expected an Experiment")
    if in_open_loop(experiments):
        require_excited(experiments)
        structure = structure_in_open_loop(experiments, **asked)
        found = fitted(experiments, structure, options, vessel=vessel)
        return with_caveat(_with(found, experiments), asked["fixed"])
    return _as_given(_answered(question_of(experiments, **asked), options, vessel), asked["fixed"] or {})


def _given_ship(
    data: Data | Sequence[Data], structure: Structure, options: Options, vessel: str | None
) -> Fingerprint | None:
    """Fit a given ship like the full ship; None if the full ship's search does not support the structure or an option."""
    given = [data] if isinstance(data, Experiment | FrequencyResponse) else list(data)
    experiments = _experiments(given)
    if (
        options.noise not in (None, "coloured")
        or not experiments
        or len(experiments) < len(given)
        or not structure.free
        or structure.ties
    ):
        return None
    question = question_of_ship(experiments, structure)
    return None if question is None else _as_given(_answered(question, options, vessel), structure.names)


def _as_given(fingerprint: Fingerprint, names: Collection[str]) -> Fingerprint:
    """Return the fingerprint with given parameters marked as given instead of assumed."""
    given = {
        name: replace(estimate, reason="given")
        for name, estimate in fingerprint.parameters.items()
        if name in names and estimate.reason == ASSUMED
    }
    return replace(fingerprint, parameters={**fingerprint.parameters, **given})


def _answered(question: Question, options: Options, vessel: str | None) -> Fingerprint:
    found = identified(
        question.experiments,
        question,
        intervals=options.intervals,
        starts=options.starts or 1,
        seed=options.seed,
        vessel=vessel,
        time_limit_s=options.time_limit_s,
    )
    return _with(found, question.experiments)


def options_of(given: Mapping[str, Any]) -> Options:
    """Return the options with defaults of `identify`, or raise `InputError` for an unknown option."""
    known = [name for name in identify.__kwdefaults__ or {} if name not in OF_A_CALL]
    for name in given:
        if name not in known:
            raise InputError(f"identify has no option {name!r} here, {hints.suggestion(name, known)}")
    return Options(**given)
