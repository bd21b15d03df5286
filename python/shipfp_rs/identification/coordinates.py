"""Search coordinates: searched parameters and the unknowns of the records, as one bounded vector.

Without a given structure, the parameters are searched as ratios to the inertia's time constant tau_n. Data determine these
ratios far better than the parameters. The ship's equations, divided by tau_n, are linear in 1 / tau_n, (p - g) / tau_n,
vK_p / tau_n and vK_i / tau_n, except for N^p (eq. 3.31). A valley of the deviance along which only the curvature of N^p
changes is a straight line in these coordinates. A given structure may fix or tie any parameter, so its parameters
are searched without a transformation, or as logarithms if the bounds are wide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np

from shipfp_rs.structures.dual import Parameters
from shipfp_rs.structures.elements import ABSENT, QUANTITIES
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import Ties, followed
from shipfp_rs.structures.transfer import loop_parameters
from shipfp_rs.support.arrays import Array

Figure = Callable[[Mapping[str, float]], float]
"""A quantity as a function of the parameters."""
SMALL = 1e-6
"""Relative step of a difference quotient."""
STATE_REACH, STATE_DEVIATION = 0.3, 0.1
"""Bound and prior standard deviation of the unknowns of a ship's records, relative to the operating point."""
WIDE = 1.0
"""Prior standard deviation of a structure's initial states and offsets, relative to the operating point; it is so wide that
it has no effect."""
LOGARITHMS = frozenset(one.name for one in QUANTITIES.values() if one.scale == "log")
"""Parameters of a ship that are searched as logarithms."""
SHARE_BOUNDS = (1e-4, 1.0)
"""Bounds of (T_s / (2 T_d))^2, which is searched instead of the sampling period T_s, whose effect is quadratic."""
GAINS = ("vK_p", "vK_i")
"""Gains that are searched as a ratio to tau_n, without a logarithm. Along a valley of the deviance (p - g) / tau_n and
vK_i / tau_n rise in proportion; a logarithm would bend that valley."""
RATIO_BOUNDS = {"g": (-50.0, 500.0), **dict.fromkeys(GAINS, (1e-5, 5e3))}
"""Bounds of the ratios in a search. They are wide, and only the intervals are cut at the bounds of the parameters."""
LEAST = 1e-9
"""Least argument of a logarithm, for a parameter whose lower bound is zero."""
MOST_BEHIND, WALL, WALL_S = 0.95, 0.01, 1e-3
"""Largest share of the inertia behind a gauge; widths of the penalties above it and above the longest period T_s [s]."""


WITHOUT_EFFECT = {
    **dict.fromkeys(ABSENT, 0.0),
    "zeta_twist": QUANTITIES["zeta_twist"].start,
    "T_M": 0.0,
    "T_B": 0.0,
}
"""Values at which the parameters of elements have no effect, for those that a search vector lacks."""


