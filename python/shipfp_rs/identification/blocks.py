"""The least-squares problem of an identification: residuals and sensitivities of all data, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.optimise.normal_equations import Products
from shipfp_rs.structures.equations import Against, Equations
from shipfp_rs.structures.structure import Structure

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Data = Experiment | FrequencyResponse
Offsets = bool | Literal["relative"]

CHUNK = 2048
"""Samples that are worked on at a time, so that they fit into a cache."""


@dataclass
class Evaluation:
    """Residuals e = measured - model (O, R) and d(model)/d(vector) (Q, O, R), zero where a sample is masked."""

    residual: Array
    jacobian: Array
    valid: npt.NDArray[np.bool_]

    def turned(self) -> Evaluation:
        """Return the columns after an orthogonal transformation over the samples that leaves few rows; `valid` stays.

        What is left has the same products of all columns in all pairs of outputs.
        """
        rows = np.concatenate([self.jacobian, self.residual[None]])
        tall = rows.reshape(-1, rows.shape[-1]).T
        if tall.shape[0] <= tall.shape[1]:
            return self
        factor = np.zeros((0, tall.shape[1]))
        for start in range(0, len(tall), CHUNK):
            more = np.concatenate([factor, tall[start : start + CHUNK]])
            factor = np.asarray(np.linalg.qr(more, mode="r"))
        short = factor.T.reshape(*rows.shape[:2], -1)
        return Evaluation(short[-1], short[:-1], self.valid)


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
    relative: bool = False
    """Whether offsets are errors of the operating point, by which the whole output was divided."""

    @classmethod
    def build(
        cls, data: Data, structure: Structure, *, offsets: Offsets, initial_state: bool, weigh: bool
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
            measured = structure.measured(data)
            nuisance = (structure.equations.states if initial_state else ()) + (
                tuple(f"offset {output}" for output in structure.outputs) if offsets else ()
            )
            block = cls(data, structure, signals, measured, nuisance, relative=offsets == "relative")
        if not block.valid.any():
            raise InputError(f"{data.name!r}: every sample of {', '.join(signals)} is masked, nothing to fit")
        return block

    @cached_property
    def valid(self) -> npt.NDArray[np.bool_]:
        """True where all outputs were measured, shape (R,)."""
        return np.asarray(np.isfinite(self.measured).all(axis=0))

    @cached_property
    def mean(self) -> Array:
        """Mean of every measured output, shape (O,)."""
        return np.asarray(self._kept.mean(axis=1))

    @cached_property
    def scatter(self) -> Array:
        """Mean outer product of the measured outputs about their means, shape (O, O)."""
        centred = self._kept - self.mean[:, None]
        return np.asarray(centred @ centred.T / self.count)

    @cached_property
    def count(self) -> int:
        """Number of valid samples."""
        return int(np.count_nonzero(self.valid))

    @property
    def _kept(self) -> Array:
        """Measured outputs without masked samples, copied only where there are any."""
        return self.measured if self.count == len(self.valid) else self.measured[:, self.valid]

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the unknowns of this block that the outputs depend on linearly: offsets, and initial states where so."""
        equations = self.structure.equations
        curved = set(equations.states) - set(equations.linear_in)
        return tuple(name for name in self.nuisance if name not in curved)

    @property
    def offsets(self) -> tuple[str, ...]:
        """The block's own unknowns that are constants added to an output; they come last."""
        return tuple(name for name in self.nuisance if name not in self.structure.equations.states)

    @cached_property
    def _level(self) -> Array:
        """Change of the outputs for one unit of an offset, shape (O, R) or (1, R).

        With y = (1 + c) (1 + m) - 1 of an operating point that is off by c, and a model m, to the first order in c and in
        the noise: y - m = c (1 + y).
        """
        if not self.relative:
            return np.ones((1, self.measured.shape[1]))
        return np.where(self.valid, 1.0 + self.measured, 0.0)

    def evaluate(
        self, values: dict[str, float], names: Sequence[str], *, constants: bool = True
    ) -> Evaluation:
        """Compute residuals and their model's derivatives with respect to `names` and then the nuisance.

        Without `constants` the columns of the offsets are left out.
        """
        valid = self.valid
        if isinstance(self.data, FrequencyResponse):
            model, slopes = self.structure.equations.response(values, self.data.frequency_hz, names)
            if self.weigh:
                return self._weighed(model, slopes)
            simulated, jacobian = _split(model), _split(slopes)
        else:
            states = [name for name in self.nuisance if name in self.structure.equations.states]
            offsets = self.offsets
            known = {name: value for name, value in values.items() if name not in offsets}
            wanted = [*names, *states]
            simulated, jacobian = self.structure.equations.sensitivities(known, self.data, wanted)
            jacobian = jacobian.reshape(len(wanted), *simulated.shape)
            if offsets:
                simulated = simulated + self._level * np.array([[values[name]] for name in offsets])
            if offsets and constants:
                jacobian = np.concatenate([jacobian, np.eye(len(offsets))[:, :, None] * self._level])
        residual = self.measured - simulated
        if not valid.all():
            residual[:, ~valid] = 0.0
            jacobian *= valid
        return Evaluation(residual, jacobian, valid)

    def filtered(
        self,
        values: dict[str, float],
        names: Sequence[str],
        models: Sequence[Array] | None,
        *,
        constants: bool = True,
    ) -> Evaluation:
        """Evaluate, and prewhiten an experiment with each output's noise model, if there are any."""
        evaluation = self.evaluate(values, names, constants=constants)
        if models is None or isinstance(self.data, FrequencyResponse):
            return evaluation
        return prewhiten(evaluation, models)

    def turned(
        self,
        values: dict[str, float],
        names: Sequence[str],
        models: Sequence[Array] | None,
        root: Array,
        products: Products,
    ) -> Evaluation:
        """Return what `filtered` does in a few rows with the same products, still to be weighted by a root (O, O).

        Where a kernel adds up the products, only the number of valid samples is kept, not which they are.
        """
        if self._kernel is not None:
            rows = products.rows(root)
            if rows is not None:
                return Evaluation(rows[-1], rows[:-1], np.ones(products.count, dtype=bool))
        return self.filtered(values, names, models).turned()

    @property
    def _kernel(self) -> Equations | None:
        """The equations, if they have a kernel that sums up an experiment's products in one pass."""
        if isinstance(self.data, FrequencyResponse) or self.relative:
            return None
        equations = self.structure.equations
        return equations if equations.has_products else None

    def products(
        self,
        values: dict[str, float],
        names: Sequence[str] | None,
        models: Sequence[Array] | None,
        *,
        sharp: bool = True,
    ) -> Products:
        """Sum up the products of what `filtered` returns, in one pass of the equations' own where they have one.

        Without names (None) those of the residuals alone; not `sharp`, with an error far below the noise.
        """
        kernel = self._kernel
        if kernel is None or isinstance(self.data, FrequencyResponse):
            evaluation = self.filtered(values, names or (), models)
            if names is None:
                evaluation.jacobian = evaluation.jacobian[:0]
            with np.errstate(over="ignore", invalid="ignore"):
                return Products.of(evaluation.residual, evaluation.jacobian, int(evaluation.valid.sum()))
        outputs = self.structure.outputs
        nuisance = () if names is None else self.nuisance
        own = [name for name in nuisance if name in self.structure.equations.states]
        names = names or ()
        offsets = np.array([values.get(f"offset {output}", 0.0) for output in outputs])
        models = [np.ones(1)] * len(outputs) if models is None else models
        filters = np.ascontiguousarray(np.array(models)[:, : order_of(models) + 1])
        known = {name: value for name, value in values.items() if not name.startswith("offset ")}
        sums, count = kernel.products(
            known, self.data, [*names, *own], Against(self.measured, offsets, filters, sharp)
        )
        padded = np.zeros((len(outputs), sums.shape[1] + 1) * 2)
        padded[:, :-1, :, :-1] = sums
        return Products(padded.take(_places(len(outputs), sums.shape[1], len(own) < len(nuisance))), count)

    def _weighed(self, model: ComplexArray, slopes: ComplexArray) -> Evaluation:
        """Residuals of log amplitude and of phase, over their standard deviations: a wrong phase is no amplitude error."""
        assert isinstance(self.data, FrequencyResponse)
        amplitude = np.array([self.data.amplitude_std[signal] for signal in self.signals])
        phase = np.array([self.data.phase_std[signal] for signal in self.signals])
        ratio = np.array([self.data.response[signal] for signal in self.signals]) / model
        residual = np.concatenate([np.log(np.abs(ratio)) / amplitude, np.angle(ratio) / phase], axis=-1)
        relative = slopes / model
        jacobian = np.concatenate([relative.real / amplitude, relative.imag / phase], axis=-1)
        valid = self.valid
        return Evaluation(np.where(valid, residual, 0.0), np.where(valid, jacobian, 0.0), valid)


