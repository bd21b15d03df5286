"""Copies of a structure with other starts, bounds, priors, ties and fixed values."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.structures.declared import Declared
from shipfp_rs.structures.ties import Tie, tied
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked


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
        """Return a copy with tied parameters: each (name of the other, factor), or with an offset as third value.

        A tie expresses a known ratio, such as the reset time K_p/K_i from a governor's manual. The tied parameter is not
        searched; its value, interval and status follow from the other's, and its bounds apply to the other.

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
        """Return a copy with other start values."""
        structure = self
        for name, value in values.items():
            if (tie := structure[name].tied) is not None:
                raise InputError(f"parameter {name}: tied as {tie}, expected no start; give one to {tie.to}")
            structure = structure._with(name, start=float(value))
        return structure

    @checked
    def with_bounds(self, **bounds: tuple[float, ...]) -> Self:
        """Return a copy with other bounds, each (lower, upper) or (lower, start, upper); they must contain the start."""
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
