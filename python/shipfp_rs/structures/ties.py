"""Functions of parameters: ties, combinations that data may determine, and parameters that several trials share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

COMBINATIONS: Mapping[str, tuple[str, Callable[[Mapping[str, float]], float]]] = {
    "vK_p": ("-", lambda q: q["v"] * q["K_p"]),
    "vK_i": ("1/s", lambda q: q["v"] * q["K_i"]),
    "K_p/K_i": ("s", lambda q: q["K_p"] / q["K_i"]),
    "p-g": ("-", lambda q: q["p"] - q["g"]),
    "(p-g)/tau_n": ("1/s", lambda q: (q["p"] - q["g"]) / q["tau_n"]),
    "vK_p/tau_n": ("1/s", lambda q: _product(q, "p") / q["tau_n"]),
    "vK_i/tau_n": ("1/s2", lambda q: _product(q, "i") / q["tau_n"]),
    "tau_prop/tau_n": ("-", lambda q: q["tau_prop"] / q["tau_n"]),
    "(p-g)/(vK_i)": ("s", lambda q: (q["p"] - q["g"]) / _product(q, "i")),
    "(p-g)/(vK_i)+T_set-T_f": (
        "s",
        lambda q: (q["p"] - q["g"]) / _product(q, "i") + q["T_set"] - q.get("T_f", 0.0),
    ),
}
"""Unit and value of each tried combination of the linear structure's parameters. A KeyError means not applicable."""


def _product(values: Values, letter: str) -> float:
    name = f"vK_{letter}"
    return values[name] if name in values else values["v"] * values[f"K_{letter}"]


def true_values(linear: Mapping[str, float]) -> dict[str, float]:
    """Return the linear parameters and all applicable combinations of them."""
    values = dict(linear)
    for name, (_, combine) in COMBINATIONS.items():
        values.setdefault(name, combine(linear))
    return values


@dataclass(frozen=True)
class Tie:
    """Relation of a tied parameter to the parameter `to`: value = factor * value of `to` + offset."""

    to: str
    factor: float
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        """Return the tied parameter's value for a value of `to`."""
        return self.factor * value + self.offset

    def inverse(self, value: float) -> float:
        """Return the value of `to` for a value of the tied parameter."""
        return (value - self.offset) / self.factor

    def __str__(self) -> str:
        return f"{self.factor:g} {self.to}" + (f" {self.offset:+g}" if self.offset else "")


Ties = Mapping[str, Tie]


def resolved(ties: Ties) -> dict[str, Tie]:
    """Resolve chains of ties to parameters that are not tied; `InputError` for circular ties."""
    found = {}
    for name, tie in ties.items():
        path = [name]
        while tie.to in ties:
            path.append(tie.to)
            if tie.to in path[:-1]:
                raise InputError(
                    f"tied: {' to '.join(path)} in a circle, expected at least one of them without a tie"
                )
            following = ties[tie.to]
            tie = Tie(following.to, tie.factor * following.factor, tie(following.offset))
        found[name] = tie
    return found


def followed(values: Values, ties: Ties) -> dict[str, float]:
    """Return values by name, with the tied parameters computed by resolved ties."""
    return {**values, **{name: tie(values[tie.to]) for name, tie in ties.items() if tie.to in values}}


def declared(structure: Mapping[str, Any]) -> dict[str, Tie]:
    """Return the resolved ties of a structure from its JSON form."""
    rows = structure.get("parameters", {})
    return resolved({name: Tie(**row["tied"]) for name, row in rows.items() if row.get("tied")})


def bare(equations: Equations) -> Equations:
    """Return equations without ties."""
    return equations.equations if isinstance(equations, TiedEquations) else equations


def tied(equations: Equations, ties: Ties) -> Equations:
    """Return the equations with these ties; previous ties are replaced."""
    return TiedEquations(bare(equations), ties) if ties else bare(equations)


