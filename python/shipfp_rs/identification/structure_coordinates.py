"""Search coordinates of a given structure: its free parameters, as logarithms where bounds are wide."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shipfp_rs.identification.likelihood import SMALL, Figure, Itself
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support.arrays import Array

STATE_DEVIATION = 1.0
"""Prior deviation of initial states and offsets, relative to the operating point, too wide to matter for most data."""


@dataclass(frozen=True)
class StructureCoordinates:
    """Free parameters of a structure as a bounded vector, followed by the unknowns of its records."""

    structure: Structure
    unknowns: tuple[tuple[str, ...], ...]
    """Names of the unknowns of each record."""
    state_deviation: float = STATE_DEVIATION
    """Prior standard deviation of the records' unknowns, relative to the operating point."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
        return self.structure.free

    @cached_property
    def free(self) -> dict[str, tuple[float, float]]:
        """Free parameters with their bounds."""
        return {one.name: (one.lower, one.upper) for one in self.parameters}

    @cached_property
    def given(self) -> dict[str, float]:
        """Parameters that are not searched."""
        return {one.name: one.start for one in self.structure.parameters if one.fixed}

    @property
    def records(self) -> int:
        """Number of records."""
        return len(self.unknowns)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.free)

    @cached_property
    def size(self) -> int:
        """Length of a vector."""
        return len(self.free) + sum(map(len, self.unknowns))

    def place(self, name: str) -> int:
        """Index of a parameter in a vector."""
        return self.names.index(name)

    def states(self, record: int) -> slice:
        """Slice of a record's unknowns in a vector."""
        first = len(self.free) + sum(map(len, self.unknowns[:record]))
        return slice(first, first + len(self.unknowns[record]))

    @cached_property
    def logarithmic(self) -> frozenset[str]:
        """Parameters that are searched as logarithms."""
        return frozenset(one.name for one in self.parameters if one.logarithmic)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of a vector."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for place, (name, ends) in enumerate(self.free.items()):
            low[place], high[place] = np.log(ends) if name in self.logarithmic else ends
        return low, high

    def values(self, vector: Array) -> dict[str, float]:
        """Return the parameters in their units, given and tied ones included."""
        found = dict(self.given)
        for name, x in zip(self.names, vector.tolist(), strict=False):
            low, high = self.free[name]
            # exp(log(x)) may exceed a bound by rounding.
            found[name] = min(max(math.exp(x), low), high) if name in self.logarithmic else x
        return self.structure.complete(found) if self._tied else found

    @cached_property
    def _tied(self) -> bool:
        return bool(self.structure.ties)

    def states_at(self, vector: Array) -> list[dict[str, float]]:
        """Return each record's unknowns by name."""
        return [
            dict(zip(names, vector[self.states(record)].tolist(), strict=True))
            for record, names in enumerate(self.unknowns)
        ]

    def vector(self, values: Mapping[str, float], states: Sequence[Mapping[str, float]] = ()) -> Array:
        """Return the vector for values within the bounds; unknowns of records are zero unless given."""
        vector = np.zeros(self.size)
        for place, name in enumerate(self.names):
            value = values[name]
            vector[place] = np.log(max(value, self.free[name][0])) if name in self.logarithmic else value
        for record, row in enumerate(states):
            vector[self.states(record)] = [row.get(name, 0.0) for name in self.unknowns[record]]
        return np.clip(vector, *self.bounds)

    def slopes(self, values: Mapping[str, float]) -> dict[str, dict[int, float]]:
        """Derivatives of the free parameters by entries of a vector."""
        return {
            name: {place: values[name] if name in self.logarithmic else 1.0}
            for place, name in enumerate(self.names)
        }

    def gradient(self, figure: Figure, vector: Array) -> Array:
        """Derivative of a figure by a vector, tied parameters included, shape (P,)."""
        low, high = self.bounds
        found = np.zeros(self.size)
        if isinstance(figure, Itself) and figure.name in self.free and not self._tied:
            place = self.place(figure.name)
            found[place] = figure(self.values(vector)) if figure.name in self.logarithmic else 1.0
            return found
        for place in range(len(self.free)):
            step = SMALL * max(1.0, abs(vector[place]))
            up, down = vector.copy(), vector.copy()
            up[place] = min(vector[place] + step, high[place])
            down[place] = max(vector[place] - step, low[place])
            found[place] = (figure(self.values(up)) - figure(self.values(down))) / (up[place] - down[place])
        return found

    def jacobian(self, values: Mapping[str, float]) -> Array:
        """Derivatives of the free parameters by their entries of a vector, (W, W)."""
        return np.diag([values[name] if name in self.logarithmic else 1.0 for name in self.names])