@dataclass(frozen=True)
class Itself:
    """The value of a parameter, as a `Figure`."""

    name: str

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return its value."""
        return values[self.name]


@dataclass(frozen=True)
class Coordinates:
    """Search vectors: free parameters within bounds, followed by the unknowns of the records."""

    free: Mapping[str, tuple[float, float]]  # (lower, upper) bound by name, in the parameter's unit
    given: Mapping[str, float]  # values of the parameters that are not searched
    unknowns: tuple[tuple[str, ...], ...]  # names of the unknowns of each record
    logarithms: frozenset[str] = LOGARITHMS  # parameters that are searched as logarithms
    # Gains and slopes are searched as ratios to tau_n, and a sampling period as a share of T_d.
    in_ratios: bool = True
    ties: Ties = field(default_factory=dict)  # parameters that follow from others
    reach: float = STATE_REACH  # bound of the records' unknowns, relative to the operating point
    state_deviation: float = STATE_DEVIATION  # prior standard deviation of the records' unknowns, likewise

    @classmethod
    def of(cls, structure: Structure, unknowns: Sequence[tuple[str, ...]], deviation: float = WIDE) -> Self:
        """Return the coordinates of a given structure."""
        return cls(
            free={one.name: (one.lower, one.upper) for one in structure.free},
            given={one.name: one.start for one in structure.parameters if one.fixed},
            unknowns=tuple(unknowns),
            logarithms=frozenset(one.name for one in structure.free if one.logarithmic),
            in_ratios=False,
            ties=structure.ties,
            reach=math.inf,
            state_deviation=deviation,
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.free)

    @cached_property
    def size(self) -> int:
        """Length of a search vector."""
        return len(self.free) + sum(map(len, self.unknowns))

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.free)}

    @cached_property
    def _ratios(self) -> tuple[str, ...]:
        return tuple(name for name in GAINS if name in self.free) if self.in_ratios else ()

    @cached_property
    def _slope_is_ratio(self) -> bool:
        return self.in_ratios and "g" in self.free

    @cached_property
    def _period_is_share(self) -> bool:
        return self.in_ratios and "T_s" in self.free

    @cached_property
    def _from_entry(self) -> tuple[Callable[[float], float], ...]:
        """Functions from entries of a search vector to parameters, or to ratios where these are searched."""
        return tuple(math.exp if name in self.logarithms else float for name in self.names)

    def place(self, name: str) -> int:
        """Index of a parameter in a search vector."""
        return self._index[name]

    def states(self, record: int) -> slice:
        """Slice of a record's unknowns in a search vector."""
        first = len(self.free) + sum(map(len, self.unknowns[:record]))
        return slice(first, first + len(self.unknowns[record]))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of a search vector."""
        rows = [self._entry_bounds(name, *ends) for name, ends in self.free.items()]
        rows += [(-self.reach, self.reach)] * (self.size - len(self.free))
        low, high = np.array(rows, dtype=float).reshape(-1, 2).T
        return low, high

    def _entry_bounds(self, name: str, low: float, high: float) -> tuple[float, float]:
        if self.in_ratios and name in RATIO_BOUNDS:
            return RATIO_BOUNDS[name]
        if name == "T_s" and self.in_ratios:
            return SHARE_BOUNDS
        if name in self.logarithms:
            return math.log(low if low > 0.0 else LEAST), math.log(high)
        return low, high

    def values(self, vector: Array) -> dict[str, float]:
        """Return the parameters in their units, given and tied ones included."""
        values = dict(self.given)
        for name, from_entry, x in zip(self.names, self._from_entry, vector.tolist(), strict=False):
            values[name] = from_entry(x)
        for name in self.logarithms & self.free.keys():
            low, high = self.free[name]
            values[name] = min(max(values[name], low), high)  # exp(log(x)) may exceed a bound by rounding
        for name in self._ratios:
            values[name] *= values["tau_n"]
        if self._period_is_share:
            values["T_s"] = 2.0 * math.sqrt(values["T_s"]) * values["T_d"]
        if self._slope_is_ratio:
            values["g"] = values["p"] - values["g"] * values["tau_n"]
        return self._completed(values)

    def _completed(self, values: dict[str, float]) -> dict[str, float]:
        """Add tied parameters, and the gains K = vK / v where a ship's rack torque v is searched."""
        if self.in_ratios and "v" in self.free:
            values |= {gain[1:]: values[gain] / values["v"] for gain in GAINS}
        return followed(values, self.ties) if self.ties else values

    def states_at(self, vector: Array) -> list[dict[str, float]]:
        """Return each record's unknowns by name."""
        return [
            dict(zip(names, vector[self.states(record)].tolist(), strict=True))
            for record, names in enumerate(self.unknowns)
        ]

    def vector(self, values: Mapping[str, float], states: Sequence[Mapping[str, float]] = ()) -> Array:
        """Return the search vector, clipped to the bounds; missing elements have no effect, missing unknowns are zero."""
        known = {**WITHOUT_EFFECT, **self.given, **values}
        vector = np.zeros(self.size)
        for index, name in enumerate(self.names):
            value = known[name]
            if name == "g" and self.in_ratios:
                vector[index] = (known["p"] - value) / known["tau_n"]
            elif name in self.logarithms:
                vector[index] = math.log(max(value, self.free[name][0] or LEAST))
            elif name in self._ratios:
                vector[index] = value / known["tau_n"]
            elif name == "T_s" and self.in_ratios:
                vector[index] = min(0.25 * (value / max(known["T_d"], LEAST)) ** 2, 1.0)
            else:
                vector[index] = value
        for record, row in enumerate(states):
            vector[self.states(record)] = [row.get(name, 0.0) for name in self.unknowns[record]]
        return np.clip(vector, *self.bounds)

    def jacobian(self, values: Mapping[str, float]) -> Array:
        """Derivatives of the free parameters by their entries of a search vector, (W, W)."""
        own = [
            values[name] if way is math.exp else 1.0
            for name, way in zip(self.names, self._from_entry, strict=True)
        ]
        found, index = np.zeros((len(own), len(own))), self._index
        found.flat[:: len(own) + 1] = own
        tau, g = index.get("tau_n"), index.get("g")
        for name in self._ratios:
            found[index[name], index[name]] = values["tau_n"]
            if tau is not None:
                found[index[name], tau] = values[name]
        if self._period_is_share:
            period, dead = index["T_s"], max(values["T_d"], LEAST)
            found[period, period] = 2.0 * dead**2 / max(values["T_s"], 2.0 * LEAST * dead)
            if "T_d" in index:
                found[period, index["T_d"]] = values["T_s"] / dead
        if g is not None and self.in_ratios:
            found[g, g] = -values["tau_n"]
            if tau is not None:
                found[g, tau] = values["g"] - values["p"]
            if "p" in index:
                found[g, index["p"]] = 1.0
        return found

    def gradient(self, figure: Figure, vector: Array) -> Array:
        """Derivative of a figure by the search vector, tied parameters included, shape (P,)."""
        values, slopes = self.values(vector), np.zeros(len(self.names))
        found = np.zeros(self.size)
        if isinstance(figure, Itself) and figure.name in self.free:
            found[: len(slopes)] = self.jacobian(values)[self.place(figure.name)]
            return found
        moved = dict(values)
        for index, name in enumerate(self.names):
            value = values[name]
            step = SMALL * max(1.0, abs(value))
            moved[name] = value + step
            up = figure(self._completed(moved))
            moved[name] = value - step
            down = figure(self._completed(moved))
            moved[name] = value
            if up != down:
                slopes[index] = (up - down) / (2.0 * step)
        found[: len(slopes)] = slopes @ self.jacobian(values)
        return found


