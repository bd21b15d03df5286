"""The least-squares problem of an identification: residuals and sensitivities of all data, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.whitening import Evaluation, Whitening
from shipfp_rs.optimise.normal_equations import Products
from shipfp_rs.structures.equations import Against, Equations
from shipfp_rs.structures.structure import Structure

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Data = Experiment | FrequencyResponse


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
    def build(cls, data: Data, structure: Structure, *, weigh: bool = False, at_rest: bool = False) -> Block:
        """Pick the measured signal of every output and name the block's own unknowns.

        A record that starts `at_rest` has none; a structure whose states hold errors of the operating point has no offsets.
        """
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
            equations = structure.equations
            offsets = () if equations.own_offsets else structure.outputs
            own = (*equations.states, *(f"offset {output}" for output in offsets))
            block = cls(data, structure, signals, measured, () if at_rest else own)
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

    def evaluate(
        self, values: dict[str, float], names: Sequence[str], *, constants: bool = True, sharp: bool = True
    ) -> Evaluation:
        """Compute residuals and their model's derivatives with respect to `names` and then the nuisance.

        Without `constants` the columns of the offsets are left out; not `sharp`, outputs have an error far below the noise.
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
            equations = self.structure.equations if sharp else self.structure.equations.rough()
            simulated, jacobian = equations.sensitivities(known, self.data, wanted)
            jacobian = jacobian.reshape(len(wanted), *simulated.shape)
            if offsets:
                simulated = simulated + np.array([[values[name]] for name in offsets])
            if offsets and constants:
                jacobian = np.concatenate([jacobian, np.eye(len(offsets))[:, :, None] * np.ones(len(valid))])
        residual = self.measured - simulated
        if not valid.all():
            residual[:, ~valid] = 0.0
            jacobian *= valid
        return Evaluation(residual, jacobian, valid)

    def filtered(
        self,
        values: dict[str, float],
        names: Sequence[str],
        whitening: Whitening | None,
        *,
        constants: bool = True,
    ) -> Evaluation:
        """Evaluate, and whiten an experiment with what is known of its noise, if anything is."""
        evaluation = self.evaluate(values, names, constants=constants)
        if whitening is None or isinstance(self.data, FrequencyResponse):
            return evaluation
        return whitening(evaluation)

    def turned(
        self,
        values: dict[str, float],
        names: Sequence[str],
        whitening: Whitening | None,
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
        return self.filtered(values, names, whitening).turned()

    @property
    def _kernel(self) -> Equations | None:
        """The equations, if they have a kernel that sums up an experiment's products in one pass."""
        if isinstance(self.data, FrequencyResponse):
            return None
        equations = self.structure.equations
        return equations if equations.has_products else None

    def products(
        self,
        values: dict[str, float],
        names: Sequence[str] | None,
        whitening: Whitening | None,
        *,
        sharp: bool = True,
    ) -> Products:
        """Sum up the products of what `filtered` returns, in one pass of the equations' own where they have one.

        Without names (None) those of the residuals alone; not `sharp`, with an error far below the noise.
        """
        kernel = self._kernel
        if kernel is None or isinstance(self.data, FrequencyResponse):
            evaluation = self.evaluate(values, names or (), sharp=sharp)
            if names is None:
                evaluation.jacobian = evaluation.jacobian[:0]
            if whitening is not None and not isinstance(self.data, FrequencyResponse):
                evaluation = whitening(evaluation)
            with np.errstate(over="ignore", invalid="ignore"):
                return Products.of(evaluation.residual, evaluation.jacobian, int(evaluation.valid.sum()))
        outputs = self.structure.outputs
        nuisance = () if names is None else self.nuisance
        own = [name for name in nuisance if name in self.structure.equations.states]
        names = names or ()
        offsets = np.array([values.get(f"offset {output}", 0.0) for output in outputs])
        filters = np.ones((len(outputs), 1))
        if whitening is not None:
            filters = np.ascontiguousarray(np.array(whitening.models)[:, : whitening.order + 1])
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
