"""The likelihood of a ship: by the kernel that sees it as the record does, with a torque's scale and moving water."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import STATES, Coordinates, wall_row
from shipfp_rs.identification.likelihood import Likelihood, Slopes, noise_root, spread_of
from shipfp_rs.identification.record import Record
from shipfp_rs.identification.water import beyond_the_law, moving_water
from shipfp_rs.structures.ship import INDEX, KERNEL
from shipfp_rs.support.arrays import Array, ComplexArray

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


@dataclass(frozen=True, eq=False, kw_only=True)
class ShipLikelihood(Likelihood):
    """Of a ship, given records.

    Parameters
    ----------
    outputs
        Places of the outputs among the kernel's.
    water
        For each record moving water that drives the ship, at the decimated data's rate (K,); None: it is noise.
    """

    records: tuple[Record, ...]
    coordinates: Coordinates
    outputs: tuple[int, ...]
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

    def modelled(self, vector: Array, record: int) -> Array:
        """Decimated outputs of a record, (O, K)."""
        return self.simulated(vector, record, [])[:, 0]

    def residuals(self, vector: Array, *, wet: bool = True) -> list[ComplexArray]:
        """For each record the residuals at a vector, (O, F)."""
        return [
            record.spectrum - record.see(self.simulated(vector, index, [], wet=wet)[:, 0])
            for index, record in enumerate(self.records)
        ]

    def total(self, vector: Array) -> float:
        """Deviance at a vector under the noise of its own residuals; the less of with and without water."""
        if self.water is None:
            return super().total(vector)
        try:
            return min(replace(self, water=None).total(vector), self._wet_total(vector))
        except (SimulationError, np.linalg.LinAlgError):
            return np.inf

    def _wet_total(self, vector: Array) -> float:
        """The same where the water drives the ship: of what is left of the torque, and of the water itself.

        Speed and torque follow from both along lines with the determinant p + s tau of the load.
        """
        values = self.coordinates.values(vector)
        (speed, _), inertia = self._water_seen(values)
        found = float(np.sum(self.prior_rows(vector)[:, 0] ** 2))
        residuals, _ = self._left(self.residuals(vector))
        for record, residual, beyond in zip(self.records, residuals, self._beyond(vector), strict=True):
            residual[speed] = record.see(beyond)
            root = noise_root(residual)
            turned = np.einsum("fab,bf->af", root, residual)
            load = values["p"] + 2j * np.pi * record.frequency_hz * inertia[1]
            found += (
                float(np.sum(np.abs(turned) ** 2)) + spread_of(root) - 4.0 * float(np.log(np.abs(load)).sum())
            )
        return found

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, slopes: Slopes | None = None
    ) -> Array:
        """Those of all models, and a wall: the inertia behind the gauge is a part of the whole."""
        rows = super().prior_rows(vector, values, slopes)
        wall = wall_row(self.coordinates, vector)
        return rows if wall is None else np.vstack([rows, wall])

    def with_noise_of(self, other: Likelihood) -> Self:
        """Return the likelihood with the noise and the water of another one of the same records."""
        found = super().with_noise_of(other)
        return replace(found, water=other.water) if isinstance(other, ShipLikelihood) else found

    def with_water(self, vector: Array, *, always: bool = False) -> ShipLikelihood:
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