Slopes = Mapping[str, float]
COMBINED: Mapping[str, Callable[[Mapping[str, float]], tuple[float, Slopes]]] = {
    "tau_prop/tau_n": lambda q: (
        q["tau_prop"] / q["tau_n"],
        {"tau_prop": 1.0 / q["tau_n"], "tau_n": -q["tau_prop"] / q["tau_n"] ** 2},
    ),
    "tau_n-tau_prop": lambda q: (q["tau_n"] - q["tau_prop"], {"tau_n": 1.0, "tau_prop": -1.0}),
}
"""Combinations of parameters that have priors or limits: value, and derivatives by the parameters."""


def row_of(c: Coordinates, name: str, values: Mapping[str, float], by: Array) -> Array:
    """Return value and derivatives (1 + P,) of a parameter or combination; `by` is the Jacobian of the coordinates."""
    value, slopes = COMBINED[name](values) if name in COMBINED else (values[name], {name: 1.0})
    row = np.zeros(c.size + 1)
    row[0] = value
    for one, slope in slopes.items():
        if one in c.free:
            row[1 : 1 + len(by)] += slope * by[c.place(one)]
    return row


def prior_row(
    c: Coordinates, name: str, prior: tuple[float, float], values: Mapping[str, float], by: Array
) -> Array:
    """Return residual and derivatives (1 + P,) of a prior (mean, standard deviation), over the standard deviation."""
    row = row_of(c, name, values, by) / prior[1]
    row[0] = prior[0] / prior[1] - row[0]
    return row


def wall_rows(c: Coordinates, values: Mapping[str, float], by: Array) -> list[Array]:
    """Return the rows of active penalties: on a large inertia behind a gauge, and on a sampling period beyond its bound."""
    rows, share = [], "tau_prop/tau_n"
    if "tau_prop" in c.free and "tau_n" in values and COMBINED[share](values)[0] > MOST_BEHIND:
        rows.append(prior_row(c, share, (MOST_BEHIND, WALL), values, by))
    if c.in_ratios and "T_s" in c.free and values["T_s"] > (longest := c.free["T_s"][1]):
        rows.append(prior_row(c, "T_s", (longest, WALL_S), values, by))
    return rows


def loop_of(values: Parameters) -> dict[str, Any]:
    """Return the parameters of transfer functions from those of the two equations."""
    # In transfer functions p includes the damping, gains exclude v where it is known, and the dead time excludes half of a
    # sampling period.
    found = loop_parameters(values, mean_sampling=True)
    for gain in ("vK_p", "vK_i", "vK_d"):
        if "v" in found and gain in found:
            found[gain[1:]] = found.pop(gain) / found["v"]
    return found
