"""Parameters that follow another one along a straight line, and what that makes of values and derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values


@dataclass(frozen=True)
class Tie:
    """A parameter's value as factor times that of parameter `to`, plus an offset in its own unit."""

    to: str
    factor: float
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        """Return what the parameter is where the other one has this value."""
        return self.factor * value + self.offset

    def inverse(self, value: float) -> float:
        """Return what the other one is where the parameter has this value."""
        return (value - self.offset) / self.factor

    def __str__(self) -> str:
        return f"{self.factor:g} {self.to}" + (f" {self.offset:+g}" if self.offset else "")


Ties = Mapping[str, Tie]


def resolved(ties: Ties) -> dict[str, Tie]:
    """Lead every tie back to a parameter that is tied to none.

    Raises
    ------
    InputError
        For ties in a circle.
    """
    found = {}
    for name, tie in ties.items():
        path = [name]
        while tie.to in ties:
            path.append(tie.to)
            if tie.to in path[:-1]:
                raise InputError(
                    f"tied: {' to '.join(path)} in a circle, expected one of them to be tied to none"
                )
            following = ties[tie.to]
            tie = Tie(following.to, tie.factor * following.factor, tie(following.offset))
        found[name] = tie
    return found


def followed(values: Values, ties: Ties) -> dict[str, float]:
    """Return values in which the tied parameters have what resolved ties make of the others."""
    return {**values, **{name: tie(values[tie.to]) for name, tie in ties.items() if tie.to in values}}


def declared(structure: Mapping[str, Any]) -> dict[str, Tie]:
    """Return the resolved ties of a structure from its JSON form."""
    rows = structure.get("parameters", {})
    return resolved({name: Tie(**row["tied"]) for name, row in rows.items() if row.get("tied")})


def bare(equations: Equations) -> Equations:
    """Return equations without ties."""
    return equations.equations if isinstance(equations, TiedEquations) else equations


def tied(equations: Equations, ties: Ties) -> Equations:
    """Return the same equations with these ties in place of any before."""
    return TiedEquations(bare(equations), ties) if ties else bare(equations)


@dataclass(frozen=True)
class Behind(Equations):
    """Equations whose parameters are functions, straight lines, of those that are asked for."""

    equations: Equations

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states of the equations."""
        return self.equations.states

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Unknowns of an experiment in which the outputs are linear."""
        return self.equations.linear_in

    @property
    def own_offsets(self) -> bool:
        """Whether the equations' states hold the errors of the operating point."""
        return self.equations.own_offsets

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable, as far as the equations can tell."""
        return self.equations.stable(self.own_values(values))

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.equations.simulate(self.own_values(values), experiment)

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        moved, chain = self.chain(names)
        simulated, slopes = self.equations.sensitivities(self.own_values(values), experiment, moved)
        return simulated, np.tensordot(chain, slopes.reshape(len(moved), *simulated.shape), axes=1)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F)."""
        moved, chain = self.chain(names)
        response, slopes = self.equations.response(self.own_values(values), frequency_hz, moved)
        return response, np.tensordot(chain, slopes.reshape(len(moved), *response.shape), axes=1)

    def own_values(self, values: Values) -> dict[str, float]:
        """Return the values of the equations' own parameters."""
        raise NotImplementedError

    def chain(self, names: Names) -> tuple[list[str], Array]:
        """Return all of the equations' own that moves with `names`, and by how much, shape (W, all)."""
        raise NotImplementedError


@dataclass(frozen=True)
class TiedEquations(Behind):
    """Equations some of whose parameters follow others: a derivative is that along with all that follow."""

    ties: Ties
    """Resolved."""

    def own_values(self, values: Values) -> dict[str, float]:
        """Return the values of the equations' own parameters."""
        return followed(values, self.ties)

    def chain(self, names: Names) -> tuple[list[str], Array]:
        """Return all of the equations' own that moves with `names`, and by how much, shape (W, all)."""
        moved = [*names, *(name for name, tie in self.ties.items() if tie.to in names and name not in names)]
        chain = np.eye(len(names), len(moved))
        for name in moved[len(names) :]:
            tie = self.ties[name]
            chain[names.index(tie.to), moved.index(name)] = tie.factor
        return moved, chain
