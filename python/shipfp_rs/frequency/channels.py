"""Common steps of the estimators: selection of signals, bridging of masked samples, and assembly of a response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency.response import FrequencyResponse
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.spikes import bridge

Points = Mapping[str, tuple[ComplexArray, Array, Array | None]]
"""Signal to its response, the relative standard deviation of each quadrature, and its coherence."""

_MOST_MASKED = 0.05
"""Largest share of a signal that is interpolated linearly for a spectrum."""


def chosen_signals(experiments: Sequence[Experiment], signals: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the outputs: the given ones, or all that every experiment has, without set point and command."""
    if not experiments:
        raise InputError("experiments: found none, expected at least one")
    common = [name for name in experiments[0].signals if all(name in e.signals for e in experiments)]
    names = (
        tuple(name for name in common if name not in ("n_set", "command"))
        if signals is None
        else tuple(signals)
    )
    for name in names:
        if name not in common:
            raise InputError(f"signals: found {name!r}, expected some of {', '.join(common)}")
    if not names:
        raise InputError("signals: the experiments have no output in common, only the set point")
    return names


def whole_signal(experiment: Experiment, name: str) -> tuple[Array, float]:
    """Return the normalised deviation with masked samples interpolated, and their share."""
    values = experiment.normalised(name)
    missing = np.isnan(values)
    share = float(missing.mean())
    if share > _MOST_MASKED:
        raise InputError(
            f"experiment {experiment.name!r}: {share:.0%} of {name!r} is masked, at most {_MOST_MASKED:.0%} can be "
            "bridged for a spectrum; cut the window, or use stepped_sine_response or multisine_response, which need "
            "no bridge"
        )
    return bridge(values, missing), share


def to_response(
    name: str,
    frequency_hz: Array,
    points: Points,
    operating_point: Mapping[str, float],
    provenance: Mapping[str, Any],
) -> FrequencyResponse:
    """Assemble a response; amplitude and phase have the standard deviations of the quadratures."""
    # Residuals of exact data are only rounding; zero standard deviations would give infinite weights.
    std = {key: np.maximum(deviation, np.finfo(np.float64).eps) for key, (_, deviation, _) in points.items()}
    return FrequencyResponse(
        name=name,
        frequency_hz=frequency_hz,
        response={key: response for key, (response, _, _) in points.items()},
        amplitude_std=std,
        phase_std=std,
        operating_point=operating_point,
        provenance=provenance,
        coherence={key: coherence for key, (_, _, coherence) in points.items() if coherence is not None},
    )
