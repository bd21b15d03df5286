"""Validation: how well a fingerprint explains experiments that were not used in the fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from shipfp_rs.assessment.prediction import structure_of
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import nrmse_pct
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.threads import with_one_blas_thread


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
class CrossValidation:
    """Fit of every fingerprint to every experiment.

    It is printed as a table for each output.

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
                fitted: {
                    name: figures[output] if math.isfinite(figures[output]) else None
                    for name, figures in row.items()
                }
                for fitted, row in self.fits.items()
            }
            for output in self.outputs
        }

    def __str__(self) -> str:
        names = list(self.fits)
        first = max(len(name) for name in [*names, "fitted to"])
        width = [max(len(name), 7) for name in names]
        lines = []
        for output in self.outputs:
            heads = (f"{name:>{size}}" for name, size in zip(names, width, strict=True))
            lines += [f"fit of {output} [%]", "  ".join([f"{'fitted to':<{first}}", *heads])]
            for fitted, row in self.fits.items():
                cells = (f"{row[name][output]:{size}.2f}" for name, size in zip(names, width, strict=True))
                lines.append("  ".join([f"{fitted:<{first}}", *cells]))
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
