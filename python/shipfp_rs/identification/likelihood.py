"""The one likelihood: spectra of all outputs together, in a band, coloured by the residuals' own spectral matrix.

Beside its parameters a ship has unknowns that are linear and have a prior, eliminated in closed form: smooth multiplicative
errors of each output's response, amplitude and phase, an octave wide, of the size that gauge and calibration leave open
(Kennedy and O'Hagan 2001, doi:10.1111/1467-9868.00294). Whittle 1953 (doi:10.1007/BF02590998) is the likelihood of spectra.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import STATES, Coordinates
from shipfp_rs.identification.record import Record
from shipfp_rs.identification.water import beyond_the_law, moving_water
from shipfp_rs.structures.ship import INDEX, KERNEL
from shipfp_rs.support.arrays import Array, ComplexArray

ACCURACY = 3e-3
"""Smooth relative error of an output's response that gauge and calibration leave open, one standard deviation."""
OCTAVE = 1.0
"""Width of these errors in octaves."""
OVER, LEAST_REACH, MOST_REACH = 0.35, 10, 40
"""Frequencies on either side over which the residuals' spectral matrix is averaged: a third of the own one, within these."""
STEEP, MOST_FALL = 40, -2.0
"""Number of the lowest frequencies over which noise may fall by a power of the frequency, and the greatest fall."""
FLOOR = 1e-3
"""Least of that matrix, over its median."""
MOST_BEHIND, WALL = 0.95, 0.01
"""Largest part of the inertia that may lie behind a gauge, and how steep the wall at it is."""
TORQUES = ("dM_b", "dM_g")
"""The kernel's torques."""
TORQUE_PLACES = [_core.SHIP_OUTPUTS.index(name) for name in TORQUES]
"""Their places."""
SPEED_PLACES = [_core.SHIP_OUTPUTS.index("dn"), _core.SHIP_OUTPUTS.index("dn_prop")]
"""Places of the kernel's speeds."""
SCALE = "torque scale"
"""A record's unknown that multiplies its torque."""
LIMITS = {"M_max", "rate"}
"""Parameters of what moving water sets off, so that its part is none that adds."""
STATE_DEVIATION = 0.1
"""Of a record's states, over the operating point: where a quick loop has forgotten them, nothing else holds them."""
WHITE = 1e-3
"""Noise over the operating point before any was estimated."""


class Tangent(NamedTuple):
    """The model's derivatives at a vector (P, R), smooth errors taken out, and their products with each other (P, P).

    R counts the real numbers of all records' spectra in units of the noise.
    """

    rows: Array
    matrix: Array


