"""Dual numbers: values with exact derivatives by named parameters; every operation applies the chain rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import ComplexArray, Names

Parameters = Mapping[str, Any]
"""Values by name: numbers, arrays or dual numbers."""
PARTIALS: Mapping[np.ufunc, Any] = {
    np.negative: lambda _, x: (-1.0,),
    np.add: lambda _, x, y: (None, None),
    np.subtract: lambda _, x, y: (None, -1.0),
    np.multiply: lambda _, x, y: (y, x),
    np.divide: lambda ratio, x, y: (1.0 / y, -ratio / y),
    np.exp: lambda power, x: (power,),
    np.expm1: lambda less, x: (less + 1.0,),
}
"""Derivatives of a function by its arguments, from its value and the arguments; None stands for 1 and saves a product."""


class Dual(np.lib.mixins.NDArrayOperatorsMixin):
    """A number or array, and its derivatives by the parameters that it depends on."""

    def __init__(self, value: Any, by: Mapping[str, Any]) -> None:
        self.value, self.by = value, by

    def __array_ufunc__(self, function: np.ufunc, method: str, *arguments: Any) -> Dual:
        values = [value_of(one) for one in arguments]
        found = function(*values)
        by: dict[str, Any] = {}
        for argument, partial in zip(arguments, PARTIALS[function](found, *values), strict=True):
            for name, slope in argument.by.items() if isinstance(argument, Dual) else ():
                term = slope if partial is None else partial * slope
                by[name] = by[name] + term if name in by else term
        return Dual(found, by)

    def __getitem__(self, place: int) -> Dual:
        return Dual(self.value[place], {name: slope[place] for name, slope in self.by.items()})


def value_of(number: Any) -> Any:
    """Return a dual number without its derivatives; anything else as it is."""
    return number.value if isinstance(number, Dual) else number


def varied(values: Parameters, names: Names) -> dict[str, Any]:
    """Return values with those in `names` as dual numbers; values that are dual numbers already stay unchanged."""
    own = {name: values[name] for name in names if name in values}
    return {
        **values,
        **{name: one if isinstance(one, Dual) else Dual(one, {name: 1.0}) for name, one in own.items()},
    }


def value_and_slopes(found: Any, names: Names) -> tuple[npt.NDArray[Any], ComplexArray]:
    """Return the value of an array or a dual number and its derivatives by `names`, shape (W, ...)."""
    value, by = np.asarray(value_of(found)), getattr(found, "by", {})
    slopes = np.zeros((len(names), *value.shape), dtype=np.complex128)
    for slope, name in zip(slopes, names, strict=True):
        slope[:] = by.get(name, 0.0)
    return value, slopes
