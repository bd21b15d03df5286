"""Declaration of a structure: parameters, outputs and equations; copies with changed starts, bounds, priors and ties."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from shipfp_rs.errors import InputError, UnknownNameError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.names import plain_name
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.ties import Tie, bare, followed, resolved, tied
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, Values
from shipfp_rs.support.tables import shown


@dataclass(frozen=True)
class Declared(hints.Hinted):
    """A parametric model: parameters with unit, bounds and start; outputs; and equations."""

    name: str
    parameters: tuple[Parameter, ...]
    signals: Mapping[str, tuple[str, ...]]
    """Output names in order, each with the signals that may measure it, in order of preference."""
    equations: Equations
    settings: Mapping[str, Any]

    def part(self, name: str) -> Self:
        """Return the structure for data of this name: a joint structure's part for this trial, else the structure itself."""
        parts = bare(self.equations)
        if self.settings["kind"] != "joint":
            return self
        return replace(self, equations=tied(parts.part(name), self.ties))  # type: ignore[attr-defined]

    def __getitem__(self, name: str) -> Parameter:
        """Return a parameter by name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise UnknownNameError(
            f"structure {self.name!r} has no parameter {name!r}; it has {', '.join(self.names)}"
            f"{hints.nearest(name, self.names)}"
        )

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.signals)

    def signal_for(self, output: str, available: Container[str], data: str) -> str:
        """Return the first signal in `available` that measures an output; the error names the `data`."""
        for candidate in self.signals[output]:
            if candidate in available:
                return candidate
        expected = ", ".join(self.signals[output])
        raise InputError(f"{data!r}: no signal for output {output!r}, expected one of {expected}")

    def measured(self, experiment: Experiment) -> Array:
        """Return the measured outputs, normalised, shape (O, N)."""
        chosen = (self.signal_for(output, experiment.signals, experiment.name) for output in self.outputs)
        return np.array([experiment.normalised(name) for name in chosen])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Estimated parameters, including those with a prior.

        Their bounds are narrowed such that every parameter tied to them stays within its own bounds.
        """
        return tuple(
            self._within_ties(parameter)
            for parameter in self.parameters
            if not parameter.fixed and parameter.tied is None
        )

    @property
    def ties(self) -> dict[str, Tie]:
        """Ties by parameter; chains are resolved, so that each tie refers to a parameter that is not tied."""
        return resolved({p.name: p.tied for p in self.parameters if p.tied is not None})

    def complete(self, values: Values) -> dict[str, float]:
        """Return values by name with the tied parameters computed from the parameters they are tied to."""
        return followed(values, self.ties)

    def _within_ties(self, parameter: Parameter) -> Parameter:
        lower, upper = parameter.lower, parameter.upper
        for name, tie in self.ties.items():
            if tie.to == parameter.name:
                ends = sorted((tie.inverse(self[name].lower), tie.inverse(self[name].upper)))
                lower, upper = max(lower, ends[0]), min(upper, ends[1])
        narrowed = (lower, upper) != (parameter.lower, parameter.upper)
        return replace(parameter, lower=lower, upper=upper) if narrowed else parameter

    def __repr__(self) -> str:
        free = [parameter.name for parameter in self.free]
        names = ", ".join(free) if len(free) <= 12 else f"{', '.join(free[:10])} and {len(free) - 10} more"
        name = self.name if len(self.name) <= 60 else f"{self.name[:57]}..."
        return f"Structure({name!r}, free: {names}; outputs: {', '.join(self.outputs)})"

    def _repr_html_(self) -> str:
        return shown(
            f"Structure {self.name}",
            ["parameter", "name", "start", "from", "to", "unit", "status"],
            [
                [
                    one.name,
                    plain_name(one.name),
                    f"{one.start:.4g}",
                    *(["", ""] if one.fixed else [f"{one.lower:.4g}", f"{one.upper:.4g}"]),
                    one.unit,
                    _status(one),
                ]
                for one in self.parameters
            ],
            [f"Outputs: {', '.join(self.outputs)}"],
        )


def _status(parameter: Parameter) -> str:
    if parameter.tied is not None:
        return f"tied: {parameter.tied}"
    if parameter.prior is not None:
        return f"prior {parameter.prior[0]:.4g} ± {parameter.prior[1]:.4g}"
    return "fixed" if parameter.fixed else "free"


