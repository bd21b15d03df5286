"""Conversion of a structure's parameters to kernel parameters of the ship's equations of speed and governor, per trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shipfp_rs import _core
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import CommandedEquations, ShipEquations
from shipfp_rs.structures.state_space import LinearEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import Behind, PartEquations
from shipfp_rs.support.arrays import Array, ComplexArray, Values

GAINS = ("K_p", "K_i", "K_d")
KNOWN = {*_core.EQUATION_PARAMETERS, *GAINS}
"""Parameters of the two equations, and the gains that are not products with v."""


@dataclass(frozen=True)
class TwoEquations:
    """The ship of a trial: kernel parameters as functions of the searched parameters.

    Parameters
    ----------
    names
        Names of the searched parameters.
    layers
        Ties and joint names that convert the searched parameters to the ship's parameters, outermost first.
    equations, own
        Equations of the ship, and the names of their parameters.
    """

    names: tuple[str, ...]
    layers: tuple[Behind, ...]
    equations: LinearEquations | ShipEquations
    own: frozenset[str]

    @classmethod
    def of(cls, structure: Structure, names: Sequence[str]) -> TwoEquations | None:
        """Return the equations of a single trial's structure; None if it has an element that the two equations lack."""
        equations: Equations = structure.equations
        layers: list[Behind] = []
        own = set(structure.names)
        while isinstance(equations, Behind):
            if isinstance(equations, PartEquations):
                own = set(equations.names.values())
            layers.append(equations)
            equations = equations.equations
        if not isinstance(equations, LinearEquations | ShipEquations):
            return None
        outputs = set(equations.outputs)
        exact = isinstance(equations, ShipEquations) and "T_s" in own and not equations.mean_sampling
        if exact or (isinstance(equations, ShipEquations) and equations.envelope):
            return None
        twists = "tau_twist" in own and "dM" not in outputs
        if twists or "dn" not in outputs or outputs - set(_core.EQUATION_OUTPUTS) or own - KNOWN:
            return None
        return cls(tuple(names), tuple(layers), equations, frozenset(own))

    @property
    def gauge(self) -> bool:
        """Whether the torque is measured between the inertias."""
        return self.equations.gauge

    @property
    def behind_twist(self) -> bool:
        """Whether the speed is measured on the propeller's side of a torsionally flexible shaft."""
        return (
            isinstance(self.equations, ShipEquations)
            and self.equations.propeller_speed
            and "tau_twist" in self.own
        )

    @property
    def is_linear(self) -> bool:
        """Whether the load torque is a linear function of the speed."""
        return isinstance(self.equations, LinearEquations)

    @property
    def open_loop(self) -> bool:
        """Whether the input is a command instead of a governor's set point."""
        return isinstance(self.equations, CommandedEquations)

    def values(self, values: Values) -> dict[str, float]:
        """Return the kernel's parameters for a structure's values."""
        found = self._own(values)
        for gain in GAINS:
            if gain in found:
                found[f"v{gain}"] = found.pop(gain) * found.get("v", 1.0)
        return found

    def _own(self, values: Values) -> dict[str, float]:
        found = dict(values)
        for layer in self.layers:
            found = layer.own_values(found)
        return found

    @cached_property
    def _chain(self) -> tuple[list[str], Array]:
        """The ship's parameters that depend on the searched parameters, and their derivatives, shape (W, dependent)."""
        names, found = list(self.names), np.eye(len(self.names))
        for layer in self.layers:
            names, link = layer.chain(names)
            found = found @ link
        return names, found

    @cached_property
    def moved(self) -> tuple[str, ...]:
        """Names of the kernel parameters that depend on the searched parameters, in the order of `slopes`."""
        own = self._chain[0]
        gains = [gain for gain in GAINS if gain in self.own] if "v" in own else []
        found = [f"v{name}" if name in GAINS else name for name in own]
        return tuple(dict.fromkeys([*found, *(f"v{gain}" for gain in gains)]))

    def slopes(self, values: Values) -> Array:
        """Derivatives of the kernel's parameters `moved` with respect to the searched parameters, shape (m, W)."""
        own, chain = self._chain
        known, place = self._own(values), {name: row for row, name in enumerate(self.moved)}
        link = np.zeros((len(place), len(own)))
        v = known.get("v", 1.0)
        for column, name in enumerate(own):
            if name in GAINS:
                link[place[f"v{name}"], column] = v
                continue
            link[place[name], column] = 1.0
            if name == "v":
                for gain in GAINS:
                    if gain in known and f"v{gain}" in place:
                        link[place[f"v{gain}"], column] = known[gain]
        return np.asarray(link @ chain.T)

    def response(self, values: Values, frequency_hz: Array) -> ComplexArray:
        """Frequency response (O, F) of the outputs to the ship's input, for a structure's values."""
        return self.equations.response(self._own(values), frequency_hz, ())[0]
