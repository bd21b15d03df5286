"""NumPy reference of the state space: small steps of the differential equation, sharing nothing with the kernels."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp


def simulate(A, B, C, D, u, dt, hold, initial):
    """Sample by sample with an eighth-order Runge-Kutta method."""
    state = np.array(initial, dtype=float)
    states = [state]
    for now, after in pairwise(u):
        slope = (after - now) / dt if hold == "first" else 0.0

        def rate(t, x, now=now, slope=slope):
            return A @ x + B * (now + slope * t)

        state = solve_ivp(rate, (0, dt), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        states.append(state)
    return C @ np.array(states).T + np.outer(D, u)


def response(A, B, C, D, frequency_hz):
    """C (s - A)^-1 B + D through the eigenvectors of A."""
    values, vectors = np.linalg.eig(A)
    inside = np.linalg.solve(vectors, B.astype(complex))
    return np.array([(C @ vectors) @ (inside / (2j * np.pi * f - values)) + D for f in frequency_hz]).T
