"""Identifiability: numerical rank of the sensitivities, null directions and identifiable combinations by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from shipfp_rs.identification.estimate import Identifiability
from shipfp_rs.structures.ties import Ties, followed
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence, joined, listed

RANK_TOLERANCE = 1e-7
"""Singular values below this share of the largest count as zero: the sensitivities are exact to about 1e-10."""
NULL_PART = 1e-4
"""A parameter, or the gradient of a combination, is independent of null directions that have less than this share of it."""


@dataclass(frozen=True)
class Sensitivity:
    """Singular value decomposition of the whitened sensitivities to relative changes of the parameters."""

    names: tuple[str, ...]
    scale: Array
    singular: Array
    right: Array

    @classmethod
    def of(cls, jacobian: Array, names: Sequence[str], scale: Array) -> Sensitivity:
        """Decompose a Jacobian of shape (R, P); `scale` (P,) are typical sizes of the parameters."""
        # The triangular factor has the singular values and right vectors of the tall matrix.
        triangle = np.linalg.qr(jacobian * scale, mode="r")
        _, singular, right = np.linalg.svd(triangle, full_matrices=True)
        singular = np.concatenate([singular, np.zeros(len(names) - len(singular))])
        return cls(tuple(names), scale, singular, right)

    @property
    def rank(self) -> int:
        """Number of directions that the data determine."""
        if not self.singular.size or self.singular[0] == 0.0:
            return 0
        return int(np.sum(self.singular > RANK_TOLERANCE * self.singular[0]))

    @property
    def null(self) -> Array:
        """Orthonormal null directions as relative changes, shape (P - rank, P)."""
        return self.right[self.rank :]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; infinite where the rank is not full."""
        return float(self.singular[0] / self.singular[-1]) if self.rank == len(self.names) else float("inf")

    def covariance(self) -> Array:
        """Covariance for unit residual variance, in the directions that the data determine, shape (P, P)."""
        rank = self.rank
        half = (self.right[:rank].T / self.singular[:rank]) * self.scale[:, None]
        return np.asarray(half @ half.T)

    def held_by_bounds(self, inward: npt.NDArray[np.int_]) -> npt.NDArray[np.bool_]:
        """Return which parameters a bound holds (P,); `inward` is the sign towards the inside on a bound, 0 elsewhere."""
        # If a null direction leads inside and pushes no other parameter over its bound, the data do not press against the
        # bound: the search stopped there by chance.
        held = inward != 0
        if not held.any() or not len(self.null):
            return np.asarray(held)
        # Directions d = null' z in which every parameter on a bound moves inward or not at all.
        constraint = -(inward[held, None] * self.null.T[held])
        for index in np.flatnonzero(held):
            goal = linprog(
                -inward[index] * self.null[:, index],
                A_ub=constraint,
                b_ub=np.full(len(constraint), 1e-9),
                bounds=(-1.0, 1.0),
            )
            if goal.success and -goal.fun > NULL_PART:
                held[index] = False
        return np.asarray(held)

    def reach(self, values: Array, lower: Array, upper: Array) -> Array:
        """Range of each parameter along the null directions, between the bounds of all parameters, shape (P,)."""
        reach = np.zeros(len(values))
        if not len(self.null):
            return reach
        along = self.null.T * self.scale[:, None]
        for index, row in enumerate(along):
            if np.linalg.norm(self.null[:, index]) <= NULL_PART:
                continue
            ways = [
                linprog(
                    sign * row,
                    A_ub=np.vstack([along, -along]) / np.tile(self.scale, 2)[:, None],
                    b_ub=np.concatenate([upper - values, values - lower]) / np.tile(self.scale, 2),
                    bounds=(None, None),
                )
                for sign in (1.0, -1.0)
            ]
            reach[index] = -sum(way.fun for way in ways) if all(way.success for way in ways) else np.inf
        return reach

    def tells(self, gradient: Array) -> bool:
        """Whether the data determine a combination: its gradient (P,) has no component in a null direction."""
        relative = gradient * self.scale
        size = float(np.linalg.norm(relative))
        return size > 0.0 and float(np.linalg.norm(self.null @ relative)) < NULL_PART * size


