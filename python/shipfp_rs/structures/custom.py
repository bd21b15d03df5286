"""Equations that a user brings: state-space matrices, run by the Rust kernel, or any function that simulates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values
from shipfp_rs.support.derivatives import Differences, by_part

Matrices = Callable[[Values], tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]]
Simulate = Callable[[Values, Experiment], npt.ArrayLike]
Response = Callable[[Values, Array], npt.ArrayLike]


@dataclass(frozen=True)
class MatrixEquations(Equations):
    """x' = A x + B dn_set, y = C x + D dn_set, with matrices that depend on the parameters.

    The derivatives by a parameter are a state space too, of twice the order: s' = A s + dA x + dB dn_set. They are as
    good as those of the matrices, by complex step to rounding.
    """

    matrices: Matrices
    parameters: tuple[Parameter, ...]
    outputs: tuple[str, ...]
    differences: Differences = field(default_factory=Differences, compare=False, repr=False)

    @property
    def states(self) -> tuple[str, ...]:
        """Initial states, "initial x1" and on."""
        order = len(self._model({p.name: p.start for p in self.parameters})[1])
        return tuple(f"initial x{index + 1}" for index in range(order))

    @property
    def linear_in(self) -> tuple[str, ...]:
        """The outputs are linear in the initial states."""
        return self.states

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        (A, B, C, D), slopes = self._slopes(values, names)
        states = tuple(f"initial x{index + 1}" for index in range(len(B)))
        u, dt, hold = experiment.dn_set, 1.0 / experiment.rate_hz, experiment.hold
        initial = np.array([values.get(state, 0.0) for state in states])
        simulated = _core.simulate_statespace(A, B, C, D, u, dt, hold, initial)
        rows = np.empty((len(names), *simulated.shape))
        for row, name in zip(rows, names, strict=True):
            if name in states:
                unit = np.eye(len(B))[states.index(name)]
                row[:] = _core.simulate_statespace(A, 0.0 * B, C, 0.0 * D, 0.0 * u, dt, hold, unit)
            else:
                both = np.concatenate([initial, 0.0 * initial])
                row[:] = _core.simulate_statespace(*slopes[name], u, dt, hold, both)
        return simulated, rows

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F)."""
        model, slopes = self._slopes(values, names)
        response = _core.statespace_response(*model, frequency_hz)
        rows = [_core.statespace_response(*slopes[name], frequency_hz) for name in names]
        return response, np.array(rows).reshape(len(names), *response.shape)

    def _slopes(self, values: Values, names: Names) -> tuple[Model, dict[str, Model]]:
        """Return the model, and by parameter the model whose output is the derivative by it."""
        model, moved = self._model(values), [p for p in self.parameters if p.name in names]
        if not moved:
            return model, {}

        def at(vector: npt.NDArray[Any]) -> Model:
            return self._model({**values, **{p.name: value for p, value in zip(moved, vector, strict=True)}})

        slopes = by_part(self.differences, at, *_about(values, moved))
        return model, {p.name: _twofold(model, parts) for p, parts in zip(moved, slopes, strict=True)}

    def _model(self, values: Values) -> Model:
        own = {p.name: values[p.name] for p in self.parameters}
        try:
            # What overflows is found below.
            with np.errstate(all="ignore"):
                A, B, C, D = (np.array(matrix) for matrix in self.matrices(own))
        except ArithmeticError as error:
            raise SimulationError(f"matrices: {error} with {_listed(own)}") from error
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
                raise SimulationError(f"matrices: {name} is not finite with {_listed(own)}")
        kind = np.result_type(A, B, C, D, np.float64)
        return A.astype(kind), B.astype(kind).ravel(), C.astype(kind), D.astype(kind).ravel()


Model = tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]


def _twofold(model: Model, slopes: Sequence[Array]) -> Model:
    """Return the model of states (x, dx) whose outputs are the derivatives of the given model's."""
    (A, B, C, _), (dA, dB, dC, dD) = model, slopes
    return np.block([[A, np.zeros_like(A)], [dA, A]]), np.concatenate([B, dB]), np.hstack([dC, C]), dD


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
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        moved = [next(p for p in self.parameters if p.name == name) for name in names]

        def at(vector: npt.NDArray[Any]) -> npt.NDArray[Any]:
            own = {**values, **{p.name: value for p, value in zip(moved, vector, strict=True)}}
            return self._rows(self.function, own, experiment, len(experiment))

        return _differentiated(self.differences, at, values, moved)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F)."""
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

        # The imaginary part is taken: no complex step.
        value, slopes = _differentiated(Differences(complex_step=False), at, values, moved)
        return value[0] + 1j * value[1], slopes[:, 0] + 1j * slopes[:, 1]

    def _rows(
        self, function: Callable[[Values, Any], npt.ArrayLike], values: Values, data: object, columns: int
    ) -> npt.NDArray[Any]:
        own = {p.name: values[p.name] for p in self.parameters}
        try:
            # What overflows is found below.
            with np.errstate(all="ignore"):
                rows = np.asarray(function(own, data))
        except ArithmeticError as error:
            raise SimulationError(f"function: {error} with {_listed(own)}") from error
        expected = (len(self.outputs), columns)
        if rows.shape != expected:
            raise InputError(
                f"function: returned shape {rows.shape}, expected {expected}, a row for each of "
                f"{', '.join(self.outputs)}"
            )
        if not np.isfinite(rows).all():
            raise SimulationError(f"function: returned what is not finite with {_listed(own)}")
        return rows


def _differentiated(
    differences: Differences,
    function: Callable[[npt.NDArray[Any]], npt.NDArray[Any]],
    values: Values,
    parameters: Sequence[Parameter],
) -> tuple[Array, Array]:
    return differences(function, *_about(values, parameters))


def _about(values: Values, parameters: Sequence[Parameter]) -> tuple[Array, Array, Array, Array]:
    """Return where to differentiate, typical sizes and bounds, each (W,)."""
    return (
        np.array([values[p.name] for p in parameters], dtype=np.float64),
        np.array([p.scale for p in parameters]),
        np.array([p.lower for p in parameters]),
        np.array([p.upper for p in parameters]),
    )


def _listed(values: Values) -> str:
    return ", ".join(f"{name} {value:.6g}" for name, value in values.items())