@lru_cache(maxsize=64)
def _places(outputs: int, columns: int, offsets: bool) -> npt.NDArray[np.intp]:
    """Return, for the products of all columns (O, C, O, C), their indices in the array that a kernel returns.

    A kernel's columns for an output are its derivatives, an offset of that output, its residual, and one of zeros. An
    offset of another output has no effect on this one: it takes the column of zeros.
    """
    one, width = columns - 2, columns + 1
    row = np.arange(outputs)[:, None]
    chosen = np.broadcast_to(np.arange(one), (outputs, one))
    if offsets:
        chosen = np.hstack([chosen, np.where(row == row.T, one, one + 2)])
    flat = row * width + np.hstack([chosen, np.full_like(row, one + 1)])
    return np.asarray(flat[..., None, None] * outputs * width + flat)


def _split(response: ComplexArray) -> Array:
    return np.concatenate([response.real, response.imag], axis=-1)


def order_of(models: Sequence[Array]) -> int:
    """Return how many samples back the longest of the noise models reaches."""
    return max(int(np.flatnonzero(model)[-1]) for model in models)


def prewhiten(evaluation: Evaluation, models: Sequence[Array]) -> Evaluation:
    """Filter residuals and sensitivities of a time block with each output's autoregressive model.

    A sample whose filter reaches over a masked one is masked too. `models` holds [1, a1, ..., ap] an output.
    """
    order = order_of(models)
    reach = lfilter(np.ones(order + 1), [1.0], np.where(evaluation.valid, 0.0, 1.0))
    valid = np.asarray(reach < 0.5)
    valid[:order] = False
    rows = np.concatenate([evaluation.jacobian, evaluation.residual[None]])
    for index, model in enumerate(models):
        rows[:, index] = lfilter(model, [1.0], rows[:, index], axis=-1)
    rows *= valid
    return Evaluation(rows[-1], rows[:-1], valid)


def autoregressive_model(residuals: Sequence[tuple[Array, npt.NDArray[np.bool_]]], order: int) -> Array:
    """Fit [1, a1, ..., ap] to the residuals of one output, gaps left out, by least squares over all blocks."""
    whole = np.zeros((order + 1, order + 1))
    for values, valid in residuals:
        if len(values) <= 2 * order:
            continue
        gaps = not valid.all()
        for start in range(order, len(values), CHUNK):
            stop = min(start + CHUNK, len(values))
            lagged = np.stack([values[start - lag : stop - lag] for lag in range(order + 1)])
            if gaps:
                lagged *= np.all([valid[start - lag : stop - lag] for lag in range(order + 1)], axis=0)
            whole += lagged @ lagged.T
    gram, right = whole[1:, 1:], whole[1:, 0]
    ridge = 1e-12 * np.trace(gram) / order
    if not ridge > 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    coefficients = np.linalg.solve(gram + ridge * np.eye(order), right)
    return np.concatenate([[1.0], -coefficients])
