"""`identify`: experiments and a structure to a fingerprint."""

from __future__ import annotations

import logging
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy

from shipfp_rs._core import __version__
from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.automatic import (
    adequacy,
    chooser_of,
    element_rows,
    reworded,
    widened_by_bias,
    widened_by_neglect,
    with_limits,
    with_rivals,
)
from shipfp_rs.identification.blocks import Block, Data, Offsets
from shipfp_rs.identification.choose import choose
from shipfp_rs.identification.estimates import estimates
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import fit_pct, information_criteria, nrmse_pct
from shipfp_rs.identification.gates import require_excited
from shipfp_rs.identification.residual_tests import residual_tests
from shipfp_rs.identification.search import Search, best_of_random, start_vectors
from shipfp_rs.identification.verdict import structure_test, verdict
from shipfp_rs.identification.weighted_problem import Minimum, Noise, mean_scatter
from shipfp_rs.structures.innovations import with_innovations
from shipfp_rs.structures.structure import Structure, Torque
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import Count, Positive, Whole, checked

Array = npt.NDArray[np.float64]
Weighting = Literal["determinant", "variance", "std", "none"]
NoiseModel = Literal["white", "ar", "innovations"]
Covariance = Literal["model", "sandwich"]
Intervals = Literal["profile", "symmetric"]

LOGGER = logging.getLogger("shipfp_rs")

OF_A_CALL = ("vessel", "elements", "torque", "outputs", "fixed", "priors")
"""Arguments of `identify` that are no options of a search."""
AS_LOW = 1e-6
"""Minima whose criteria differ by less are the same."""


