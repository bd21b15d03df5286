"""Coordinates in which a ship is searched: ratios to the inertia's time constant, which data tell far better than parts.

Divided by tau_n the ship's equations are linear in 1 / tau_n, (p - g) / tau_n, vK_p / tau_n and vK_i / tau_n but for N^p
(eq. 3.31). A valley along which only the curvature of N^p changes is a straight line here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shipfp_rs import _core
from shipfp_rs.structures.ship import INDEX, KERNEL
from shipfp_rs.support.arrays import Array

STATES = {
    "initial dn": "initial_N",
    "initial fuel": "initial_F",
    "initial sum": "initial_E",
    "set point offset": "u_0",
    "torque scale": "s_M",
}
"""Unknowns of each record, and the kernel's names. The operating point is a mean over a minute of moving water, right to
parts in a thousand: set point and speed differ by an offset, the torque is relative to another mean than the load's."""
STATE_REACH = 0.3
"""How far a record may begin from the operating point, and its set point be read wrong, over the operating point's."""
LOGARITHMS = ("tau_n", "vK_p", "vK_i", "rate", "tau_twist", "v", "M_soft")
"""Parameters that are searched by their logarithm."""
SQUARES = ("hold",)
"""Parameters that act by their square, and are searched by it: about zero they would have no slope."""
RATIOS = ("vK_p", "vK_i")
"""Parameters that are searched over tau_n."""
SMALLEST = 1e-3
"""Least of what has a logarithm and a lower bound of none."""


STATE_DEVIATION = 0.1
"""Of a record's states, over the operating point: where a quick loop has forgotten them, nothing else holds them."""


@dataclass(frozen=True)
class Coordinates:
    """Free parameters of a ship between bounds, as a vector, with the states of its records behind them.

    Parameters
    ----------
    free
        Name to (lower, upper) bound, in the parameters' own units.
    given
        Name to value of what is not searched.
    records
        Number of records, each with states of its own.
    """

    free: Mapping[str, tuple[float, float]]
    given: Mapping[str, float]
    records: int

    @property
    def state_deviation(self) -> float:
        """Prior deviation of the records' states, over the operating point."""
        return STATE_DEVIATION

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.free)

    @cached_property
    def size(self) -> int:
        """Length of a vector."""
        return len(self.free) + self.records * len(STATES)

    def place(self, name: str) -> int:
        """Place of a parameter in a vector."""
        return self.names.index(name)

    def states(self, record: int) -> slice:
        """Places of a record's states."""
        first = len(self.free) + record * len(STATES)
        return slice(first, first + len(STATES))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of a vector; what is searched as a ratio has wide ones, its own are looked after by the intervals."""
        rows = [self._bounds(name, *self.free[name]) for name in self.free]
        rows += [(-STATE_REACH, STATE_REACH)] * (self.records * len(STATES))
        low, high = np.array(rows).T
        return low, high

    def _bounds(self, name: str, low: float, high: float) -> tuple[float, float]:
        if name == "g":
            return (-50.0, 500.0)
        if name in RATIOS:
            return (np.log(SMALLEST), np.log(5e3))
        if name in LOGARITHMS:
            return float(np.log(max(low, 1e-9))), float(np.log(high))
        return (low**2, high**2) if name in SQUARES else (low, high)

    def values(self, vector: Array) -> dict[str, float]:
        """Return the parameters in their own units, those given included."""
        values = dict(self.given)
        for name, x in zip(self.names, vector, strict=False):
            values[name] = _own(name, x)
        tau = values["tau_n"]
        for name in RATIOS:
            if name in self.free:
                values[name] *= tau
        if "g" in self.free:
            values["g"] = values["p"] - values["g"] * tau
        if "v" in self.free:
            values |= {gain[1:]: values[gain] / values["v"] for gain in RATIOS}
        return values

    def vector(self, values: Mapping[str, float], states: Sequence[Array] = ()) -> Array:
        """Return the vector of values within the bounds; states are zero unless given."""
        known = {**self.given, **values}
        tau = known["tau_n"]
        vector = np.zeros(self.size)
        for place, name in enumerate(self.names):
            value = known[name]
            if name == "g":
                vector[place] = (known["p"] - value) / tau
            elif name in LOGARITHMS:
                vector[place] = np.log(max(value / tau if name in RATIOS else value, 1e-9))
            else:
                vector[place] = value**2 if name in SQUARES else value
        for record, row in enumerate(states):
            vector[self.states(record)] = row
        return np.clip(vector, *self.bounds)

    def slopes(self, values: Mapping[str, float]) -> dict[str, dict[int, float]]:
        """Derivatives of the parameters by the places of a vector: {parameter: {place: slope}}."""
        tau, found = values["tau_n"], {}
        by_tau = {self.place("tau_n"): 1.0} if "tau_n" in self.free else {}
        for place, name in enumerate(self.names):
            own = values[name] if name in LOGARITHMS else 0.5 / values[name] if name in SQUARES else 1.0
            found[name] = {place: own}
            if name in RATIOS:
                found[name] |= {at: values[name] * one for at, one in by_tau.items()}
            if name == "g":
                slope = (values["p"] - values["g"]) / tau
                found[name] = {place: -tau} | {at: -slope * tau * one for at, one in by_tau.items()}
                if "p" in self.free:
                    found[name][self.place("p")] = 1.0
        return found

    def kernel(self, values: Mapping[str, float], states: Array) -> Array:
        """Return the kernel's parameters for a record's states."""
        vector = np.array(_core.SHIP_OFF)
        v = values.get("v", 1.0)
        vector[INDEX["v"]] = v
        for name, value in values.items():
            if name not in ("v", "K_p", "K_i"):
                vector[INDEX[KERNEL.get(name, name)]] = value / v if name.startswith("vK_") else value
        if "rate" in values:
            vector[INDEX["rate_down"]] = values["rate"]
        if vector[INDEX["tau_twist"]] > 0.0:
            vector[INDEX["tau_prop"]] = min(vector[INDEX["tau_prop"]], 0.98 * values["tau_n"])
        for (name, kernel), value in zip(STATES.items(), states, strict=True):
            vector[INDEX[kernel]] = value + (name in ("initial dn", "torque scale"))
        return vector


def _own(name: str, x: float) -> float:
    """A parameter in its own unit, of its entry in a vector."""
    return float(np.exp(x) if name in LOGARITHMS else np.sqrt(x) if name in SQUARES else x)
