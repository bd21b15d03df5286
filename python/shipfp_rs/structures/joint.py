"""A joint structure for several trials with shared and individual parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ties import Behind
from shipfp_rs.support.arrays import Array, Names, Values


@dataclass(frozen=True)
class PartEquations(Behind):
    """Equations of a single trial under the joint parameter names; other trials' parameters have no effect."""

    names: Mapping[str, str]
    """Joint names to the names in the equations."""

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
    """Equations of each trial by name."""

    parts: Mapping[str, PartEquations]

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states of any trial."""
        return next(iter(self.parts.values())).states

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Unknowns of an experiment in which the outputs are linear."""
        return next(iter(self.parts.values())).linear_in

    def stable(self, values: Values) -> bool:
        """Whether every trial's loop is stable, where known."""
        return all(part.stable(values) for part in self.parts.values())

    def part(self, name: str) -> PartEquations:
        """Return the equations of a trial.

        Raises
        ------
        InputError
            For an unknown name.
        """
        if name not in self.parts:
            raise InputError(
                f"joint structure: no part for {name!r}, expected one of {', '.join(self.parts)}"
            )
        return self.parts[name]

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs of an experiment with the name of a trial, shape (O, N)."""
        return self.part(experiment.name).simulate(values, experiment)

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        return self.part(experiment.name).sensitivities(values, experiment, names)

    def response(self, values: Values, frequency_hz: Array, names: Names) -> NoReturn:
        """Refuse, since a response has no trial without a name."""
        raise InputError("joint structure: a response is one part's; give structure.part(name)")