@checked
def identify(
    data: Data | Sequence[Data],
    structure: Structure | None = None,
    *,
    elements: Mapping[str, bool] | None = None,
    torque: Torque | None = None,
    outputs: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    weighting: Weighting = "determinant",
    noise: NoiseModel | None = None,
    covariance: Covariance | None = None,
    intervals: Intervals = "profile",
    huber: Positive | None = None,
    ridge: Mapping[str, tuple[float, float]] | None = None,
    offsets: Offsets | None = None,
    initial_state: Literal["estimated", "zero"] | Mapping[str, float] = "estimated",
    random_search: Whole = 0,
    starts: Count | None = None,
    seed: Whole | None = 0,
    max_evaluations: Count = 500,
    tolerance: Positive = 1e-12,
    time_limit_s: Positive | None = None,
    vessel: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fingerprint:
    """Fit a structure to experiments and frequency responses, jointly, and say what they can tell.

    Parameters
    ----------
    data
        One `Experiment` or `FrequencyResponse`, or several that are fitted together.
    structure
        The model; its free parameters are searched within their bounds, those with a prior pulled to it. None: the one
        ship model, of whose elements the data choose those that act (`choose`).
    elements, torque, outputs, fixed, priors
        Where the data choose: elements forced on (True) or off (False), the side of the torque ("gauge" or "brake"; None:
        by the signal), outputs, and parameters that are known or have a prior (mean, standard deviation).
    weighting
        "determinant" minimises det(E'E/N), the weights of eq. 4.4 iterated with W = (E'E/N)^-1; "variance" the same
        with a diagonal W; "std" uses the responses' own standard deviations; "none" is plain least squares (4.2).
    noise
        "ar": prewhiten the residuals of each output with a fitted AR(8) and refit, so that the intervals hold for
        coloured noise; "white": take them as they are; "innovations": minimise the one-step prediction error with a
        Kalman gain estimated for each experiment, for disturbances of the drive train itself (linear structure without
        dead time in the loop). Default: "ar" for experiments, "white" for responses.
    covariance
        "model": as if the noise models were right; "sandwich": from the spectral matrix of what they leave over, for noise
        of one source that reaches several outputs, each in its own way, as moving water does; experiments only. Default:
        "sandwich" where the data choose, "model" with a structure.
    intervals
        "profile": each ends where the cost, with all others at their best, has risen by the quantile's square; "symmetric":
        the covariance's, cut by the bounds, in a fraction of the time, for Monte-Carlo sweeps.
    huber
        Threshold in robust standard deviations above which a residual counts linearly (eq. 4.7); None: never.
    ridge
        Parameter to (nominal value, weight): adds weight (value - nominal)^2 to the cost of the whitened residuals
        (eq. 4.6 with lambda R = weight).
    offsets
        Estimate an offset per output of every experiment along; None: where the structure has no unknowns of its own for
        the errors of the operating point, as the ship has; "relative": as an error of the operating point, which
        slopes are relative to, too. A mean torque over a minute of moving water is uncertain by parts in a thousand.
    initial_state
        "estimated" along with every experiment, "zero", or given values such as {"initial dn": 0.01}.
    random_search
        Start from the best of this many vectors drawn within the bounds.
    starts, seed
        Number of starts, the first one declared by the structure, the others drawn within the bounds. Default: 1, or 5
        where a dead time is free, since the cost then has several minima.
    max_evaluations, tolerance, time_limit_s
        Limits of each search.
    vessel
        Name for the record.
    progress
        Called with (starts done, starts in all).

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
    Intervals are profiles of the quadratic likelihood of the whitened problem between the bounds, with Student's t; away
    from bounds that is the Gauss-Newton covariance. "variance" and "determinant":
    eq. 4.4 to 4.6 of the thesis; putting 4.5 into 4.4, as printed, would make the cost constant.
    """
    options = Options(
        weighting=weighting,
        noise=noise,
        covariance=covariance,
        intervals=intervals,
        huber=huber,
        ridge=ridge,
        offsets=offsets,
        initial_state=initial_state,
        random_search=random_search,
        starts=starts,
        seed=seed,
        max_evaluations=max_evaluations,
        tolerance=tolerance,
        time_limit_s=time_limit_s,
        progress=progress,
    )
    if structure is None:
        return _chosen(
            data,
            options,
            vessel=vessel,
            elements=elements,
            torque=torque,
            outputs=outputs,
            fixed=fixed,
            priors=priors,
        )
    narrow = {"elements": elements, "torque": torque, "outputs": outputs, "fixed": fixed, "priors": priors}
    for name, value in narrow.items():
        if value is not None:
            raise InputError(
                f"{name}: found with a structure, expected without one; the structure says it itself"
            )
    return fingerprint_of(search_minima(data, structure, options), vessel=vessel)


def _chosen(
    data: Data | Sequence[Data],
    options: Options,
    *,
    vessel: str | None,
    elements: Mapping[str, bool] | None,
    torque: Torque | None,
    outputs: Sequence[str] | None,
    fixed: Mapping[str, float] | None,
    priors: Mapping[str, tuple[float, float]] | None,
) -> Fingerprint:
    """Let the data choose the elements, and say what holds after the choice."""
    given = [data] if isinstance(data, Experiment | FrequencyResponse) else list(data)
    for item in given:
        if not isinstance(item, Experiment):
            raise InputError(
                f"identify: data of type {type(item).__name__} without a structure, expected an Experiment; "
                "give a structure for a FrequencyResponse"
            )
    experiments = [item for item in given if isinstance(item, Experiment)]
    if not experiments:
        raise InputError("identify: no data given, expected an Experiment")
    require_excited(experiments)
    limits = {
        "covariance": options.covariance or "sandwich",
        "intervals": options.intervals,
        "time_limit_s": options.time_limit_s,
    }
    narrow: dict[str, Mapping[str, Any]] = {"fixed": fixed or {}, "prior": priors or {}}
    chooser = chooser_of(
        experiments, torque=torque, outputs=outputs, elements=elements or {}, narrow=narrow, search=limits
    )
    choice = choose(chooser)
    settings = {
        "structure": "chosen by the data",
        "ladder": [rung.to_dict() for rung in choice.ladder],
        "set_point": "band-limited" if chooser.band_limited else "straight lines",
    }
    found = Found(choice.best.search, choice.best.minimum, [choice.best.minimum], settings, options.seed)
    fingerprint = with_limits(fingerprint_of(found, vessel=vessel))
    adequate = adequacy(fingerprint, choice.best)
    fingerprint = with_rivals(fingerprint, choice)
    fingerprint = widened_by_neglect(widened_by_bias(fingerprint, adequate["bias"]), choice)
    fingerprint = replace(fingerprint, elements=element_rows(choice), adequate=adequate)
    return reworded(fingerprint)


@dataclass(frozen=True)
class Options:
    """How to search: the options of `identify`, where they are explained."""

    weighting: Weighting
    noise: NoiseModel | None
    covariance: Covariance | None
    intervals: Intervals
    huber: float | None
    ridge: Mapping[str, tuple[float, float]] | None
    offsets: Offsets | None
    initial_state: Literal["estimated", "zero"] | Mapping[str, float]
    random_search: int
    starts: int | None
    seed: int | None
    max_evaluations: int
    tolerance: float
    time_limit_s: float | None
    progress: Callable[[int, int], None] | None

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Options:
        """Return those given, the others as `identify` has them.

        Raises
        ------
        InputError
            For an option that it has not.
        """
        usual = {
            name: value for name, value in (identify.__kwdefaults__ or {}).items() if name not in OF_A_CALL
        }
        for name in given:
            if name not in usual:
                raise InputError(
                    f"identify has no option {name!r} here, {hints.suggestion(name, list(usual))}"
                )
        return cls(**{**usual, **given})


@dataclass(frozen=True)
class Found:
    """A search, the minima that it found, the best one of them refined, and the settings for the record."""

    search: Search
    best: Minimum
    minima: Sequence[Minimum]
    settings: Mapping[str, Any]
    seed: int | None


def search_minima(
    data: Data | Sequence[Data], structure: Structure, options: Options, *, weights: Noise | None = None
) -> Found:
    """Search as `identify` does, and judge nothing yet; `weights` are those of another search's minimum.

    Raises
    ------
    InputError, IdentificationError
        As `identify`.
    """
    starts, noise, offsets, ridge = options.starts, options.noise, options.offsets, dict(options.ridge or {})
    weighting, initial_state = options.weighting, options.initial_state
    if starts is None:
        starts = 5 if any(parameter.name in ("T_d", "T_set") for parameter in structure.free) else 1
    _check(weighting, noise, starts)
    if offsets is None:
        offsets = not structure.equations.own_offsets
    if offsets not in (True, False, "relative"):
        raise InputError(f"offsets {offsets!r}, expected True, False or 'relative'")
    given = dict(initial_state) if isinstance(initial_state, Mapping) else {}
    _check_names(structure, ridge, given)
    if weighting == "none" and any(parameter.prior is not None for parameter in structure.free):
        raise InputError(
            "a prior needs residuals in units of their deviation; choose weighting 'determinant' or 'variance'"
        )
    if noise == "innovations":
        if offsets == "relative":
            raise InputError("noise 'innovations' knows no relative offsets; leave offsets as they are")
        # There the offsets pass through the predictor, so its equations hold them.
        structure, offsets = with_innovations(structure, offsets=offsets), False
        if initial_state != "estimated":
            raise InputError("noise 'innovations' estimates the initial state; leave initial_state as it is")
    blocks = _blocks(
        data, structure, offsets=offsets, initial_state=initial_state == "estimated", weigh=weighting == "std"
    )
    if noise is None:
        noise = "ar" if any(isinstance(block.data, Experiment) for block in blocks) else "white"
    covariance = options.covariance or "model"
    if covariance not in get_args(Covariance):
        raise InputError(f"covariance {covariance!r}, expected one of {', '.join(get_args(Covariance))}")
    if covariance == "sandwich" and any(isinstance(block.data, FrequencyResponse) for block in blocks):
        raise InputError(
            "covariance 'sandwich' is for experiments, a frequency response has no order in time"
        )
    if options.intervals not in get_args(Intervals):
        raise InputError(f"intervals {options.intervals!r}, expected one of {', '.join(get_args(Intervals))}")
    search = Search(
        structure,
        blocks,
        weighting,
        noise,
        max_evaluations=options.max_evaluations,
        tolerance=options.tolerance,
        huber=options.huber,
        ridge=ridge,
        initial=given,
        time_limit_s=options.time_limit_s,
        covariance=covariance,
        intervals=options.intervals,
        weights=weights,
    )
    if not search.free:
        raise InputError(f"structure {structure.name!r} has no free parameter; nothing to identify")
    LOGGER.info(
        "identify: %s, %d free parameters, %s, %d starts",
        structure.name,
        len(search.free),
        ", ".join(block.data.name for block in blocks),
        starts,
    )
    vectors = start_vectors(search, starts, options.seed)
    if options.random_search:
        vectors[0] = best_of_random(search, options.random_search, options.seed)
    minima = _minima(search, vectors, options.progress)
    # A start that ended in a worse minimum is not worth the noise models: they take most of the time.
    best = search.refine(minima[0])
    settings = {
        "weighting": weighting,
        "noise": noise,
        "covariance": covariance,
        "intervals": options.intervals,
        "offsets": offsets,
        "initial_state": initial_state if isinstance(initial_state, str) else given,
        "huber": options.huber,
        "ridge": {name: list(pair) for name, pair in ridge.items()},
        "random_search": options.random_search,
        "starts": starts,
        "max_evaluations": options.max_evaluations,
        "tolerance": options.tolerance,
        "time_limit_s": options.time_limit_s,
    }
    return Found(search, best, minima, settings, options.seed)


def _blocks(
    data: Data | Sequence[Data], structure: Structure, *, offsets: Offsets, initial_state: bool, weigh: bool
) -> tuple[Block, ...]:
    items = [data] if isinstance(data, Experiment | FrequencyResponse) else list(data)
    if not items:
        raise InputError("identify: no data given, expected an Experiment or a FrequencyResponse")
    for item in items:
        if not isinstance(item, Experiment | FrequencyResponse):
            raise InputError(
                f"identify: data of type {type(item).__name__}, expected Experiment or FrequencyResponse"
            )
        if weigh and isinstance(item, Experiment):
            raise InputError(
                f"{item.name!r}: weighting 'std' is for frequency responses, an experiment has no deviations"
            )
        if isinstance(item, FrequencyResponse) and structure.settings["kind"] in ("linear", "plant"):
            _require_sense(item)
    return tuple(
        Block.build(
            item, structure.part(item.name), offsets=offsets, initial_state=initial_state, weigh=weigh
        )
        for item in items
    )


def _require_sense(data: FrequencyResponse) -> None:
    """Refuse a speed that leads its set point, or that follows it slowly with another gain than 1 (eq. 3.31)."""
    speed = next((name for name in ("n_e", "n_s") if name in data.response), None)
    if speed is None:
        return
    slowest = np.argsort(data.frequency_hz)[:3]
    response = data.response[speed][slowest]
    gain, phase = np.abs(response), np.angle(response)
    if not np.isfinite(response).all() or len(slowest) < 3:
        return
    if (phase > 3.0 * data.phase_std.get(speed, np.zeros(len(data)))[slowest] + 0.005).all() and (
        phase < 1.5
    ).all():
        raise InputError(
            f"{data.name!r}: {speed} leads the set point by {phase[0]:.3g} rad at {data.frequency_hz[slowest[0]]:.4g} Hz, "
            "expected it to follow; the sign of the phase turned? give the complex conjugate"
        )
    if (np.abs(phase) < 0.3).all() and (hint := hints.likely_ratio(float(gain.mean()), hints.PEAK_TO_PEAK)):
        raise InputError(
            f"{data.name!r}: {speed} follows the set point with a gain of {gain.mean():.3g} at its lowest frequencies, "
            f"expected 1{hint} give both channels alike"
        )


def _check(weighting: str, noise: str | None, starts: int) -> None:
    if weighting not in get_args(Weighting):
        raise InputError(f"weighting {weighting!r}, expected one of {', '.join(get_args(Weighting))}")
    if noise is not None and noise not in get_args(NoiseModel):
        raise InputError(f"noise {noise!r}, expected one of {', '.join(get_args(NoiseModel))}")
    if starts < 1:
        raise InputError(f"starts is {starts}, expected at least 1")


def _check_names(
    structure: Structure, ridge: Mapping[str, tuple[float, float]], initial: Mapping[str, float]
) -> None:
    free = [parameter.name for parameter in structure.free]
    for name, (nominal, weight) in ridge.items():
        if name not in free:
            raise InputError(f"ridge: no free parameter {name!r}, {hints.suggestion(name, free)}")
        if not (np.isfinite(nominal) and np.isfinite(weight) and weight >= 0):
            raise InputError(
                f"ridge of {name}: ({nominal}, {weight}), expected a finite value and a weight from 0 up"
            )
    for name in initial:
        if name not in structure.equations.states:
            known = ", ".join(structure.equations.states) or "none"
            raise InputError(
                f"initial_state: no state {name!r} in structure {structure.name!r}; it has {known}"
            )


def _minima(
    search: Search, vectors: Sequence[Array], progress: Callable[[int, int], None] | None
) -> list[Minimum]:
    found, failures = [], []
    for done, start in enumerate(vectors):
        try:
            found.append(search.minimise(start))
            LOGGER.debug("identify: start %d led to the criterion %.9g", done + 1, found[-1].criterion)
        except IdentificationError as error:
            failures.append(str(error))
        if progress is not None:
            progress(done + 1, len(vectors))
    if not found:
        raise IdentificationError(f"none of {len(vectors)} starts led to a minimum; the first: {failures[0]}")
    found.sort(key=lambda minimum: minimum.criterion)
    # Of minima as low as each other take one that is known to be one.
    as_low = (minimum for minimum in found if minimum.criterion <= found[0].criterion + AS_LOW)
    best = next((minimum for minimum in as_low if minimum.converged), found[0])
    return [best, *(minimum for minimum in found if minimum is not best)]


def fingerprint_of(ended: Found, *, vessel: str | None) -> Fingerprint:
    """Return what a search found as `identify` does: with intervals, residual tests and a verdict."""
    search, best = ended.search, ended.best
    structure, count = search.structure, len(search.free)
    found = estimates(search, best)
    parameters, derived, identifiability = found.parameters, found.derived, found.identifiability
    tests = residual_tests(search, best)
    by_block = _fit_by_block(search, best.vector)
    fit = {
        output: row | (tests[output].figures() if output in tests else {})
        for output, row in _fit(search, by_block).items()
    }
    data = tuple(_record(block, figures) for block, figures in zip(search.blocks, by_block, strict=True))
    unknown = (search.size - count) + found.rank
    overall = information_criteria(mean_scatter(best.sums)[1], found.samples, unknown)
    overall |= structure_test({output: test.figures() for output, test in tests.items()})
    if search.weighting == "std":
        overall |= {"chi_squared": best.criterion, "degrees_of_freedom": float(found.freedom)}
    return Fingerprint(
        parameters=parameters,
        derived=derived,
        covariance=found.covariance,
        identifiability=identifiability,
        fit={**fit, "overall": overall},
        residuals={output: test.correlograms() for output, test in tests.items()},
        structure=structure.to_dict(),
        vessel=vessel,
        data=data,
        settings=dict(ended.settings)
        | {
            "optimum": {name: found.values[name] for name in structure.names},
            "kalman_gain": {
                name: float(value)
                for name, value, gain in zip(search.unknowns, best.vector, _kalman_gains(search), strict=True)
                if gain
            },
            "criterion": best.criterion,
            "converged": best.converged,
            "message": best.message,
            "minima": [_minimum_row(search, minimum) for minimum in ended.minima],
        },
        seed=ended.seed,
        versions={
            "shipfp_rs": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
        },
        verdict=verdict(
            parameters,
            derived,
            identifiability,
            {**fit, "overall": overall},
            structure,
            "" if best.converged else best.message,
            any_colour=search.covariance == "sandwich",
        ),
    )


def _fit_by_block(search: Search, vector: Array) -> list[dict[str, dict[str, float]]]:
    """Figures of the simulation: without the gains that lead a predictor back to what was measured."""
    plain = replace(
        search, blocks=tuple(replace(block, weigh=False) if block.weigh else block for block in search.blocks)
    )
    vector = np.where(_kalman_gains(search), 0.0, vector)
    outputs = search.structure.outputs
    rows = []
    for block, values in plain.each(vector):
        if isinstance(block.data, Experiment):
            squares = np.diag(block.products(values, None, None).scatter)
            fits = [
                fit_pct(*pair) for pair in zip(squares, np.diag(block.scatter) * block.count, strict=True)
            ]
        else:
            evaluation = block.evaluate(values, ())
            measured = _complex(np.where(evaluation.valid, block.measured, np.nan))
            fits = [nrmse_pct(*pair) for pair in zip(measured, _complex(evaluation.residual), strict=True)]
        rows.append({output: {"nrmse_pct": fit} for output, fit in zip(outputs, fits, strict=True)})
    return rows


def _kalman_gains(search: Search) -> list[bool]:
    """Which of the unknowns are an experiment's Kalman gain; a structure's own parameter may be called gain, too."""
    own = len(search.free)
    return [index >= own and name.startswith("gain ") for index, name in enumerate(search.unknowns)]


def _complex(parts: Array) -> npt.NDArray[np.complex128]:
    half = parts.shape[1] // 2
    return np.asarray(parts[:, :half] + 1j * parts[:, half:])


def _fit(
    search: Search, by_block: Sequence[Mapping[str, Mapping[str, float]]]
) -> dict[str, dict[str, float | None]]:
    weights = [block.count for block in search.blocks]
    return {
        output: {
            "nrmse_pct": float(np.average([rows[output]["nrmse_pct"] for rows in by_block], weights=weights)),
        }
        for output in search.structure.outputs
    }


def _record(block: Block, figures: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    data = block.data
    record: dict[str, Any] = {
        "name": data.name,
        "domain": "time" if isinstance(data, Experiment) else "frequency",
        "signals": dict(zip(block.structure.outputs, block.signals, strict=True)),
        "operating_point": dict(data.operating_point),
        "fit": {output: dict(row) for output, row in figures.items()},
        "samples": len(data),
        "used": block.count // (1 if isinstance(data, Experiment) else 2),
    }
    if isinstance(data, Experiment):
        record |= {"rate_hz": data.rate_hz, "duration_s": data.duration, "kind": data.kind}
    return record


def _minimum_row(search: Search, minimum: Minimum) -> dict[str, Any]:
    return {
        "criterion": minimum.criterion,
        "converged": minimum.converged,
        "parameters": dict(zip(search.names, map(float, minimum.vector), strict=False)),
    }
