"""What an engineer would write in an afternoon, the rival of every fit: the nonlinear ship in Numba, fitted by SciPy.

    python -m benches.rival_ship

Over the operating point, with e = s_u u(t - T_set) - N and the fuel X = vK_p e + vK_i I, dI/dt = e:
tau_n dN/dt = 1 + g (N - 1) + X(t - T_d) - N^p, and the gauge reads s_M (N^p + tau_prop dN/dt). Each output's noise is an
autoregression of order 8, fitted from the residuals and put in front of them again, four times in turn.
"""

import time

import numpy as np
from numba import njit
from scipy.linalg import solve_toeplitz
from scipy.optimize import least_squares
from scipy.signal import lfilter

NAMES = ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop", "T_d", "T_set", "N(0)", "M_b(0)", "s_u", "s_M")
BOUNDS = np.array(
    [
        (0.05, 8),
        (-5, 0.9),
        (0.05, 50),
        (0.05, 80),
        (1, 3.5),
        (0.01, 2),
        (1e-3, 0.4),
        (0, 1),
        (0.7, 1.3),
        (0.3, 1.7),
        (0.9, 1.1),
        (0.9, 1.1),
    ]
).T
START = np.array([1.0, -0.6, 4.2, 7.9, 2.0, 0.3, 0.05, 0.2, 1.0, 1.0, 1.0, 1.0])
TRUTH = np.array([1.2, -0.5, 4.5, 10.0, 2.15, 0.38, 0.07, 0.30, 1.0, 1.0, 1.0, 1.0])
ORDER = 8


@njit(cache=True)
def ship(q, u, dt, pieces):
    """Speed and gauge torque over the operating point, shape (2, N); midpoint rule, `pieces` steps a sample."""
    tau, g, kp, ki, p, tau_prop, dead, late, speed, torque, s_u, s_M = q
    h = dt / pieces
    fuel = np.empty(len(u) * pieces)
    integral = (torque - 1.0 - g * (speed - 1.0)) / ki
    # The fuel holds for a step and is meant for its middle, half a step later.
    steps = max(dead / h - 0.5, 0.0)
    whole = int(steps)
    rest = steps - whole
    out = np.empty((2, len(u)))
    before = torque - 1.0 - g * (speed - 1.0)
    for i in range(len(fuel)):
        at = max(i / pieces - late / dt, 0.0)
        k = int(at)
        asked = u[k] + (at - k) * (u[min(k + 1, len(u) - 1)] - u[k])
        error = s_u * asked - speed
        fuel[i] = kp * error + ki * integral
        j = i - whole
        arrived = fuel[0] if j < 1 else (1.0 - rest) * fuel[j] + rest * fuel[j - 1]
        rest_of_rate = 1.0 + g * (speed - 1.0) - speed**p
        rate = (rest_of_rate + arrived) / tau
        if i % pieces == 0:
            out[0, i // pieces] = speed
            out[1, i // pieces] = s_M * (
                speed**p + tau_prop * (rest_of_rate + 0.5 * (before + arrived)) / tau
            )
        before = arrived
        half = speed + 0.5 * h * rate
        integral += h * (error - 0.5 * h * rate)
        speed += h * (1.0 + g * (half - 1.0) + arrived - half**p) / tau
    return out


def trial(seed=1, seconds=500.0, dt=0.02):
    """Return set point (N,), speed and torque (2, N) over the operating point, interval [s]: a chirp, coloured noise."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds / dt)) * dt
    growth = np.log(1000.0) / (seconds - 20.0)
    u = 1.0 + 0.064 * np.sin(2.0 * np.pi * 0.004 * np.expm1(growth * np.maximum(t - 20.0, 0.0)) / growth)
    y = ship(TRUTH, u, dt, 20)
    noise = lfilter([1.0], [1.0, -0.8], random.standard_normal(y.shape)) * np.array([[0.002], [0.006]])
    return u, y + noise, dt


def fit(u, y, dt, pieces=2, start=START):
    """Return estimates and standard deviations, in the order of `NAMES`; samples of `y` that are NaN are left out."""
    good = np.isfinite(y)
    measured = np.where(good, y, 0.0)
    filters, scale = np.zeros((2, ORDER + 1)), np.ones(2)
    filters[:, 0] = 1.0

    def left(q):
        return np.where(good, measured - ship(q, u, dt, pieces), 0.0)

    def whitened(q):
        white = [lfilter(a, [1.0], e)[ORDER:] / s for a, e, s in zip(filters, left(q), scale, strict=True)]
        return np.concatenate(white)

    q = np.array(start, dtype=float)
    for _ in range(4):
        size = np.maximum(np.abs(q), 0.05)
        found = least_squares(whitened, q, bounds=BOUNDS, x_scale=size, ftol=1e-9, xtol=1e-9, max_nfev=60)
        q = found.x
        for k, e in enumerate(left(q)):
            r = np.array([e[: len(e) - lag] @ e[lag:] for lag in range(ORDER + 1)])
            filters[k, 1:] = -solve_toeplitz(r[:-1], r[1:])
            scale[k] = lfilter(filters[k], [1.0], e).std()
    return q, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def main():
    """Fit one made trial and print it beside the truth."""
    u, y, dt = trial()
    ship(START, u[:10], dt, 2)
    begin = time.perf_counter()
    q, deviation = fit(u, y, dt)
    print(f"{len(u)} samples, {time.perf_counter() - begin:.2f} s")
    for name, value, std, true in zip(NAMES, q, deviation, TRUTH, strict=True):
        print(f"{name:10} {value:9.5f} +- {std:.5f}   truth {true:g}, off by {(value - true) / std:+.1f}")


if __name__ == "__main__":
    main()
