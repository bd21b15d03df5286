"""The linear structure from its equations, without the kernels: responses, and records with and without a dead time."""

import functools
import math
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from tests.twins import ship
from tests.twins.plant import vectors

Array = NDArray[np.float64]

DEFAULTS = {
    "tau_n": 1.5,
    "g": -0.583,
    "v": 1.583,
    "K_p": 10.0,
    "K_i": 1.0,
    "p": 2.0,
    "tau_prop": 1.0,
    "T_d": 0.0,
    "T_set": 0.0,
}


vector = vectors(DEFAULTS, tuple(DEFAULTS))
"""Parameters of the virtual launch (operating point of Table 3.5), some of them changed."""


def response(parameters: Array, frequency_hz: Array) -> NDArray[np.complex128]:
    """All five transfer functions from the loop equations, solved as a linear system per frequency."""
    tau_n, g, v, K_p, K_i, p, tau_prop, T_d, T_set = parameters
    rows = []
    for s in 2j * np.pi * frequency_hz:
        # Unknowns n, E, X, w for a set point of 1.
        u = np.exp(-s * T_set)
        equations = np.array(
            [
                [tau_n * s + p - g, 0, 0, -1],
                [1, s, 0, 0],
                [K_p, -K_i, 1, 0],
                [0, 0, -v * np.exp(-s * T_d), 1],
            ]
        )
        n, E, X, w = np.linalg.solve(equations, np.array([0, u, K_p * u, 0]))
        rows.append([n, E, g * n + w, p * n + tau_prop * s * n, X])
    return np.array(rows).T


def set_point(
    dn_set: Array, dt: float, hold: str, delay: float, start: float, end: float
) -> tuple[float, float]:
    """Value just after `start` and just before `end` of the delayed set point, linear between the two."""
    first, last = (start - delay) / dt, (end - delay) / dt
    sample = math.floor((first + last) / 2)
    left, right = (float(dn_set[min(max(index, 0), dn_set.size - 1)]) for index in (sample, sample + 1))
    if hold == "zero" or sample < 0:
        return left, left
    return left + (first - sample) * (right - left), left + (last - sample) * (right - left)


def corners(samples: int, dt: float, *delays: float) -> Array:
    """All sample times and all times at which a delayed set point has a corner."""
    grid = np.arange(samples) * dt
    times = np.sort(np.concatenate([grid, *(grid + delay for delay in delays)]))
    times = times[times <= grid[-1] + 1e-12]
    return times[np.concatenate([[True], np.diff(times) > 1e-12])]


def outputs(parameters: Array, n: Array, E: Array, slope: Array, u: Array) -> Array:
    tau_n, _, _, K_p, K_i, p, tau_prop, _, _ = parameters
    return np.array([n, E, p * n + tau_n * slope, p * n + tau_prop * slope, K_p * (u - n) + K_i * E])


def simulate(parameters: Array, dn_set: Array, dt: float, hold: str, initial: Array) -> Array:
    """No dead time in the loop: the matrix exponential from corner to corner of the set point; [5, N]."""
    tau_n, g, v, K_p, K_i, p, _, T_d, T_set = parameters
    assert T_d == 0
    a, b, c = (p - g) / tau_n, v * K_p / tau_n, v * K_i / tau_n
    # n, E, u, u'
    system = np.array([[-a - b, c, b, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    advance = functools.cache(lambda duration: scipy.linalg.expm(system * duration))
    times = corners(dn_set.size + 1, dt, T_set)
    state = np.array([*initial, 0.0, 0.0])
    rows = []
    for start, end in pairwise(times):
        state[2], u_end = set_point(dn_set, dt, hold, T_set, start, end)
        state[3] = (u_end - state[2]) / (end - start)
        if abs(start / dt - round(start / dt)) < 1e-9:
            n, E, u, _ = state
            rows.append(outputs(parameters, n, E, (system @ state)[0], u))
        state = advance(round(end - start, 15)) @ state
    return np.array(rows).T


def simulate_delayed(parameters: Array, dn_set: Array, dt: float, hold: str) -> Array:
    """A dead time in the loop, from rest: the ship whose load's law is a straight line, by the method of steps."""
    linear = dict(zip(DEFAULTS, parameters, strict=True))
    linear |= {"damping": linear["p"] - 1.0, "p": 1.0}
    rows = ship.simulate(linear, 1.0 + dn_set, np.empty(0), dt, hold, ("dn", "dE", "dM_b", "dM_g"))
    times = np.arange(dn_set.size) * dt
    asked = [set_point(dn_set, dt, hold, linear["T_set"], time, time + 1e-9)[0] for time in times]
    return np.array([*rows, linear["K_p"] * (asked - rows[0]) + linear["K_i"] * rows[1]])
