"""Validation of a fingerprint on experiments that were not used in the fit, and on measured load steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.assessment.closed_loop import structure_of
from shipfp_rs.assessment.si import deviation_of
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import nrmse_pct
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import DEVIATIONS_95, Array
from shipfp_rs.support.files import finite
from shipfp_rs.support.spikes import bridge
from shipfp_rs.support.tables import text_table
from shipfp_rs.support.threads import with_one_blas_thread

LEAST_STEP = 0.05
"""Least change of the load within `AROUND_S` that counts as a step, relative to the operating torque."""
AROUND_S, BEFORE_S, APART_S = 0.5, 1.0, 3.0
"""Half the longest duration of a step, length of the stretches before and after a step (their means are the
levels), and least time between two steps [s].
"""
STILL = 2e-3
"""Largest motion of a set point that counts as constant, relative to the operating speed."""
STEADY = 0.15
"""Largest standard deviation of the load before and after a step, relative to the step; a larger one is an oscillation."""
MOST_POINTS = 10_000
"""Largest number of samples of a prediction at which the effect of the parameters' deviations is computed."""
BAND_PCT = 2.0
"""Band about the speed before a step within which the speed has recovered [%]."""


@dataclass(frozen=True)
class MeasuredStep:
    """Load step: time [s], size [unit of the load's signal], largest speed deviation [%], recovery time [s].

    The speed falls if the load rises, and rises if it falls; `recovery_s` is None if the speed does not recover before
    the next step or the end of the record.
    """

    at_s: float
    step: float
    deviation_pct: float
    recovery_s: float | None


def measured_steps(experiment: Experiment) -> list[MeasuredStep]:
    """Load steps of an experiment with a measured load, during which the set point is constant.

    Examples
    --------
    >>> measured_steps(experiment)[0].deviation_pct  # doctest: +SKIP
    4.2
    """
    if not {"M_load", "n_e"} <= set(experiment.signals):
        return []
    rate_hz = experiment.rate_hz
    rows = (experiment.normalised("M_load"), experiment.normalised("n_e"), experiment.signals["M_load"])
    load, speed, measured = map(bridge, rows)
    asked = experiment.dn_set if "n_set" in experiment.signals else np.zeros(len(load))
    around, before = round(AROUND_S * rate_hz), round(BEFORE_S * rate_hz)
    places = _places(load, around, round(APART_S * rate_hz))
    found = []
    ends = [*places[1:], len(load) + around][: len(places)]
    for place, following in zip(places, ends, strict=True):
        level = slice(place - around - before, place - around)
        after = slice(place + around, min(place + around + before, following - around))
        if level.start < 0 or after.stop - after.start < before // 2:
            continue
        moved = np.abs(asked[level.start : following - around] - asked[level].mean()) > STILL
        end = level.start + int(np.argmax(moved)) if moved.any() else following - around
        if end < after.stop:
            continue
        step = float(load[after].mean() - load[level].mean())
        if max(load[level].std(), load[after].std()) > STEADY * abs(step):
            continue
        off = 100.0 * (speed[place - around : end] - speed[level].mean())
        outside = np.flatnonzero(np.abs(off) > BAND_PCT)
        # The step starts at sample `around` of `off`; times count from there.
        last = (outside[-1] + 1 - around) / rate_hz if len(outside) else 0.0
        back = not len(outside) or outside[-1] + 1 < len(off)
        deviation = float((-np.sign(step) * off).max())
        size = float(measured[after].mean() - measured[level].mean())
        found.append(MeasuredStep(place / rate_hz, size, deviation, float(max(last, 0.0)) if back else None))
    return found


def _places(load: Array, around: int, apart: int) -> list[int]:
    """Index of each load step: where the load changes most."""
    change = np.zeros(len(load))
    change[around : len(load) - around] = np.abs(load[2 * around :] - load[: -2 * around])
    places: list[int] = []
    while (largest := float(change.max(initial=0.0))) > LEAST_STEP:
        # The step is at the middle of the samples with more than half of the largest change.
        first = int(np.argmax(change))
        begin = max(first - 2 * around, 0)
        near = np.flatnonzero(change[begin : first + 2 * around + 1] > 0.5 * largest)
        place = begin + int(near.mean())
        places.append(place)
        change[max(place - apart, 0) : place + apart] = 0.0
    return sorted(places)


@checked
def validate(
    fingerprint: Fingerprint, experiment: Experiment, structure: Structure | None = None
) -> dict[str, float]:
    """Return the fit of a fingerprint's simulation to an experiment in per cent (eq. 4.9), by output.

    Parameters
    ----------
    fingerprint
        Source of the parameters; the initial state and a constant offset of each output are fitted to the experiment.
    experiment
        Set point and measured outputs; masked samples are ignored.
    structure
        Structure of the fingerprint; None rebuilds a linear one.

    Returns
    -------
    dict
        NRMSE [%] of each output: 100 is perfect, 0 no better than the mean, negative worse; NaN for a constant signal.

    Raises
    ------
    InputError
        See `predict`.
    """
    structure = structure or structure_of(fingerprint)
    predicted = structure.measured(fingerprint.predict(experiment, structure))
    rows = zip(structure.outputs, structure.measured(experiment), predicted, strict=True)
    return {output: nrmse_pct(measured, measured - model) for output, measured, model in rows}


