"""Seed of each draw and its point in the unit cube, both determined by its index."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.stats import qmc

from shipfp_rs.support.arrays import Array

Design = Literal["random", "latin", "sobol", "grid"]

BLOCK = 65_536
"""Draws of one design; a larger sweep has several, scrambled independently, so that memory does not grow with it."""


def seed_of(seed: int, index: int) -> int:
    """Seed of one draw, from 0 to 2^63 - 1, from the child of `SeedSequence(seed).spawn` with its index."""
    child = np.random.SeedSequence(seed, spawn_key=(index,))
    return int(child.generate_state(1, np.uint64)[0] >> np.uint64(1))


def place(
    design: Literal["random", "latin", "sobol"], factors: int, draws: int, seed: int, index: int
) -> Array:
    """Point of a draw in the unit cube, shape (factors,); each block of `BLOCK` draws is a separate design."""
    block, row = divmod(index, BLOCK)
    return np.asarray(_block(design, factors, min(BLOCK, draws - block * BLOCK), seed, block)[row])


@lru_cache(maxsize=2)
def _block(design: str, factors: int, rows: int, seed: int, block: int) -> Array:
    if not factors:
        return np.empty((rows, 0))
    # A key of two numbers can't collide with that of a draw, which has one.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block, 1)))
    if design == "random":
        return np.asarray(generator.random((rows, factors)))
    if design == "latin":
        return np.asarray(qmc.LatinHypercube(factors, rng=generator).random(rows))
    # A Sobol sequence is balanced for a power of two of draws, so the next power is drawn; draws after `rows` are not used.
    return np.asarray(qmc.Sobol(factors, rng=generator).random_base2(math.ceil(math.log2(rows))))
