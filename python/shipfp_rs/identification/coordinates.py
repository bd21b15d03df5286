"""Search coordinates of a ship: ratios to the inertia's time constant tau_n.

Data determine these ratios far better than the parameters. Divided by tau_n, the ship's equations are linear in 1 / tau_n,
(p - g) / tau_n, vK_p / tau_n and vK_i / tau_n, except for N^p (eq. 3.31). A valley of the deviance along which only the
curvature of N^p changes is a straight line in these coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shipfp_rs.identification.likelihood import SMALL, Figure, Itself
from shipfp_rs.support.arrays import Array, Values

STATE_REACH = 0.3
"""Largest relative error of a record's set point and torque."""
LOGARITHMS = ("tau_n", "rate", "rate_down", "tau_twist", "v", "M_soft")
"""Parameters that are searched as logarithms."""
SQUARES = ("hold",)
"""Parameters that are searched as squares: their effect is quadratic, so their derivative vanishes at zero."""
RATIOS = ("vK_p", "vK_i")
"""Parameters that are searched as a ratio to tau_n, without a logarithm. Along a valley (p - g) / tau_n and vK_i / tau_n
rise in proportion; a logarithm would bend that valley."""
MOST_BEHIND, WALL = 0.95, 0.01
"""Largest share of the inertia behind a gauge, and width of the penalty near it."""
SMALLEST = 1e-3
"""Least gain over tau_n."""


STATE_DEVIATION = 0.1
"""Prior standard deviation of the records' unknowns, relative to the operating point."""


