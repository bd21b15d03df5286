"""Sums of products of residuals and sensitivities: all that a search needs of a record, however long it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.support.arrays import Array, Mask

TOLD = 1e-12
"""Smallest singular value, over the largest, of directions of linear unknowns that the data determine."""

ROUNDING = 1e-14
"""Part of a column's sum of squares below which what the other columns do not explain of it is rounding."""

DISTINCT = 1e-8
"""Least eigenvalue of the normalised Gram matrix; below it the columns are so nearly dependent that products lose digits."""


@dataclass(frozen=True)
class Products:
    """Sums over samples of the products of all pairs of columns, in all pairs of outputs."""

    sums: Array
    """Of the model's derivatives by the unknowns, and of the residual last, shape (O, C, O, C)."""
    count: int
    """Number of samples that count."""

    @classmethod
    def of(cls, residual: Array, jacobian: Array, count: int) -> Products:
        """Add up the products of residuals (O, R) and derivatives of the model (C - 1, O, R)."""
        rows = np.concatenate([jacobian, residual[None]]).transpose(1, 0, 2)
        tall = rows.reshape(-1, residual.shape[1])
        return cls((tall @ tall.T).reshape(rows.shape[:2] * 2), count)

    @property
    def scatter(self) -> Array:
        """Sum over samples of the outer products of the residuals, shape (O, O)."""
        return self.sums[:, -1, :, -1]

    def moved(self, step: Array) -> Products:
        """The same after unknowns in which the model is linear went a step (C - 1,), which changes the residual only."""
        left = np.eye(self.sums.shape[1])
        left[:-1, -1] = -step
        return Products(np.einsum("iajb,ac,bd->icjd", self.sums, left, left, optimize=True), self.count)

    def rows(self, root: Array) -> Array | None:
        """Few rows (C, O, R) of [d(model)/d(unknowns), e] with the same products.

        None where the columns, weighted by a root (O, O), are so nearly dependent that products tell less than they do.
        """
        weighted = self.gram(root)
        # The square of a residual that is zero may come out negative by rounding.
        size = np.sqrt(np.maximum(np.diag(weighted), 0.0))
        size[size == 0.0] = 1.0
        if not np.linalg.eigvalsh(weighted / np.outer(size, size))[0] > DISTINCT:
            return None
        outputs, columns, *_ = self.sums.shape
        gram = self.sums.reshape(outputs * columns, -1)
        size = np.sqrt(np.maximum(np.diag(gram), 0.0))
        size[size == 0.0] = 1.0
        strength, direction = np.linalg.eigh(gram / np.outer(size, size))
        # Where outputs depend on each other, some directions are rounding only.
        short = size[:, None] * direction * np.sqrt(np.maximum(strength, 0.0))
        return np.ascontiguousarray(short.reshape(outputs, columns, -1).swapaxes(0, 1))

    def gram(self, root: Array) -> Array:
        """Products of [-d(model)/d(unknowns), e] (C, C) with the outputs weighted by a root (O, O) of their weight."""
        gram = np.asarray(np.einsum("iajb,ij->ab", self.sums, root.T @ root))
        gram[:-1, -1] *= -1.0
        gram[-1, :-1] *= -1.0
        return gram


def regression(gram: Array, own: Mask) -> Array:
    """Return the coefficients (L, M) that explain the columns not of `own` (M) best by those of `own` (L).

    The gram matrix holds the products of all columns; null directions among those of `own` are left alone.
    """
    half = orthonormal(gram[np.ix_(own, own)])
    return np.asarray(half @ (half.T @ gram[np.ix_(own, ~own)]))


def orthonormal(gram: Array) -> Array:
    """Return combinations (L, D) that make columns with these products (L, L) orthonormal, null directions left out."""
    size = np.sqrt(np.diag(gram))
    size[size == 0.0] = 1.0
    strength, direction = np.linalg.eigh(gram / np.outer(size, size))
    told = strength > TOLD * max(strength, default=0.0)
    return np.asarray(direction[:, told] / np.sqrt(strength[told]) / size[:, None])


def cleared(gram: Array, own: Mask, coefficients: Array) -> Array:
    """Return the products (M, M) of the columns not of `own` that are left when those are cleared of what `own` explain.

    `coefficients` (L, M) are those of `regression`.
    """
    across = gram[np.ix_(own, ~own)]
    whole = gram[np.ix_(~own, ~own)]
    left = whole - across.T @ coefficients
    kept = np.diag(left) > ROUNDING * np.diag(whole)
    return np.asarray(np.where(np.outer(kept, kept), left, 0.0))


def condense(gram: Array) -> tuple[Array, Array]:
    """Return a residual (Q + 1,) and Jacobian (Q + 1, Q) whose products are those of [J e]'[J e], shape (Q + 1, Q + 1)."""
    size = np.sqrt(np.diag(gram)[:-1])
    size[size == 0.0] = 1.0
    strength, direction = np.linalg.eigh(gram[:-1, :-1] / np.outer(size, size))
    # A direction below rounding gets no row, so no step goes along it.
    root = np.sqrt(np.where(strength > 1e-15 * strength[-1], strength, 0.0))
    turned = direction.T @ (gram[:-1, -1] / size)
    along = np.divide(turned, root, out=np.zeros_like(turned), where=root > 0.0)
    rest = max(gram[-1, -1] - along @ along, 0.0)
    jacobian = np.vstack([root[:, None] * direction.T * size, np.zeros(len(size))])
    return np.append(along, np.sqrt(rest)), jacobian
