"""User equations: state-space matrices, run by the Rust kernel, or any function that simulates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.state_space import STEP, Model, StateSpaceEquations, listed
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values
from shipfp_rs.support.derivatives import Differences, by_part

Matrices = Callable[[Values], tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]]
Simulate = Callable[[Values, Experiment], npt.ArrayLike]
Response = Callable[[Values, Array], npt.ArrayLike]


@dataclass(frozen=True)
class MatrixEquations(StateSpaceEquations):
    """x' = A x + B dn_set, y = C x + D dn_set, with matrices that depend on the parameters."""

    matrices: Matrices
    parameters: tuple[Parameter, ...]
    outputs: tuple[str, ...]
    differences: Differences = field(default_factory=Differences, compare=False, repr=False)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the initial states, from "initial x1" on."""
        A, *_ = self._matrices({p.name: p.start for p in self.parameters})
        return tuple(f"initial x{index + 1}" for index in range(len(A)))

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Names of the initial states, on all of which the outputs depend linearly."""
        return self.states

    def model(self, values: Values, names: Names) -> Model:
        """Return the model with its derivatives by `names`; without names, along a first axis of length 1."""
        moved = [p for p in self.parameters if p.name in names]
        matrices = self._matrices(values)
        states = [f"initial x{index + 1}" for index in range(len(matrices[0]))]
        start = np.array([values.get(state, 0.0) for state in states])

        def at(vector: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
            return self._matrices(
                {**values, **{p.name: value for p, value in zip(moved, vector, strict=True)}}
            )

        # If the matrices accept complex values, a complex step gives derivatives that are exact to rounding.
        slopes = by_part(self.differences, at, *_about(values, moved)) if moved else []
        by = {p.name: parts for p, parts in zip(moved, slopes, strict=True)}
        none = [np.zeros_like(part) for part in matrices]
        own = zip(*(by.get(name, none) for name in names or [""]), strict=True)
        A, B, C, D = (part + 1j * STEP * np.array(slope) for part, slope in zip(matrices, own, strict=True))
        unit = np.array([[state == name for state in states] for name in names or [""]])
        return Model(A, B, C, D, start + 1j * STEP * unit, np.zeros((len(A), 1)))

    def _matrices(self, values: Values) -> list[npt.NDArray[Any]]:
        own = {p.name: values[p.name] for p in self.parameters}
        try:
            # Overflow is detected below.
            with np.errstate(all="ignore"):
                A, B, C, D = (np.array(matrix) for matrix in self.matrices(own))
        except ArithmeticError as error:
            raise SimulationError(f"matrices: {error} with {listed(own)}") from error
        order, outputs = len(A), len(self.outputs)
        for name, matrix, shapes in (
            ("A", A, [(order, order)]),
            ("B", B, [(order,), (order, 1)]),
            ("C", C, [(outputs, order)]),
            ("D", D, [(outputs,), (outputs, 1)]),
        ):
            if matrix.shape not in shapes:
                raise InputError(
                    f"matrices: {name} has shape {matrix.shape}, expected {' or '.join(map(str, shapes))} with "
                    f"{order} rows in A and outputs {', '.join(self.outputs)}"
                )
            if not np.isfinite(matrix).all():
                raise SimulationError(f"matrices: {name} is not finite with {listed(own)}")
        kind = np.result_type(A, B, C, D, np.float64)
        return [
            A.astype(kind),
            B.astype(kind).reshape(order, 1),
            C.astype(kind),
            D.astype(kind).reshape(outputs, 1),
        ]


@dataclass(frozen=True)
class FunctionEquations(Equations):
    """Any function that simulates an experiment, differentiated numerically."""

    function: Simulate
    parameters: tuple[Parameter, ...]
    outputs: tuple[str, ...]
    frequency_function: Response | None = None
    states: tuple[str, ...] = ()
    differences: Differences = field(default_factory=Differences, compare=False, repr=False)

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return np.asarray(self._rows(self.function, values, experiment, len(experiment)), dtype=np.float64)

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        moved = [next(p for p in self.parameters if p.name == name) for name in names]

        def at(vector: npt.NDArray[Any]) -> npt.NDArray[Any]:
            own = {**values, **{p.name: value for p, value in zip(moved, vector, strict=True)}}
            return self._rows(self.function, own, experiment, len(experiment))

        return _differentiated(self.differences, at, values, moved)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F)."""
        if self.frequency_function is None:
            raise InputError(
                "this structure has no frequency response; give Structure.from_function(..., response=...)"
            )
        respond = self.frequency_function
        moved = [next(p for p in self.parameters if p.name == name) for name in names]

        def at(vector: npt.NDArray[Any]) -> npt.NDArray[Any]:
            own = {**values, **{p.name: value for p, value in zip(moved, vector, strict=True)}}
            rows = self._rows(respond, own, frequency_hz, len(frequency_hz))
            return np.stack([rows.real, rows.imag])

        # The response is complex, so differences are used instead of a complex step.
        value, slopes = _differentiated(Differences(complex_step=False), at, values, moved)
        return value[0] + 1j * value[1], slopes[:, 0] + 1j * slopes[:, 1]

    def _rows(
        self, function: Callable[[Values, Any], npt.ArrayLike], values: Values, data: object, columns: int
    ) -> npt.NDArray[Any]:
        own = {p.name: values[p.name] for p in self.parameters}
        try:
            # Overflow is detected below.
            with np.errstate(all="ignore"):
                rows = np.asarray(function(own, data))
        except ArithmeticError as error:
            raise SimulationError(f"function: {error} with {listed(own)}") from error
        expected = (len(self.outputs), columns)
        if rows.shape != expected:
            raise InputError(
                f"function: returned shape {rows.shape}, expected {expected}, a row for each of "
                f"{', '.join(self.outputs)}"
            )
        if not np.isfinite(rows).all():
            raise SimulationError(f"function: returned values that are not finite with {listed(own)}")
        return rows


def _differentiated(
    differences: Differences,
    function: Callable[[npt.NDArray[Any]], npt.NDArray[Any]],
    values: Values,
    parameters: Sequence[Parameter],
) -> tuple[Array, Array]:
    return differences(function, *_about(values, parameters))


def _about(values: Values, parameters: Sequence[Parameter]) -> tuple[Array, Array, Array, Array]:
    """Return the point of differentiation, typical sizes, and lower and upper bounds, each (W,)."""
    return (
        np.array([values[p.name] for p in parameters], dtype=np.float64),
        np.array([p.scale for p in parameters]),
        np.array([p.lower for p in parameters]),
        np.array([p.upper for p in parameters]),
    )
