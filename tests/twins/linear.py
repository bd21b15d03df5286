"""NumPy reference of the linear structure: from the equations, sharing nothing with the kernels."""

import numpy as np
from numpy.typing import NDArray

from shipfp_rs._core import LINEAR_PARAMETERS

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


def vector(**changes: float) -> Array:
    """Parameters of the virtual launch (operating point of Table 3.5), some of them changed."""
    assert set(changes) <= set(DEFAULTS)
    values = DEFAULTS | changes
    return np.array([values[name] for name in LINEAR_PARAMETERS])


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