class Products(NamedTuple):
    """Deviance at a vector, half its gradient's negative, the Gauss-Newton matrix, and the derivatives behind both."""

    cost: float
    downhill: Array
    matrix: Array
    tangent: Tangent
    left: tuple[Array, Array]
    """Residuals in units of the noise (R,), and the same with smooth errors taken out."""

    def learnt(self, before: Products, step: Array) -> Products:
        """Return them with derivatives that agree with the step that led here (Broyden 1965, doi:10.2307/2003941)."""
        rows, matrix = self.tangent
        moved = [was - now for was, now in zip(before.left, self.left, strict=True)]
        scale = np.maximum(np.diag(matrix), 1e-30)
        # In units of each entry's own curvature the least change is along the step.
        along = scale * step / (step @ (scale * step))
        foreseen, seen = matrix @ step, rows @ moved[0]
        missed = moved[1] - step @ rows
        cross, square = seen - foreseen, moved[0] @ moved[1] - step @ (2.0 * seen - foreseen)
        more = np.outer(along, cross) + np.outer(cross, along) + square * np.outer(along, along)
        return self._replace(
            downhill=self.downhill + along * (missed @ self.left[0]),
            matrix=self.matrix + more,
            tangent=Tangent(rows + np.outer(along, missed), matrix + more),
        )


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Of a ship, given records.

    Parameters
    ----------
    records, coordinates
        Data and free parameters.
    outputs
        Places of the outputs among the kernel's.
    accuracy
        Smooth relative error of each output's response, one standard deviation, shape (O,).
    priors
        Parameter to (mean, standard deviation).
    roots
        For each record the root of the inverse spectral matrix of its noise, (F, O, O); None: white.
    responses
        For each record the spectra of the model's outputs at the vector that the noise is from, (O, F): what smooth errors
        are relative to. Relative to the data's they would take noise for a response, and be rewarded for shrinking it.
    water
        For each record moving water that drives the ship, at the decimated data's rate (K,); None: it is noise.
    """

    records: tuple[Record, ...]
    coordinates: Coordinates
    outputs: tuple[int, ...]
    accuracy: Array
    priors: Mapping[str, tuple[float, float]]
    roots: tuple[ComplexArray, ...] | None = None
    responses: tuple[ComplexArray, ...] = ()
    water: tuple[Array, ...] | None = None

    def simulated(self, vector: Array, record: int, wrt: Sequence[int], *, wet: bool = True) -> Array:
        """Outputs of a record and their derivatives by the kernel's parameters, decimated (O, 1 + W, K); wet: with water."""
        data, c = self.records[record], self.coordinates
        values = c.values(vector)
        parameters = c.kernel(values, vector[c.states(record)])
        if wet and self.water is not None:
            data = self._wet[record]
            parameters[INDEX["load_gain"]] = values.get("k_L", 1.0)
        return data.simulated(parameters, self.outputs, wrt)

    @cached_property
    def _wet(self) -> tuple[Record, ...]:
        """The records driven by their water, too."""
        assert self.water is not None
        return tuple(record.driven_by(water) for record, water in zip(self.records, self.water, strict=True))

    def spectra(self, vector: Array, record: int) -> tuple[ComplexArray, ComplexArray]:
        """Residuals (O, F) of a record and the model's derivatives by the whole vector (P, O, F)."""
        data, c = self.records[record], self.coordinates
        values = c.values(vector)
        slopes = c.slopes(values)
        # The torque's scale is no derivative that the kernel has to carry along.
        by = [*slopes, *(name for name in STATES if name != SCALE)]
        v = values.get("v", 1.0)
        wrt = [INDEX[STATES.get(name, KERNEL.get(name, name))] for name in by]
        simulated = self.simulated(vector, record, wrt)
        scale = 1.0 + vector[c.states(record)][list(STATES).index(SCALE)]
        torques = np.isin(self.outputs, TORQUE_PLACES)
        scaled = np.where(torques[:, None], (simulated[:, 0] + 1.0) / scale, 0.0)
        seen = data.see(np.concatenate([simulated, scaled[:, None]], axis=1))
        residual = data.spectrum - seen[:, 0]
        jacobian = np.zeros((c.size, *residual.shape), complex)
        for column, name in enumerate(by[: len(slopes)], 1):
            own = 1.0 / v if KERNEL.get(name, name) in ("K_p", "K_i", "K_d") and name.startswith("v") else 1.0
            for place, slope in slopes[name].items():
                jacobian[place] += (own * slope) * seen[:, column]
        if "v" in slopes:
            # At a fixed product the gains fall as v grows.
            for gain in ("vK_p", "vK_i", "vK_d"):
                if gain in values:
                    at = INDEX[KERNEL[gain]]
                    if at in wrt:
                        jacobian[c.place("v")] -= values[gain] / v * seen[:, 1 + wrt.index(at)]
        jacobian[c.states(record)] = np.moveaxis(seen[:, 1 + len(slopes) :], 1, 0)
        return residual, jacobian

    def products(self, vector: Array, tangent: Tangent | None = None) -> Products:
        """Deviance, gradient and Gauss-Newton matrix at a vector.

        With a `tangent` from nearby only the deviance is exact, in a fraction of the time.

        Raises
        ------
        SimulationError
            Where the ship runs away, or leaves the numbers.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._products(vector, tangent)

    def _products(self, vector: Array, tangent: Tangent | None) -> Products:
        if tangent is None:
            pairs = [self.spectra(vector, index) for index in range(len(self.records))]
            both = [np.concatenate([residual[None], jacobian]) for residual, jacobian in pairs]
        else:
            both = [residual[None] for residual in self.residuals(vector)]
        rows = np.concatenate([self._white(one, index) for index, one in enumerate(both)], axis=1)
        residual, taken = rows[0], rows
        if self.roots is not None:
            shapes, inverse = self._errors
            taken = rows - (rows @ shapes.T) @ inverse @ shapes
        if tangent is None:
            tangent = Tangent(taken[1:], taken[1:] @ rows[1:].T)
        gram = np.empty((self.coordinates.size + 1,) * 2)
        gram[0, 0] = taken[0] @ residual
        gram[0, 1:] = gram[1:, 0] = tangent.rows @ residual if tangent.rows.size else 0.0
        gram[1:, 1:] = tangent.matrix
        self._add_priors(vector, gram)
        if not np.isfinite(gram).all():
            raise SimulationError("the deviance is not finite")
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:], tangent, (residual, taken[0]))

    def smooth_errors(self, residuals: Sequence[ComplexArray]) -> tuple[Array, Array]:
        """Sizes of the smooth errors that residuals show, in prior deviations (E,), and what these are unsure by (E, E)."""
        shapes, unsure = self._errors
        white = np.concatenate([self._white(one[None], index)[0] for index, one in enumerate(residuals)])
        return unsure @ (shapes @ white), unsure

    def residuals(self, vector: Array, *, wet: bool = True) -> list[ComplexArray]:
        """For each record the residuals at a vector, (O, F)."""
        return [
            record.spectrum - record.see(self.simulated(vector, index, [], wet=wet)[:, 0])
            for index, record in enumerate(self.records)
        ]

    def _left(self, residuals: Sequence[ComplexArray]) -> tuple[list[ComplexArray], list[ComplexArray]]:
        """What the smooth errors leave of the residuals, (O, F), and the covariance of what they took, (O, O, F).

        What is left is noise, and all that the model lacks. At low frequencies the errors take noise along, so its power is
        what is left and what they are unsure of (Dempster, Laird and Rubin 1977, doi:10.1111/j.2517-6161.1977.tb01600.x).
        """
        if self.roots is None:
            return list(residuals), [np.zeros((len(one), *one.shape), complex) for one in residuals]
        sizes, inverse = self.smooth_errors(residuals)
        left = [
            one - np.tensordot(sizes, shapes, 1) for one, shapes in zip(residuals, self._shapes, strict=True)
        ]
        unsure = [
            np.einsum("eof,epf->opf", np.tensordot(inverse, shapes, 1), shapes.conj())
            for shapes in self._shapes
        ]
        return left, unsure

    def cost(self, vector: Array) -> float:
        """Deviance at a vector; infinite where the ship runs away."""
        size = self.coordinates.size
        try:
            return self.products(vector, Tangent(np.empty((size, 0)), np.zeros((size, size)))).cost
        except SimulationError:
            return np.inf

    def total(self, vector: Array) -> float:
        """Deviance at a vector under the noise of its own residuals, with that noise's determinant; infinite as `cost`.

        Only so two ends compare that leave different residuals: under the noise of the one the other is at a disadvantage.
        """
        try:
            own = replace(self, water=None).with_noise(vector)
            assert own.roots is not None
            found = own.cost(vector) + sum(map(_spread, own.roots))
            return found if self.water is None else min(found, self._wet_total(vector))
        except (SimulationError, np.linalg.LinAlgError):
            return np.inf

    def _wet_total(self, vector: Array) -> float:
        """The same where the water drives the ship: of what is left of the torque, and of the water itself.

        Speed and torque follow from both along lines with the determinant p + s tau of the load.
        """
        values = self.coordinates.values(vector)
        (speed, _), inertia = self._water_seen(values)
        gram = np.zeros((self.coordinates.size + 1,) * 2)
        self._add_priors(vector, gram)
        found = float(gram[0, 0])
        residuals, _ = self._left(self.residuals(vector))
        for record, residual, beyond in zip(self.records, residuals, self._beyond(vector), strict=True):
            residual[speed] = record.see(beyond)
            root = noise_root(residual)
            turned = np.einsum("fab,bf->af", root, residual)
            load = values["p"] + 2j * np.pi * record.frequency_hz * inertia[1]
            found += (
                float(np.sum(np.abs(turned) ** 2)) + _spread(root) - 4.0 * float(np.log(np.abs(load)).sum())
            )
        return found

    def _add_priors(self, vector: Array, gram: Array) -> None:
        values = self.coordinates.values(vector)
        slopes = self.coordinates.slopes(values)

        def add(residual: float, by: Mapping[int, float]) -> None:
            row = np.zeros(len(gram))
            row[0] = residual
            for place, slope in by.items():
                row[1 + place] = slope
            gram[...] += np.outer(row, row)

        for name, (mean, deviation) in self.priors.items():
            found = slopes.get(name, {}).items()
            add((mean - values[name]) / deviation, {place: slope / deviation for place, slope in found})
        for place in range(len(self.coordinates.free), len(vector)):
            add(-vector[place] / STATE_DEVIATION, {place: 1.0 / STATE_DEVIATION})
        # The inertia behind the gauge is a part of the whole.
        behind, whole = values.get("tau_prop", 0.0), values["tau_n"]
        if behind > MOST_BEHIND * whole and "tau_prop" in slopes:
            by = {place: slope / (whole * WALL) for place, slope in slopes["tau_prop"].items()}
            for place, slope in slopes.get("tau_n", {}).items():
                by[place] = by.get(place, 0.0) - behind * slope / (whole**2 * WALL)
            add((MOST_BEHIND - behind / whole) / WALL, by)

    def _white(self, spectra: ComplexArray, record: int) -> Array:
        """Spectra (W, O, F) in units of the noise, as rows of real numbers (W, 2 O F)."""
        own = None if self.roots is None else self.roots[record]
        turned = spectra / WHITE if own is None else np.zeros_like(spectra)
        if own is not None:  # lower triangles
            for a, b in zip(*np.tril_indices(own.shape[1]), strict=True):
                turned[:, a] += own[:, a, b] * spectra[:, b]
        flat = turned.reshape(len(spectra), -1)
        return np.concatenate([flat.real, flat.imag], axis=1)

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood whose noise is that of the residuals at a vector, water's part included."""
        residuals = self.residuals(vector, wet=False)
        responses = tuple(record.spectrum - one for record, one in zip(self.records, residuals, strict=True))
        roots = tuple(map(noise_root, *self._left(residuals)))
        return replace(self, roots=roots, responses=responses)

    def with_noise_of(self, other: Likelihood) -> Self:
        """Return the likelihood with the noise and the water of another one of the same records."""
        return replace(self, roots=other.roots, responses=other.responses, water=other.water)

    def with_water(self, vector: Array, *, always: bool = False) -> Likelihood:
        """Return the likelihood of the ship driven by the water that speed and torque show at a vector.

        Itself where nothing limits the ship, so that water's part is noise that adds, unless it is always asked for, or
        where no torque was measured; without water where that explains the data better.
        """
        values = self.coordinates.values(vector)
        if self._torque is None or not (always or LIMITS & set(values)):
            return self
        seen, _ = self._water_seen(values)
        water = tuple(
            moving_water(record, beyond, self.simulated(vector, index, [], wet=False)[seen, 0])
            / values.get("k_L", 1.0)
            for index, (record, beyond) in enumerate(zip(self.records, self._beyond(vector), strict=True))
        )
        dry, wet = replace(self, water=None), replace(self, water=water)
        # What the model lacks looks like water, too, and would drive it astray.
        return wet if wet._wet_total(vector) < dry.total(vector) else dry

    @property
    def _torque(self) -> str | None:
        """The torque among the outputs."""
        named = [_core.SHIP_OUTPUTS[output] for output in self.outputs]
        return next((name for name in TORQUES if name in named), None)

    def _water_seen(self, values: Mapping[str, float]) -> tuple[list[int], tuple[float, float]]:
        """Places of speed and torque among the outputs, and the inertias ahead of and behind a shaft that twists."""
        torque = self._torque
        assert torque is not None
        twisted = values.get("tau_twist", 0.0) > 0.0
        behind = values["tau_prop" if twisted or torque == "dM_g" else "tau_n"]
        speed = next(place for place, output in enumerate(self.outputs) if output in SPEED_PLACES)
        places = [speed, self.outputs.index(_core.SHIP_OUTPUTS.index(torque))]
        return places, (values["tau_n"] - behind if torque == "dM_b" else 0.0, behind)

    def _beyond(self, vector: Array) -> list[Array]:
        """For each record the torque of the load beyond its law at a vector, (K,)."""
        values = self.coordinates.values(vector)
        seen, inertia = self._water_seen(values)
        at = list(STATES).index(SCALE)
        scales = [
            1.0 + float(vector[self.coordinates.states(index)][at]) for index in range(len(self.records))
        ]
        return [
            beyond_the_law(record, seen, values, inertia, scale)
            for record, scale in zip(self.records, scales, strict=True)
        ]

    @cached_property
    def _shapes(self) -> tuple[ComplexArray, ...]:
        """For each record the shapes of the smooth errors in units of their prior deviation, (E, O, F)."""
        least = min(record.frequency_hz[1] for record in self.records)
        most = max(record.frequency_hz[-1] for record in self.records)
        knots = np.arange(np.log2(least), np.log2(most) + OCTAVE, OCTAVE)
        found = []
        for record, response in zip(self.records, self.responses, strict=True):
            octaves = np.log2(np.maximum(record.frequency_hz, 1e-9))
            hats = np.maximum(1.0 - np.abs(octaves - knots[:, None]) / OCTAVE, 0.0)
            shapes = np.zeros((len(self.accuracy), 2, len(knots), *response.shape), complex)
            for output, accuracy in enumerate(self.accuracy):
                shapes[output, 0, :, output] = accuracy * hats * response[output]
                shapes[output, 1, :, output] = 1j * shapes[output, 0, :, output]
            found.append(shapes.reshape(-1, *response.shape))
        return tuple(found)

    @cached_property
    def _errors(self) -> tuple[Array, Array]:
        """The shapes in units of the noise as rows of all records' numbers (E, R), and what their sizes vary by (E, E)."""
        rows = np.concatenate(
            [self._white(shapes, index) for index, shapes in enumerate(self._shapes)], axis=1
        )
        return rows, np.linalg.inv(rows @ rows.T + np.eye(len(rows)))


