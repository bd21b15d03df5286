"""Detection of a set point that becomes late or early during a record, as where its recorder lost samples.

A linear difference equation relates the speed to the set point and the load. It is fitted to the whole record, with the set
point shifted from some time on, for many times and shifts. Only with the true shift does one equation hold in every stretch
before and after that time.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array

RATE_HZ = 10.0
"""Rate of the block means for which the equation is fitted [Hz]."""
FARTHEST, LEAST = 8, 3
"""Largest and smallest tested shift, in block means."""
OWN, CAUSES = 3, 6
"""Numbers of past samples in the equation: of the speed, and of set point and load."""
STRETCHES, EDGE, SHORTEST = 24, 5, 20
"""Number of stretches of the record, stretches at either end that are not searched, and least samples of a stretch."""
BETTER, AGREED = 1.15, 0.8
"""Least factor by which a shift reduces the residual's variance, and least share of stretches on each side that agree. Of
176 simulated trials without a shift none was detected. A shift of 0.4 s in the second half was detected in 142, in three of
these at another time or with another size."""


def moved_from(experiment: Experiment) -> tuple[float, float] | None:
    """Return the time [s] from which the set point is late, and its delay [s], negative if early; None if it never is."""
    block = max(int(experiment.rate_hz // RATE_HZ), 1)
    names = [name for name in ("n_e", "n_s", "n_set", "M_load") if name in experiment.signals]
    if "n_set" not in names or len(names) < 2 or len(experiment) < block * STRETCHES * SHORTEST:
        return None
    signals = {name: _means(experiment.normalised(name), block) for name in names}
    asked, speed = signals["n_set"], signals[names[0]]
    at = np.arange(FARTHEST + CAUSES, len(asked) - FARTHEST - 1)
    known = [speed[at - back] for back in range(OWN + 1)] + [np.ones(len(at))]
    known += [signals["M_load"][at - back] for back in range(CAUSES) if "M_load" in names]
    edges = np.linspace(0, len(at), STRETCHES + 1).astype(int)
    products = {}
    for move in (0, *(one for one in range(-FARTHEST, FARTHEST + 1) if abs(one) >= LEAST)):
        rows = np.column_stack(known + [asked[at - back + move] for back in range(-1, CAUSES)])
        products[move] = np.array([rows[a:b].T @ rows[a:b] for a, b in pairwise(edges)])
    still = products.pop(0)
    found = (
        (_left(still[:place].sum(axis=0) + moved[place:].sum(axis=0))[0], place, move)
        for move, moved in products.items()
        for place in range(EDGE, STRETCHES - EDGE + 1)
    )
    least, place, move = min(found)
    if not _left(still.sum(axis=0))[0] > BETTER * least > 0.0:
        return None
    moved = products[move]
    equation = _left(still[:place].sum(axis=0) + moved[place:].sum(axis=0))[1]
    better = np.einsum("i,kij,j->k", equation, still - moved, equation) > 0.0
    if not min(np.mean(~better[:place]), np.mean(better[place:])) > AGREED:
        return None
    rate_hz = experiment.rate_hz / block
    return float(at[edges[place]] / rate_hz), move / rate_hz


def _means(values: Array, block: int) -> Array:
    """Block means, with masked samples interpolated linearly."""
    index, known = np.arange(len(values)), np.isfinite(values)
    filled = np.interp(index, index[known], values[known]) if known.any() else np.zeros(len(values))
    return np.asarray(filled[: len(values) // block * block].reshape(-1, block).mean(axis=1))


def _left(products: Array) -> tuple[float, Array]:
    """Return the least residual sum of squares of the first column, and the equation's coefficients (K,)."""
    factors = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=None)[0]
    return float(products[0, 0] - products[0, 1:] @ factors), np.concatenate([[1.0], -factors])
