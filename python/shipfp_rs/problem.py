"""The least-squares problem of an identification: residuals and sensitivities of all data, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from shipfp_rs.errors import InputError
from shipfp_rs.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.structure import Structure

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Data = Experiment | FrequencyResponse


@dataclass
class Evaluation:
    """Residuals e = measured - model (O, R) and d(model)/d(vector) (Q, O, R), zero where a sample is masked."""

    residual: Array
    jacobian: Array
    valid: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Block:
    """One experiment or frequency response with the measured outputs that a structure explains.

    `nuisance` are the block's own unknowns: initial states "initial dn", "initial dE" and "offset <output>".
    """

    data: Data
    structure: Structure
    signals: tuple[str, ...]
    measured: Array
    nuisance: tuple[str, ...]
    weigh: bool = False
    """Divide the residuals of a frequency response by its own standard deviations, in amplitude and in phase."""

    @classmethod
    def build(
        cls, data: Data, structure: Structure, *, offsets: bool, initial_state: bool, weigh: bool
    ) -> Block:
        """Pick the measured signal of every output and name the block's own unknowns."""
        if isinstance(data, FrequencyResponse):
            signals = tuple(
                structure.signal_for(output, data.response, data.name) for output in structure.outputs
            )
            measured = _split(np.array([data.response[signal] for signal in signals]))
            for signal in signals if weigh else ():
                if signal not in data.phase_std:
                    raise InputError(
                        f"{data.name!r}: weighting 'std' needs the standard deviations of {signal!r}; give "
                        "FrequencyResponse(amplitude_std=..., phase_std=...) or choose another weighting"
                    )
            block = cls(data, structure, signals, measured, (), weigh)
        else:
            signals = tuple(
                structure.signal_for(output, data.signals, data.name) for output in structure.outputs
            )
            measured = np.array([data.normalised(signal) for signal in signals])
            nuisance = (structure.equations.states if initial_state else ()) + (
                tuple(f"offset {output}" for output in structure.outputs) if offsets else ()
            )
            block = cls(data, structure, signals, measured, nuisance)
        if not block.valid.any():
            raise InputError(f"{data.name!r}: every sample of {', '.join(signals)} is masked, nothing to fit")
        return block

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """True where all outputs were measured, shape (R,)."""
        return np.asarray(np.isfinite(self.measured).all(axis=0))

    @property
    def linear(self) -> tuple[str, ...]:
        """Those of its own unknowns in which the model is linear: the offsets, and the states if the equations are."""
        equations = self.structure.equations
        curved = set(equations.states) - set(getattr(equations, "linear_in", ()))
        return tuple(name for name in self.nuisance if name not in curved)

    def evaluate(self, values: dict[str, float], names: Sequence[str]) -> Evaluation:
        """Compute residuals and their model's derivatives with respect to `names` and then the nuisance."""
        valid = self.valid
        if isinstance(self.data, FrequencyResponse):
            model, slopes = self.structure.equations.response(values, self.data.frequency_hz, names)
            if self.weigh:
                return self._weighed(model, slopes)
            simulated, jacobian = _split(model), _split(slopes)
        else:
            states = [name for name in self.nuisance if name in self.structure.equations.states]
            offsets = [name for name in self.nuisance if name not in states]
            known = {name: value for name, value in values.items() if name not in offsets}
            simulated, jacobian = self.structure.equations.sensitivities(known, self.data, [*names, *states])
            if offsets:
                simulated = simulated + np.array([[values[name]] for name in offsets])
                constant = np.eye(len(offsets))[:, :, None] * np.ones(simulated.shape[1])
                jacobian = np.concatenate([jacobian, constant])
        residual = self.measured - simulated
        if not valid.all():
            residual[:, ~valid] = 0.0
            jacobian *= valid
        return Evaluation(residual, jacobian, valid)

    def _weighed(self, model: ComplexArray, slopes: ComplexArray) -> Evaluation:
        """Residuals of log amplitude and of phase over their deviations: a turned phase is no error of amplitude."""
        assert isinstance(self.data, FrequencyResponse)
        amplitude = np.array([self.data.amplitude_std[signal] for signal in self.signals])
        phase = np.array([self.data.phase_std[signal] for signal in self.signals])
        ratio = np.array([self.data.response[signal] for signal in self.signals]) / model
        residual = np.concatenate([np.log(np.abs(ratio)) / amplitude, np.angle(ratio) / phase], axis=-1)
        relative = slopes / model
        jacobian = np.concatenate([relative.real / amplitude, relative.imag / phase], axis=-1)
        valid = self.valid
        return Evaluation(np.where(valid, residual, 0.0), np.where(valid, jacobian, 0.0), valid)


def _split(response: ComplexArray) -> Array:
    return np.concatenate([response.real, response.imag], axis=-1)


def prewhiten(evaluation: Evaluation, models: Sequence[Array]) -> Evaluation:
    """Filter residuals and sensitivities of a time block with each output's autoregressive model.

    A sample whose filter reaches over a masked one is masked too. `models` holds [1, a1, ..., ap] an output.
    """
    order = max(int(np.flatnonzero(model)[-1]) for model in models)
    reach = lfilter(np.ones(order + 1), [1.0], np.where(evaluation.valid, 0.0, 1.0))
    valid = np.asarray(reach < 0.5)
    valid[:order] = False
    residual, jacobian = np.empty_like(evaluation.residual), np.empty_like(evaluation.jacobian)
    for index, model in enumerate(models):
        residual[index] = lfilter(model, [1.0], evaluation.residual[index])
        jacobian[:, index] = lfilter(model, [1.0], evaluation.jacobian[:, index], axis=-1)
    residual *= valid
    jacobian *= valid
    return Evaluation(residual, jacobian, valid)


def autoregressive_model(residuals: Sequence[tuple[Array, npt.NDArray[np.bool_]]], order: int) -> Array:
    """Fit [1, a1, ..., ap] to the residuals of one output, gaps left out, by least squares over all blocks."""
    gram, right = np.zeros((order, order)), np.zeros(order)
    for values, valid in residuals:
        if len(values) <= 2 * order:
            continue
        lagged = np.lib.stride_tricks.sliding_window_view(values, order + 1)
        whole = np.lib.stride_tricks.sliding_window_view(valid, order + 1).all(axis=1)
        rows = lagged[whole]
        past, now = rows[:, :-1][:, ::-1], rows[:, -1]
        gram += past.T @ past
        right += past.T @ now
    ridge = 1e-12 * np.trace(gram) / order
    if not ridge > 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    coefficients = np.linalg.solve(gram + ridge * np.eye(order), right)
    return np.concatenate([[1.0], -coefficients])