def _spread(root: ComplexArray) -> float:
    """Deviance of the determinants of noise by the roots of its inverse, (F, O, O); each number has two parts."""
    return -4.0 * float(np.log(np.abs(np.linalg.det(root))).sum())


def _shape(amplitudes: Array) -> Array:
    """How amplitudes fall from the lowest frequency on, by a power of it, and stay from `STEEP` on, shape (F,)."""
    steep = min(STEEP, len(amplitudes) - 1)
    places = np.log(np.arange(1, steep + 1))
    fall = np.polyfit(places, np.log(amplitudes[1 : steep + 1] + 1e-300), 1)[0]
    # Below the first frequency, at the mean, it rises no further.
    reached = np.clip(np.arange(len(amplitudes)), 1, steep)
    return np.asarray(reached ** min(max(float(fall), MOST_FALL), 0.0))


def noise_root(residual: ComplexArray, unsure: ComplexArray | float = 0.0) -> ComplexArray:
    """Root of the inverse of the smoothed spectral matrix of residuals (O, F), with what is unsure of them, (F, O, O)."""
    outputs, count = residual.shape
    place = np.arange(count)
    # Moving water is slow: at low frequencies its noise is steep, and a mean over some of them is right where it is flat.
    shape = np.array([_shape(np.abs(row)) for row in residual])
    flat = residual / shape
    products = flat[:, None] * flat[None].conj() + unsure / (shape[:, None] * shape[None])
    reach = np.clip((OVER * place).astype(int), LEAST_REACH, max(min(MOST_REACH, count // 8), LEAST_REACH))
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach, count - 1)
    sums = np.concatenate([np.zeros((outputs, outputs, 1)), np.cumsum(products, axis=-1)], axis=-1)
    smooth = (sums[..., last + 1] - sums[..., first]) / (last + 1 - first)
    matrix = 0.5 * np.moveaxis(smooth * shape[:, None] * shape[None], -1, 0)
    diagonal = np.arange(outputs)
    matrix[:, diagonal, diagonal] += FLOOR * np.median(matrix[:, diagonal, diagonal].real, axis=0) + 1e-18
    return np.asarray(np.linalg.inv(np.linalg.cholesky(matrix)))
