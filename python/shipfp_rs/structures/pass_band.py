"""Outputs compared below a frequency: what no fit can follow, like the phase of single firings, is taken off both sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.fir import PASSBAND, STOPBAND, taps


@dataclass(frozen=True)
class PassBand(Equations):
    """Equations whose outputs and derivatives go through the zero-phase low-pass that the measured outputs go through.

    The set point goes into the equations as it was recorded.

    Parameters
    ----------
    equations
        What is simulated.
    pass_hz
        End of the band that passes [Hz]; from 5/3 of it on nothing does (-80 dB).
    """

    equations: Equations
    pass_hz: float

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states of the equations."""
        return self.equations.states

    def simulate(self, values: Mapping[str, float], experiment: Experiment) -> Array:
        """Return the low-passed outputs, shape (O, N), NaN where the filter reaches beyond the record."""
        return self.passed(self.equations.simulate(values, experiment), experiment)

    def sensitivities(
        self, values: Mapping[str, float], experiment: Experiment, names: Sequence[str]
    ) -> tuple[Array, Array]:
        """Return the low-passed outputs (O, N) and derivatives (W, O, N), zero where the filter does not fill."""
        rows, slopes = self.equations.sensitivities(values, experiment, names)
        return np.nan_to_num(self.passed(rows, experiment)), np.nan_to_num(self.passed(slopes, experiment))

    def response(
        self, values: Mapping[str, float], frequency_hz: Array, names: Sequence[str]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return that of the equations: frequencies need no filter."""
        return self.equations.response(values, frequency_hz, names)

    def passed(self, rows: Array, experiment: Experiment) -> Array:
        """Low-pass rows (..., N); NaN wherever the filter reaches a masked sample or beyond the record.

        Raises
        ------
        InputError
            Where the record is too short for the filter or its rate too low for the band.
        """
        share, samples = self.pass_hz / experiment.rate_hz, rows.shape[-1]
        if share >= 0.5 * PASSBAND / STOPBAND:
            raise InputError(
                f"{experiment.name!r}: pass_hz is {self.pass_hz:g}, expected less than "
                f"{0.5 * PASSBAND / STOPBAND * experiment.rate_hz:g} at {experiment.rate_hz:g} Hz"
            )
        filter_ = _taps(share)
        half = len(filter_) // 2
        if samples <= 2 * half:
            raise InputError(
                f"{experiment.name!r}: {samples} samples, expected more than {2 * half} for a low-pass of {self.pass_hz:g} "
                "Hz; raise pass_hz or give a longer record"
            )
        masked = ~np.isfinite(rows)
        passed = np.full(rows.shape, np.nan)
        if not rows.size:
            return passed
        inside = passed[..., half : samples - half]
        clean = np.where(masked, 0.0, rows) if masked.any() else rows
        inside[:] = signal.oaconvolve(
            clean, np.broadcast_to(filter_, (*rows.shape[:-1], len(filter_))), mode="valid", axes=-1
        )
        if masked.any():
            reached = np.cumsum(np.concatenate([np.zeros((*rows.shape[:-1], 1)), masked], axis=-1), axis=-1)
            inside[reached[..., 2 * half + 1 :] > reached[..., : -2 * half - 1]] = np.nan
        return passed


@lru_cache(maxsize=16)
def _taps(share: float) -> Array:
    """Filter that passes up to a share of the rate."""
    return taps(share / PASSBAND, 0.0)