@dataclass(frozen=True)
class HeldOut:
    """An experiment that was not fitted, its prediction, and half the width of the 95 % band about it, by signal (N,)."""

    measured: Experiment
    model: Experiment
    band: Mapping[str, Array]
    score: Mapping[str, Mapping[str, float | None]]


@checked
def held_out(
    fingerprint: Fingerprint,
    experiment: Experiment,
    structure: Structure | None = None,
    *,
    draws: Draws | None = None,
) -> HeldOut:
    """Predict an experiment that was not fitted, with a 95 % band, and score the prediction.

    The band combines the deviations of the parameters with those of the residuals of the fitted experiments.

    Parameters
    ----------
    fingerprint
        A fit, with its experiments.
    experiment, structure
        See `validate`.
    draws
        Draws of the fingerprint, whose scatter is the parameters' deviation. None draws from the covariance.

    Returns
    -------
    HeldOut
        For each output its `score` has "nrmse_pct", as from `validate`, and "inside_pct", the share of samples
        in the band [%].

    Raises
    ------
    InputError
        See `predict`.
    """
    structure = structure or structure_of(fingerprint)
    model = fingerprint.predict(experiment, structure)
    every = -(-len(experiment) // MOST_POINTS)
    moved = deviation_of(
        fingerprint,
        structure,
        lambda values: structure.equations.simulate(values, experiment)[:, ::every],
        draws,
    )
    predicted = structure.measured(model)
    left = [
        structure.measured(one) - structure.measured(fingerprint.predict(one, structure))
        for one in fingerprint.experiments
    ]
    noise = np.nanstd(np.concatenate(left, axis=1), axis=1) if left else np.zeros(len(predicted))
    band, score, places = {}, {}, np.arange(len(experiment))
    rows = zip(structure.outputs, structure.measured(experiment), predicted, moved, noise, strict=True)
    for output, measured, row, parameters, spread in rows:
        signal = structure.signal_for(output, experiment.signals, experiment.name)
        half = DEVIATIONS_95 * np.hypot(np.interp(places, places[::every], parameters), spread)
        band[signal] = half * abs(experiment.operating_point[signal])
        inside = np.abs(measured - row)[np.isfinite(measured)] <= half[np.isfinite(measured)]
        fit = nrmse_pct(measured, measured - row)
        score[output] = {"nrmse_pct": finite(fit), "inside_pct": 100.0 * float(inside.mean())}
    return HeldOut(experiment, model, band, score)


@dataclass(frozen=True)
class CrossValidation:
    """Fit of every fingerprint to every experiment.

    Printing it shows a table for each output.

    Parameters
    ----------
    fits
        NRMSE [%] by name of the fitted experiment, name of the simulated experiment, and output.
    fingerprints
        The fingerprint of each experiment.
    """

    fits: Mapping[str, Mapping[str, Mapping[str, float]]]
    fingerprints: Mapping[str, Fingerprint]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(next(iter(next(iter(self.fits.values())).values())))

    def to_dict(self) -> dict[str, Any]:
        """JSON form: NRMSE [%] by output, fitted and simulated experiment, None if undefined."""
        return {
            output: {
                fitted: {name: finite(figures[output]) for name, figures in row.items()}
                for fitted, row in self.fits.items()
            }
            for output in self.outputs
        }

    def __str__(self) -> str:
        lines = []
        for output in self.outputs:
            rows = (
                [fitted, *(f"{row[name][output]:.2f}" for name in self.fits)]
                for fitted, row in self.fits.items()
            )
            lines += [f"fit of {output} [%]", *text_table(["fitted to", *self.fits], rows, left=1)]
        return "\n".join(lines)


@checked
@with_one_blas_thread
def cross_validation(
    experiments: Sequence[Experiment],
    structure: Structure,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> CrossValidation:
    """Fit a structure to each experiment and simulate all of them with each fingerprint (section 7.3 of the thesis).

    Parameters
    ----------
    experiments
        Experiments with unique names.
    structure
        The model.
    progress
        Called with (completed fits, all fits).
    options
        Options of `identify`.

    Raises
    ------
    InputError
        If there are no experiments, or two with the same name.
    """
    names = [experiment.name for experiment in experiments]
    if not names or len(set(names)) != len(names):
        raise InputError(f"experiments named {names}, expected at least one and each name once")
    fingerprints = {}
    for done, experiment in enumerate(experiments, 1):
        fingerprints[experiment.name] = identify(experiment, structure, **options)
        if progress is not None:
            progress(done, len(experiments))
    fits = {
        fitted: {experiment.name: validate(fingerprint, experiment, structure) for experiment in experiments}
        for fitted, fingerprint in fingerprints.items()
    }
    return CrossValidation(fits, fingerprints)
