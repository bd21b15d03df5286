"""Equations given by transfer functions: any linear structure, dead times of any length exact, computed by FFT."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.support.arrays import Array

ComplexArray = npt.NDArray[np.complexfloating[Any, Any]]
Values = Mapping[str, float]
Transfer = Callable[[Values, ComplexArray, str, Sequence[str]], tuple[ComplexArray, ComplexArray]]

INPUT = "dn_set"
WATER = "water"
"""Source of torque that the propeller meets beside its linear one."""
SETTLING_S = 60.0
"""Time after the record within which the answers to it die away before the transform begins anew [s]."""
FINER = 8
"""Rate at which free motions are computed, over the record's: they begin with a jump, which a transform rounds off."""
SLOWEST = 1e-6
"""Stands for the frequency zero, where an integrator has no value [rad/s]."""


@dataclass(frozen=True)
class TransferEquations(Equations):
    """Outputs over the set point as functions of s, and the free motions from one unit of each initial state.

    The record is taken for samples of signals that one and the same low-pass has passed, so nothing is assumed of
    the course between them: no hold, no interpolation. Before the record everything stands still, but for the states.
    """

    transfer: Transfer
    """Values, s = j omega (F,), `INPUT` or a state, and names to the outputs (O, F) and their derivatives (W, O, F)."""
    outputs: tuple[str, ...]
    return_difference: Callable[[Values, ComplexArray], ComplexArray]
    """1 + L(s) of the loop (F,), whose winding tells whether it is stable."""
    states: tuple[str, ...] = ()
    bent: TransferEquations | None = None
    """The same for the propeller's speed alone, whose square p (p - 1) / 2 n_s*^2 is torque too: the second term of
    (1 + n_s*)^p, and so of the drive train's Volterra series (Schetzen, "The Volterra and Wiener Theories", 1980)."""

    @property
    def linear_in(self) -> tuple[str, ...]:
        """The outputs are linear in the initial states."""
        return self.states

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable: the return difference does not wind about zero (Nyquist).

        With an integrator and no unstable pole in the open loop it turns by 90 degrees from low to high frequencies.
        """
        omega = np.geomspace(1e-4, 1e4, 4000)
        turned = np.unwrap(np.angle(self.return_difference(values, 1j * omega)))
        return bool(turned[-1] - turned[0] > -0.5 * np.pi)

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(
        self, values: Values, experiment: Experiment, names: Sequence[str]
    ) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        samples, rate = len(experiment), experiment.rate_hz
        parameters = [name for name in names if name not in self.states]
        amounts = {state: float(values.get(state, 0.0)) for state in self.states}

        size = 2 * next_fast_len((samples + round(SETTLING_S * rate) + 1) // 2)
        frequency = rfftfreq(size, 1.0 / rate)
        response, slopes = self._rows(values, frequency, INPUT, parameters)
        simulated = _answer(response, experiment.dn_set)
        by_parameter = _answer(slopes, experiment.dn_set)
        by_state = {}
        lasting = min(samples, round(SETTLING_S * rate))
        fine = next_fast_len(2 * FINER * lasting, real=True)
        for state in [state for state in self.states if state in names or amounts[state]]:
            free, slopes = (
                irfft(rows, fine)[..., : FINER * lasting : FINER] * (FINER * rate)
                for rows in self._rows(values, rfftfreq(fine, 1.0 / (FINER * rate)), state, parameters)
            )
            simulated[..., :lasting] += amounts[state] * free
            by_parameter[..., :lasting] += amounts[state] * slopes
            by_state[state] = np.pad(free, [(0, 0), (0, samples - lasting)])
        if self.bent is not None:
            # Of free motions, small ones, the square is left out, so that all stays linear in the initial states.
            still = {**values, **dict.fromkeys(self.states, 0.0)}
            speed, speeds = self.bent.sensitivities(still, experiment, parameters)
            p = values["p"]
            squares = p * (p - 1.0) * speed * speeds[:, 0]
            if "p" in parameters:
                squares[parameters.index("p")] += (p - 0.5) * speed[0] ** 2
            square = 0.5 * p * (p - 1.0) * speed[0] ** 2
            response, slopes = self._rows(values, frequency, WATER, parameters)
            simulated += _answer(response, square)
            by_parameter += _answer(slopes, square)
            for row, one in zip(by_parameter, squares, strict=True):
                row += _answer(response, one)
        rows = iter(by_parameter)
        jacobian = [by_state[name] if name in by_state else next(rows) for name in names]
        return simulated, np.array(jacobian).reshape(len(names), *simulated.shape)

    def response(
        self, values: Values, frequency_hz: Array, names: Sequence[str]
    ) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F)."""
        rows, slopes = self._rows(values, frequency_hz, INPUT, names)
        return rows.astype(np.complex128), slopes.astype(np.complex128)

    def _rows(
        self, values: Values, frequency_hz: Array, source: str, names: Sequence[str]
    ) -> tuple[ComplexArray, ComplexArray]:
        s = 1j * np.maximum(2.0 * np.pi * frequency_hz, SLOWEST)
        return self.transfer(values, s, source, names)


def _answer(rows: ComplexArray, driving: Array) -> Array:
    """Return what responses (..., F) make of a signal (N,) that stood at its first sample before, shape (..., N)."""
    samples, size = len(driving), 2 * (rows.shape[-1] - 1)
    moved = driving - driving[0]
    # Beyond its end the signal goes on as its own odd image and fades to where it began, so that nothing jumps or bends.
    fading = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, size - samples + 1) / (size - samples)))
    image = np.pad(moved[-2::-1], (0, size))[: len(fading)]
    spectrum = rfft(np.concatenate([moved, (2.0 * moved[-1] - image) * fading]))
    return np.asarray(rows[..., :1].real * driving[0] + irfft(rows * spectrum, size)[..., :samples])