NEAR_ZERO = 1e-3
"""Value below which a forward difference replaces the central one, with steps of a tenth of this number."""


def gradient_of(
    function: Callable[[Mapping[str, float]], float],
    values: Mapping[str, float],
    names: Sequence[str],
    ties: Ties | None = None,
) -> Array:
    """Return the gradient of a combination by `names`, by differences, to about 1e-6; tied parameters follow."""

    def at(name: str, by: float) -> float:
        return function(followed({**values, name: values[name] + by}, ties or {}))

    gradient = np.empty(len(names))
    for index, name in enumerate(names):
        if abs(values[name]) > NEAR_ZERO:
            step = 1e-6 * abs(values[name])
            gradient[index] = (at(name, step) - at(name, -step)) / (2.0 * step)
        else:  # a delay of zero can't decrease
            gradient[index] = (
                4.0 * at(name, 0.1 * NEAR_ZERO) - at(name, 0.2 * NEAR_ZERO) - 3.0 * at(name, 0.0)
            ) / (0.2 * NEAR_ZERO)
    return gradient


def describe(sensitivity: Sensitivity) -> Identifiability:
    """Describe rank and null directions by parameter names, with parameters that would resolve them if they were known."""
    names, null = sensitivity.names, sensitivity.null
    directions = [_direction(names, row) for row in _sparse_basis(null)]
    members = [name for index, name in enumerate(names) if np.linalg.norm(null[:, index]) > NULL_PART]
    missing = len(null)
    closing: list[str] = []
    # A list of combinations of more than three parameters would not help a user.
    if 0 < missing <= 3:
        for chosen in combinations(members, missing):
            columns = null[:, np.array([names.index(name) for name in chosen])]
            if np.linalg.svd(columns, compute_uv=False)[-1] > 1e-3:
                closing.append(listed(chosen))
    return Identifiability(
        rank=sensitivity.rank,
        free=len(names),
        condition=sensitivity.condition,
        null_space=tuple(directions),
        closes_gap=tuple(closing),
    )


def _direction(names: Sequence[str], row: Array) -> dict[str, object]:
    part = {name: float(change) for name, change in zip(names, row, strict=True) if abs(change) > NULL_PART}
    changes = [
        Sentence("{name} {change} %", name=name, change=f"{change:+.3g}") for name, change in part.items()
    ]
    return {"combination": joined(changes), "direction": part}


def without_nuisance(jacobian: Array, count: int) -> Array:
    """Return the parameters' columns without the component that unknowns of the records could explain, shape (R, P)."""
    columns, nuisance = jacobian[:, :count], jacobian[:, count:]
    if not nuisance.shape[1]:
        return columns
    size = np.linalg.norm(nuisance, axis=0)
    basis, _ = np.linalg.qr(nuisance[:, size > 0] / size[size > 0])
    return np.asarray(columns - basis @ (basis.T @ columns))


def why_unknown(everything: Sensitivity, index: int) -> str:
    """Say why the data do not determine a parameter; empty where they do."""
    null_part = float(np.linalg.norm(everything.null[:, index])) if len(everything.null) else 0.0
    if null_part <= NULL_PART:
        return ""
    partners = sorted(
        {
            other
            for row in everything.null
            if abs(row[index]) > NULL_PART
            for other, part in zip(everything.names, row, strict=True)
            if abs(part) > NULL_PART and other != everything.names[index]
        }
    )
    if not partners:
        return Sentence("the data do not depend on it")
    return Sentence("only known together with {names}", names=joined(partners))


def _sparse_basis(null: Array) -> Array:
    """Gauss-Jordan form with full pivoting: each direction has a leading 1, and zeros at the others' leading entries."""
    basis = null.copy()
    for row in range(len(basis)):
        free_rows = np.abs(basis[row:])
        pivot_row, pivot = divmod(int(np.argmax(free_rows)), basis.shape[1])
        basis[[row, row + pivot_row]] = basis[[row + pivot_row, row]]
        basis[row] /= basis[row, pivot]
        for other in range(len(basis)):
            if other != row:
                basis[other] -= basis[other, pivot] * basis[row]
    return basis