@dataclass(frozen=True)
class Coordinates:
    """Search vectors: free parameters of a ship within bounds, followed by the unknowns of its records.

    Parameters
    ----------
    free
        Name to (lower, upper) bound, in the parameter's unit.
    given
        Name to value of the parameters that are not searched.
    records
        Number of records.
    unknowns
        Names of the unknowns that each record has.
    """

    free: Mapping[str, tuple[float, float]]
    given: Mapping[str, float]
    records: int
    unknowns: tuple[str, ...]

    @property
    def state_deviation(self) -> float:
        """Prior standard deviation of the records' unknowns, relative to the operating point."""
        return STATE_DEVIATION

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.free)

    @cached_property
    def size(self) -> int:
        """Length of a search vector."""
        return len(self.free) + self.records * len(self.unknowns)

    @cached_property
    def _own(self) -> tuple[Callable[[float], float], ...]:
        """Functions that map entries of a search vector to parameters in their units."""
        return tuple(
            math.exp if name in LOGARITHMS else math.sqrt if name in SQUARES else float for name in self.names
        )

    @cached_property
    def _place_of(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.free)}

    @cached_property
    def _ratios(self) -> tuple[str, ...]:
        return tuple(name for name in RATIOS if name in self.free)

    def place(self, name: str) -> int:
        """Index of a parameter in a search vector."""
        return self._place_of[name]

    def states(self, record: int) -> slice:
        """Slice of a record's unknowns in a search vector."""
        first = len(self.free) + record * len(self.unknowns)
        return slice(first, first + len(self.unknowns))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of a search vector; those of ratios are wide, since intervals apply the parameter's bounds."""
        rows = [self._bounds(name, *self.free[name]) for name in self.free]
        rows += [(-STATE_REACH, STATE_REACH)] * (self.records * len(self.unknowns))
        low, high = np.array(rows).T
        return low, high

    def _bounds(self, name: str, low: float, high: float) -> tuple[float, float]:
        if name == "g":
            return (-50.0, 500.0)
        if name in RATIOS:
            return SMALLEST, 5e3
        if name in LOGARITHMS:
            return float(np.log(max(low, 1e-9))), float(np.log(high))
        return (low**2, high**2) if name in SQUARES else (low, high)

    def values(self, vector: Array) -> dict[str, float]:
        """Return the parameters in their units, given ones included."""
        values = dict(self.given)
        for name, own, x in zip(self.names, self._own, vector.tolist(), strict=False):
            values[name] = own(x)
        tau = values["tau_n"]
        for name in self._ratios:
            values[name] *= tau
        if "g" in self.free:
            values["g"] = values["p"] - values["g"] * tau
        return self.completed(values)

    def completed(self, values: dict[str, float]) -> dict[str, float]:
        """Add the gains K = vK / v to the values where the rack's torque v is searched."""
        if "v" in self.free:
            values |= {gain[1:]: values[gain] / values["v"] for gain in RATIOS}
        return values

    def states_at(self, vector: Array) -> list[dict[str, float]]:
        """Return each record's unknowns by name."""
        return [
            dict(zip(self.unknowns, vector[self.states(record)].tolist(), strict=True))
            for record in range(self.records)
        ]

    def vector(self, values: Mapping[str, float], states: Sequence[Mapping[str, float]] = ()) -> Array:
        """Return the search vector for values within the bounds; unknowns of records are zero unless given."""
        known = {**self.given, **values}
        tau = known["tau_n"]
        vector = np.zeros(self.size)
        for place, name in enumerate(self.names):
            value = known[name]
            if name == "g":
                vector[place] = (known["p"] - value) / tau
            elif name in LOGARITHMS:
                vector[place] = np.log(max(value, 1e-9))
            elif name in RATIOS:
                vector[place] = value / tau
            else:
                vector[place] = value**2 if name in SQUARES else value
        for record, row in enumerate(states):
            vector[self.states(record)] = [row.get(name, 0.0) for name in self.unknowns]
        return np.clip(vector, *self.bounds)

    def slopes(self, values: Mapping[str, float]) -> dict[str, dict[int, float]]:
        """Derivatives of the parameters by entries of a search vector: {parameter: {index: slope}}."""
        rows = self.jacobian(values).tolist()
        return {
            name: {place: slope for place, slope in enumerate(row) if slope}
            for name, row in zip(self.names, rows, strict=True)
        }

    def jacobian(self, values: Mapping[str, float]) -> Array:
        """Derivatives of the free parameters by their entries of a search vector, (W, W)."""
        own = [
            values[name] if way is math.exp else 0.5 / values[name] if way is math.sqrt else 1.0
            for name, way in zip(self.names, self._own, strict=True)
        ]
        found, place_of = np.zeros((len(own), len(own))), self._place_of
        found.flat[:: len(own) + 1] = own
        tau, g = place_of.get("tau_n"), place_of.get("g")
        for name in self._ratios:
            found[place_of[name], place_of[name]] = values["tau_n"]
            if tau is not None:
                found[place_of[name], tau] = values[name]
        if g is not None:
            found[g, g] = -values["tau_n"]
            if tau is not None:
                found[g, tau] = values["g"] - values["p"]
            if "p" in place_of:
                found[g, place_of["p"]] = 1.0
        return found

    def gradient(self, figure: Figure, vector: Array) -> Array:
        """Derivative of a figure by the search vector, shape (P,)."""
        values, slopes = self.values(vector), np.zeros(len(self.names))
        found = np.zeros(self.size)
        if isinstance(figure, Itself) and figure.name in self.free:
            found[: len(slopes)] = self.jacobian(values)[self.place(figure.name)]
            return found
        moved = dict(values)
        for place, name in enumerate(self.names):
            value = values[name]
            step = SMALL * max(1.0, abs(value))
            moved[name] = value + step
            up = figure(self.completed(moved))
            moved[name] = value - step
            down = figure(self.completed(moved))
            moved[name] = value
            if up != down:
                slopes[place] = (up - down) / (2.0 * step)
        found[: len(slopes)] = slopes @ self.jacobian(values)
        return found


def loop_of(values: Values) -> dict[str, float]:
    """Return the parameters of transfer functions: p includes the damping; where v is known, gains exclude it."""
    found = {**values, "p": values["p"] + values.get("damping", 0.0)}
    for gain in ("vK_p", "vK_i", "vK_d"):
        if "v" in found and gain in found:
            found[gain[1:]] = found.pop(gain) / found["v"]
    return found


def wall_row(c: Coordinates, vector: Array, values: Mapping[str, float] | None = None) -> Array | None:
    """Residual and derivatives (1 + P,) of the penalty on the inertia behind the gauge; None if the penalty is inactive."""
    values = c.values(vector) if values is None else values
    behind, whole = values.get("tau_prop", 0.0), values["tau_n"]
    if behind <= MOST_BEHIND * whole or "tau_prop" not in c.free:
        return None
    by = c.jacobian(values)
    row = np.zeros(c.size + 1)
    row[0] = (MOST_BEHIND - behind / whole) / WALL
    row[1 : 1 + len(by)] = by[c.place("tau_prop")] / (whole * WALL)
    if "tau_n" in c.free:
        row[1 : 1 + len(by)] -= behind * by[c.place("tau_n")] / (whole**2 * WALL)
    return row
