"""The likelihood of a smooth ship: residuals of its two equations in closed form, no simulation.

The kernel gives products of whitened residuals, derivatives and smooth errors by its own parameters. Here they become those
by the search's coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Hold
from shipfp_rs.identification.coordinates import Coordinates, wall_row
from shipfp_rs.identification.likelihood import Likelihood, Products, Slopes, Tangent, real_rows
from shipfp_rs.identification.record import interpolated
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.ship import INDEX as SHIP_INDEX
from shipfp_rs.structures.ship import KERNEL as SHIP_NAMES
from shipfp_rs.support.arrays import Array, ComplexArray, Numbers

INDEX = {name: index for index, name in enumerate(_core.EQUATION_PARAMETERS)}
"""Places of the kernel's parameters."""
OFF = np.array([float(name in ("v", "s_M")) for name in INDEX])
"""The kernel's parameters without effect."""
UNKNOWNS = {"set point offset": "u_0", "torque scale": "s_M", "rack offset": "x_0"}
"""A record's own unknowns and the kernel's names. The operating point is a mean over a minute of moving water, right to
parts in a thousand: set point and speed differ by an offset, the torque is relative to another mean than the load's."""


Asked = tuple[Array, Array, float, Array, float, Array, float, list[int], bool, bool]
"""Arguments that the kernel's functions have in common."""
MOST_TWISTED = 0.98
"""Largest part of the inertia behind a shaft that twists."""
FINE_HZ = 200.0
"""Rate from which on straight lines between samples are as good as the band-limited set point [Hz]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EquationLikelihood(Likelihood):
    """Of a ship without limits, given records.

    Parameters
    ----------
    gauge
        Whether the torque is read between the inertias.
    """

    records: tuple[Spectra, ...]
    coordinates: Coordinates
    gauge: bool

    @cached_property
    def _outputs(self) -> list[int]:
        return [_core.EQUATION_OUTPUTS.index(name) for name in self.records[0].outputs]

    def _asked(self, values: Mapping[str, float], vector: Array, record: int) -> Asked:
        """Return the kernel's parameters, and what its functions take behind them up to what moves."""
        data, c = self.records[record], self.coordinates
        parameters = OFF.copy()
        for name, value in values.items():
            if name in INDEX:
                parameters[INDEX[name]] = value
        parameters[self._unknowns] += vector[c.states(record)]
        dead, both = values.get("T_d", 0.0), values.get("T_d", 0.0) + values.get("T_set", 0.0)
        speed, set_point = data.delayed("speed", dead), data.delayed("set point", both)
        return (parameters, data.signals, data.spacing, *speed, *set_point, self._outputs, self.gauge, False)

    @cached_property
    def _unknowns(self) -> list[int]:
        """Places of a record's own unknowns among the kernel's parameters."""
        return [INDEX[UNKNOWNS[name]] for name in self.coordinates.unknowns]

    @cached_property
    def _moving(self) -> list[int]:
        """The kernel's parameters that move."""
        return [*(INDEX[name] for name in self.coordinates.names), *self._unknowns]

    def _turn(self, slopes: Slopes, record: int) -> Array:
        """Return the columns' change of coordinates, (1 + W, 1 + P)."""
        c = self.coordinates
        turn = np.zeros((1 + len(self._moving), 1 + c.size))
        turn[0, 0] = 1.0
        for row, name in enumerate(c.names, 1):
            for place, slope in slopes[name].items():
                turn[row, 1 + place] = slope
        first, columns = 1 + len(c.names), 1 + c.states(record).start
        for unknown in range(len(self._unknowns)):
            turn[first + unknown, columns + unknown] = 1.0
        return turn

    def products(self, vector: Array, tangent: Tangent | None = None) -> Products:
        """Deviance, gradient and Gauss-Newton matrix at a vector, exactly; a `tangent` is not needed.

        Raises
        ------
        SimulationError
            Where the loop is unstable.
        """
        del tangent
        gram = self._gram(vector, derivatives=True)
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:])

    def cost(self, vector: Array) -> float:
        """Deviance at a vector; infinite where the loop is unstable."""
        try:
            return float(self._gram(vector, derivatives=False)[0, 0])
        except SimulationError:
            return np.inf

    def _gram(self, vector: Array, *, derivatives: bool) -> Array:
        size = 1 + self.coordinates.size if derivatives else 1
        gram, errors = np.zeros((size, size)), np.zeros((1, size))
        values = self.coordinates.values(vector)
        slopes = self.coordinates.slopes(values)
        for index, (root, shapes, hats) in enumerate(self._laid_out):
            asked = self._asked(values, vector, index)
            moving = self._moving if derivatives else []
            products, crossed = _core.equation_products(*asked, moving, root, shapes, hats)
            if derivatives:
                turn = self._turn(slopes, index)
                products, crossed = turn.T @ products @ turn, crossed @ turn
            gram += products
            errors = errors + crossed if len(crossed) else errors
        if self.bends:
            gram -= errors.T @ self._errors_inverse @ errors
        priors = self.prior_rows(vector, values, slopes)[:, :size]
        gram += priors.T @ priors
        if not np.isfinite(gram).all():
            raise SimulationError("the deviance is not finite")
        return gram

    @cached_property
    def _laid_out(self) -> list[tuple[Array, Array, Array]]:
        """For each record the noise's root, whitened shapes of the smooth errors and their hats, for the kernel."""
        found = []
        for index, record in enumerate(self.records):
            root = self.root(index)
            if root.ndim == 2:
                root = np.broadcast_to(root, (len(record.frequency_hz), *root.shape))
            root = np.moveaxis(root, 0, -1).astype(complex)
            root[..., 0] = 0.0  # the means belong to the offsets alone
            shapes, hats = np.zeros((0, 0, 2, 0)), np.zeros((0, record.padded))
            if self.bends:
                shapes = _parts(root * (self.accuracy[:, None] * self.responses[index])[None], record.padded)
                hats = np.zeros((len(self._knots), record.padded))
                hats[:, : len(record.frequency_hz)] = self._hats[index]
            found.append((_parts(root, record.padded), shapes, hats))
        return found

    @cached_property
    def _knots(self) -> Array:
        return self.knots()

    @cached_property
    def _hats(self) -> list[Array]:
        return [self.hats(record.frequency_hz) for record in self.records]

    @cached_property
    def _errors_inverse(self) -> Array:
        """What the sizes of the smooth errors vary by, (E, E), E over outputs, amplitude and phase, and knots."""
        outputs, knots = len(self.accuracy), len(self._knots)
        total = np.zeros((outputs, 2, knots, outputs, 2, knots))
        for (_, shapes, _), hats in zip(self._laid_out, self._hats, strict=True):
            whole = shapes[:, :, 0, : hats.shape[1]] + 1j * shapes[:, :, 1, : hats.shape[1]]
            for a in range(outputs):
                for b in range(outputs):
                    weight = np.sum(whole[:, a].conj() * whole[:, b], axis=0)
                    real, imaginary = ((hats * part) @ hats.T for part in (weight.real, weight.imag))
                    total[a, 0, :, b, 0] += real
                    total[a, 1, :, b, 1] += real
                    total[a, 0, :, b, 1] -= imaginary
                    total[a, 1, :, b, 0] += imaginary
        square = total.reshape(2 * outputs * knots, -1)
        return np.asarray(np.linalg.inv(square + np.eye(len(square))))

    def smooth_errors(self, residuals: Sequence[Numbers]) -> tuple[Array, Array]:
        """Sizes of the smooth errors that residuals show, in prior deviations (E,), and what these are unsure by (E, E)."""
        crossed = np.zeros((len(self.accuracy), 2, len(self._knots)))
        if not self.bends:
            return crossed.ravel(), np.eye(crossed.size)
        for (root, shapes, _), hats, residual in zip(self._laid_out, self._hats, residuals, strict=True):
            count = hats.shape[1]
            turn = (root[:, :, 0] + 1j * root[:, :, 1])[..., :count]
            whole = (shapes[:, :, 0] + 1j * shapes[:, :, 1])[..., :count]
            along = np.einsum("abf,af->bf", whole.conj(), np.einsum("abf,bf->af", turn, residual))
            crossed[:, 0] += along.real @ hats.T
            crossed[:, 1] += along.imag @ hats.T
        return self._errors_inverse @ crossed.ravel(), self._errors_inverse

    def _left(self, residuals: Sequence[Numbers]) -> tuple[list[Numbers], list[Numbers]]:
        if not self.bends:
            return super()._left(residuals)
        outputs, knots = len(self.accuracy), len(self._knots)
        sizes, inverse = self.smooth_errors(residuals)
        sizes = sizes.reshape(outputs, 2, knots)
        inverse = inverse.reshape(outputs, 2, knots, outputs, 2, knots)
        left, unsure = [], []
        for residual, hats, response in zip(residuals, self._hats, self.responses, strict=True):
            scaled = self.accuracy[:, None] * response
            left.append(residual - scaled * ((sizes[:, 0] + 1j * sizes[:, 1]) @ hats))
            spread = np.zeros((outputs, outputs, hats.shape[1]), complex)
            for a in range(outputs):
                for b in range(outputs):
                    block = inverse[a, :, :, b]
                    both = (block[0, :, 0] + block[1, :, 1]) + 1j * (block[1, :, 0] - block[0, :, 1])
                    spread[a, b] = np.sum(hats * (both @ hats), axis=0) * scaled[a] * scaled[b].conj()
            unsure.append(spread)
        return left, unsure

    def spectra(self, vector: Array, record: int) -> tuple[ComplexArray, ComplexArray]:
        """Residuals (O, F) of a record and the model's derivatives by the whole vector (P, O, F)."""
        slopes = self.coordinates.slopes(self.coordinates.values(vector))
        rows = self._residuals(vector, record, self._moving)
        return rows[0], np.tensordot(self._turn(slopes, record)[1:, 1:].T, rows[1:], 1)

    def _residuals(self, vector: Array, record: int, moving: list[int]) -> ComplexArray:
        asked = self._asked(self.coordinates.values(vector), vector, record)
        if not _core.loop_is_stable(asked[0], False):
            raise SimulationError("the loop is unstable")
        found = _core.equation_residuals(*asked, moving)
        count = len(self.records[record].frequency_hz)
        rows = found[:, :, 0, :count] + 1j * found[:, :, 1, :count]
        rows[..., 0] = 0.0  # the means belong to the offsets alone
        return np.asarray(rows)

    def residuals(self, vector: Array, *, wet: bool = True) -> list[Numbers]:
        """For each record the residuals at a vector, (O, F)."""
        del wet
        return [self._residuals(vector, index, [])[0] for index in range(len(self.records))]

    def modelled(self, vector: Array, record: int) -> Array:
        """Decimated outputs of a record, (O, K): at its ends and above the band the data themselves."""
        data = self.records[record]
        answer = data.in_time(data.spectrum - self._residuals(vector, record, [])[0])
        return np.asarray(data.decimated * (1.0 - data.tapers[0]) + answer)

    def with_columns(self, vector: Array, columns: Sequence[ComplexArray]) -> Array:
        """Products of residual, derivatives and more columns, smooth errors and priors included, (1 + P + C, 1 + P + C).

        `columns` has for each record spectra of the outputs, (C, O, F).
        """
        gram, errors = np.zeros(()), np.zeros(())
        for index, more in enumerate(columns):
            (root, shapes, _), hats = self._laid_out[index], self._hats[index]
            count = len(self.records[index].frequency_hz)
            residual, jacobian = self.spectra(vector, index)
            rows = np.concatenate([residual[None], jacobian, more])
            turn, whole = (part[:, :, 0, :count] + 1j * part[:, :, 1, :count] for part in (root, shapes))
            white = np.einsum("abf,cbf->caf", turn, rows)
            along = np.einsum("abf,caf->cbf", whole.conj(), white)
            flat = real_rows(white)
            gram = gram + flat @ flat.T
            parts = np.stack([along.real, along.imag], axis=2) @ hats.T
            errors = errors + parts.reshape(len(rows), -1)
        gram = gram - errors @ self._errors_inverse @ errors.T
        priors = self.prior_rows(vector)
        size = priors.shape[1]
        gram[:size, :size] += priors.T @ priors
        return np.asarray(gram)

    def simulated(self, vector: Array, record: int) -> Array:
        """Outputs of a record by the stepper, at the data's rate, (O, N)."""
        data, c = self.records[record], self.coordinates
        values, states = c.values(vector), dict(zip(c.unknowns, vector[c.states(record)], strict=True))
        parameters = np.array(_core.SHIP_OFF)
        parameters[SHIP_INDEX["v"]] = values.get("v", 1.0)
        for name, value in values.items():
            gain = name in ("vK_p", "vK_i", "vK_d")
            place = SHIP_INDEX.get(SHIP_NAMES.get(name, name))
            if place is not None and name not in ("v", "K_p", "K_i"):
                parameters[place] = value / values.get("v", 1.0) if gain else value
        if values.get("tau_twist"):
            place = SHIP_INDEX["tau_prop"]
            parameters[place] = min(parameters[place], MOST_TWISTED * values["tau_n"])
        parameters[SHIP_INDEX["u_0"]] = states["set point offset"]
        parameters[SHIP_INDEX["s_M"]] = 1.0 + states["torque scale"]
        names = {"dn": "dn", "dM": "dM_g" if self.gauge else "dM_b", "dX": "dX"}
        outputs = [_core.SHIP_OUTPUTS.index(names[name]) for name in data.outputs]
        fine = max(1, round(FINE_HZ / data.data_hz)) if data.between == "band-limited" else 1
        set_point, load = (interpolated(values, fine) for values in (1.0 + data.set_point, data.load))
        hold: Hold = "zero" if data.between == "held" else "first"
        dt = 1.0 / (data.data_hz * fine)
        return _core.simulate_ship(parameters, set_point, load, dt, 0, hold, outputs)[:, ::fine]

    @property
    def is_corrected_by_model(self) -> bool:
        """Whether the records follow from the model, too: gaps that it fills, and squares of a propeller's speed."""
        return "tau_twist" in self.coordinates.free or any(one.masked.any() for one in self.records)

    def corrected(self, vector: Array) -> Self:
        """Return the likelihood of the records corrected by the model at a vector; see `Spectra.corrected`."""
        values = self.coordinates.values(vector)
        records = tuple(
            record.corrected(
                values, self.gauge, self.simulated(vector, index) if record.masked.any() else None
            )
            for index, record in enumerate(self.records)
        )
        return replace(self, records=records)

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, slopes: Slopes | None = None
    ) -> Array:
        """Those of all models, and a wall: the inertia behind the gauge is a part of the whole."""
        rows = super().prior_rows(vector, values, slopes)
        wall = wall_row(self.coordinates, vector)
        return rows if wall is None else np.vstack([rows, wall])


def _parts(values: Numbers, padded: int) -> Array:
    """Complex numbers (O, O, F) as real and imaginary parts, (O, O, 2, padded)."""
    found = np.zeros((*values.shape[:2], 2, padded))
    found[:, :, 0, : values.shape[2]], found[:, :, 1, : values.shape[2]] = values.real, values.imag
    return found