@dataclass(frozen=True)
class Behind(Equations):
    """Equations with parameters that are linear functions of the searched ones, for ties and joint structures."""

    equations: Equations

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states of the equations."""
        return self.equations.states

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Unknowns of an experiment on which the outputs depend linearly."""
        return self.equations.linear_in

    @property
    def own_offsets(self) -> bool:
        """Whether the states include errors of the operating point."""
        return self.equations.own_offsets

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable, where known."""
        return self.equations.stable(self.own_values(values))

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.equations.simulate(self.own_values(values), experiment)

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        moved, chain = self.chain(names)
        simulated, slopes = self.equations.sensitivities(self.own_values(values), experiment, moved)
        return simulated, np.tensordot(chain, slopes.reshape(len(moved), *simulated.shape), axes=1)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F)."""
        moved, chain = self.chain(names)
        response, slopes = self.equations.response(self.own_values(values), frequency_hz, moved)
        return response, np.tensordot(chain, slopes.reshape(len(moved), *response.shape), axes=1)

    def own_values(self, values: Values) -> dict[str, float]:
        """Return the values of the equations' parameters."""
        raise NotImplementedError

    def chain(self, names: Names) -> tuple[list[str], Array]:
        """Return the equations' parameters that depend on `names`, and their derivatives, shape (W, dependent)."""
        raise NotImplementedError


@dataclass(frozen=True)
class TiedEquations(Behind):
    """Equations with tied parameters; a derivative includes the effect of the parameters tied to it."""

    ties: Ties
    """Resolved ties."""

    def own_values(self, values: Values) -> dict[str, float]:
        """Return the values of the equations' parameters."""
        return followed(values, self.ties)

    def chain(self, names: Names) -> tuple[list[str], Array]:
        """Return the equations' parameters that depend on `names`, and their derivatives, shape (W, dependent)."""
        moved = [*names, *(name for name, tie in self.ties.items() if tie.to in names and name not in names)]
        chain = np.eye(len(names), len(moved))
        for name in moved[len(names) :]:
            tie = self.ties[name]
            chain[names.index(tie.to), moved.index(name)] = tie.factor
        return moved, chain


@dataclass(frozen=True)
class PartEquations(Behind):
    """Equations of one trial with the joint structure's parameter names; parameters of other trials have no effect."""

    names: Mapping[str, str]
    """Maps a parameter's name in the joint structure to its name in the equations."""

    def own_values(self, values: Values) -> dict[str, float]:
        """Return the values of the equations' parameters."""
        states = {name: value for name, value in values.items() if name in self.states}
        return states | {own: values[name] for name, own in self.names.items()}

    def chain(self, names: Names) -> tuple[list[str], Array]:
        """Return the equations' parameters that depend on `names`, and their derivatives, shape (W, dependent)."""
        own = [self.names.get(name, name) for name in names]
        here = [name in self.names or name in self.states for name in names]
        return [name for name, is_here in zip(own, here, strict=True) if is_here], np.eye(len(names))[:, here]


@dataclass(frozen=True)
class JointEquations(Equations):
    """Equations of a joint structure: those of each trial, by the trial's name."""

    parts: Mapping[str, PartEquations]

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states, equal for all trials."""
        return next(iter(self.parts.values())).states

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Unknowns of an experiment on which the outputs depend linearly."""
        return next(iter(self.parts.values())).linear_in

    def stable(self, values: Values) -> bool:
        """Whether every trial's loop is stable, where known."""
        return all(part.stable(values) for part in self.parts.values())

    def part(self, name: str) -> PartEquations:
        """Return the equations of a trial; `InputError` for an unknown name."""
        if name not in self.parts:
            raise InputError(
                f"joint structure: no part for {name!r}, expected one of {', '.join(self.parts)}"
            )
        return self.parts[name]

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs of an experiment, shape (O, N); its name selects the trial."""
        return self.part(experiment.name).simulate(values, experiment)

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        return self.part(experiment.name).sensitivities(values, experiment, names)

    def response(self, values: Values, frequency_hz: Array, names: Names) -> NoReturn:
        """Raise `InputError`, since the trial of a frequency response without a name is unknown."""
        raise InputError("joint structure: has no single response; use structure.part(name)")