class Editable(Declared):
    """A parametric model with methods that return modified copies."""

    def _with(self, name: str, **changes: Any) -> Self:
        changed = replace(self[name], **changes)
        parameters = [changed if parameter.name == name else parameter for parameter in self.parameters]
        structure = replace(self, parameters=tuple(parameters))
        ties = structure.ties
        if not ties and not self.ties:
            return structure
        starts = structure.complete({parameter.name: parameter.start for parameter in parameters})
        for follower, tie in ties.items():
            declared = structure[follower]
            if not declared.lower <= starts[follower] <= declared.upper:
                raise InputError(
                    f"parameter {follower}: tied as {tie} it starts at {starts[follower]:g}, outside its bounds "
                    f"{declared.lower:g} to {declared.upper:g}; move the start of {tie.to} or widen the bounds first"
                )
        return replace(
            structure,
            parameters=tuple(replace(parameter, start=starts[parameter.name]) for parameter in parameters),
            equations=tied(self.equations, ties),
        )

    @checked
    def with_fixed(self, **values: float) -> Self:
        """Return a copy with parameters held at the given values."""
        structure = self
        for name, value in values.items():
            declared = structure[name]
            too_large = declared.unit == "s" and value > 10.0 * declared.upper
            if too_large or value < 0.0 <= declared.lower:
                unit = "" if declared.unit == "-" else f" {declared.unit}"
                hint = (
                    hints.likely(value, declared.lower, declared.upper, hints.TIME_S, "s")
                    if too_large
                    else ""
                )
                raise InputError(
                    f"parameter {name}: fixed at {value:g}{unit}, expected {declared.lower:g} to {declared.upper:g}{unit}"
                    f"{hint or '; widen its bounds first'}"
                )
            structure = structure._with(name, start=float(value), fixed=True, prior=None, tied=None)
        return structure

    @checked
    def with_prior(self, **priors: tuple[float, float]) -> Self:
        """Return a copy with Gaussian priors, each (mean, standard deviation)."""
        structure = self
        for name, (mean, std) in priors.items():
            structure = structure._with(
                name, start=float(mean), fixed=False, prior=(float(mean), float(std)), tied=None
            )
        return structure

    @checked
    def with_tied(self, **ties: tuple[str, float] | tuple[str, float, float]) -> Self:
        """Return a copy with tied parameters: each (name of another parameter, factor) or (name, factor, offset).

        A tie expresses a known ratio, such as the reset time K_p/K_i from a governor's manual. The tied parameter is not
        estimated: its value, interval and status follow from the other parameter. The bounds of the tied parameter also
        limit the other one.

        Raises
        ------
        InputError
            For an unknown name, a factor of zero, circular ties, or a start outside the bounds.

        Examples
        --------
        >>> from shipfp_rs import Structure
        >>> structure = Structure.linear(products=True).with_tied(vK_i=("vK_p", 1 / 0.42))
        >>> [parameter.name for parameter in structure.free]
        ['tau_n', 'g', 'vK_p']
        """
        structure = self
        for name, given in ties.items():
            if len(given) not in (2, 3) or not isinstance(given[0], str):
                raise InputError(
                    f"tied {name}: found {given}, expected (name, factor) or (name, factor, offset)"
                )
            tie = Tie(given[0], *map(float, given[1:]))
            if not (np.isfinite(tie.factor) and np.isfinite(tie.offset)) or tie.factor == 0.0:
                raise InputError(f"tied {name}: found {tie}, expected a finite factor that is not 0")
            _ = structure[tie.to]  # raises for an unknown name
            structure = structure._with(name, fixed=False, prior=None, tied=tie)
        return structure

    @checked
    def with_start(self, **values: float) -> Self:
        """Return a copy with changed start values."""
        structure = self
        for name, value in values.items():
            if (tie := structure[name].tied) is not None:
                raise InputError(f"parameter {name}: tied as {tie}, so without a start; give one to {tie.to}")
            structure = structure._with(name, start=float(value))
        return structure

    @checked
    def with_bounds(self, **bounds: tuple[float, ...]) -> Self:
        """Return a copy with changed bounds, each (lower, upper) or (lower, start, upper), which must contain the start."""
        structure = self
        for name, limits in bounds.items():
            if len(limits) not in (2, 3):
                raise InputError(
                    f"bounds of {name}: {limits}, expected (lower, upper) or (lower, start, upper)"
                )
            start = {"start": float(limits[1])} if len(limits) == 3 else {}
            structure = structure._with(
                name, lower=float(limits[0]), upper=float(limits[-1]), fixed=False, tied=None, **start
            )
        return structure
