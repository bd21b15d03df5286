"""The plant, as a ship by RK4, beside a scalar Numba twin: `python -m benches.bench_plant`, with a release build installed.

A run of the launch in RK4, zero hold. "steps" counts integration steps; with one step a sample the time holds the
writing of four rows, with ten it is nearly the arithmetic alone.
"""

import argparse
import math

import numpy as np
from numba import njit

from benches.timing import median_time, print_table
from shipfp_rs import _core

PARAMETERS = np.array(
    [21.2, 3.0, 0.95, 27.0, -6.0, 0.0, 12.18, 2.0, 13.07, 6.03, 0.603, -np.inf],
)
DT = 0.01
INITIAL = np.array([1300.0 / 180.0, 0.0])
ENVELOPE = (
    np.array([10.0, 15.0, 18.0, 21.0, 25.0, 30.0]),
    np.array([100.0, 300.0, 450.0, 460.0, 450.0, 300.0]),
)
UNLIMITED = (np.empty(0), np.empty(0))
CASES = {
    "p = 2": (2.0, UNLIMITED),
    "p = 2, envelope of 6 points": (2.0, ENVELOPE),
    "p = 2.17": (2.17, UNLIMITED),
    "p = 2.17, envelope of 6 points": (2.17, ENVELOPE),
}


@njit(inline="always")
def interpolate(x, speed, limit):
    """The envelope by a search from the left; `np.interp` allocates in Numba and takes ten times as long."""
    last = speed.size - 1
    if x <= speed[0]:
        return limit[0]
    if x >= speed[last]:
        return limit[last]
    i = 0
    while x >= speed[i + 1]:
        i += 1
    return limit[i] + (limit[i + 1] - limit[i]) / (speed[i + 1] - speed[i]) * (x - speed[i])


@njit(inline="always")
def torque(q, speed, limit, n_set, n_s, E_n):
    """Brake torque, as one would write it."""
    n_e = q[1] * n_s
    M_b = q[3] * (q[8] + q[9] * (n_set - n_e) + q[10] * E_n) + q[4] * n_e + q[5]
    if speed.size:
        M_b = min(M_b, interpolate(n_e, speed, limit))
    return max(M_b, q[11])


@njit(inline="always")
def acceleration(q, M_b, n_s):
    """Rate of the shaft speed; the square without a power function, as the kernel has it."""
    M_p = q[6] * n_s * abs(n_s) if q[7] == 2.0 else q[6] * math.copysign(abs(n_s) ** q[7], n_s)
    return (M_b * q[1] * q[2] - M_p) / (2.0 * math.pi * q[0])


@njit
def simulate(q, speed, limit, n_set, dt, substeps, initial, out):
    """RK4 with zero hold."""
    n, E = initial
    h = dt / substeps
    for k in range(n_set.size):
        u = n_set[k]
        out[0, k], out[1, k] = n, E
        out[2, k] = q[8] + q[9] * (u - q[1] * n) + q[10] * E
        out[3, k] = torque(q, speed, limit, u, n, E)
        for _ in range(substeps):
            a1, b1 = acceleration(q, torque(q, speed, limit, u, n, E), n), u - q[1] * n
            n2, E2 = n + h / 2 * a1, E + h / 2 * b1
            a2, b2 = acceleration(q, torque(q, speed, limit, u, n2, E2), n2), u - q[1] * n2
            n3, E3 = n + h / 2 * a2, E + h / 2 * b2
            a3, b3 = acceleration(q, torque(q, speed, limit, u, n3, E3), n3), u - q[1] * n3
            n4, E4 = n + h * a3, E + h * b3
            a4, b4 = acceleration(q, torque(q, speed, limit, u, n4, E4), n4), u - q[1] * n4
            n += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            E += h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)


def by_the_ship(q, envelope, n_set, substeps):
    """The kernel of the ship, for the plant divided by its steady state at 1300 rpm; rows n_s, E_n, X_f, M_b."""
    n_e, gear = 1300.0 / 60.0, q[1] * q[2]
    torque = q[6] * (n_e / q[1]) ** q[7] / gear
    rack = (torque - q[4] * n_e - q[5]) / q[3]
    names = _core.SHIP_PARAMETERS
    values = dict(zip(names, _core.SHIP_OFF, strict=True)) | {
        "tau_n": 2.0 * math.pi * q[0] * n_e / q[1] / (torque * gear),
        "g": q[4] * n_e / torque,
        "v": q[3] * rack / torque,
        "K_p": q[9] * n_e / rack,
        "K_i": q[10] * n_e / rack,
        "p": q[7],
    }
    start = np.array([INITIAL[0] * q[1], INITIAL[1] + (q[8] - rack) / q[10]]) / n_e
    limit = np.array([envelope[0] / n_e, envelope[1] / torque])
    vector = np.array([values[name] for name in names])
    rows = _core.simulate_ship_by(
        vector, n_set / n_e, DT, substeps, "rk4", "zero", start, [0, 4, 3, 1], limit
    )
    scale = np.array([[n_e / q[1]], [n_e], [rack], [torque]])
    return rows * scale + np.array([[n_e / q[1]], [(rack - q[8]) / q[10]], [rack], [torque]])


def measure(samples: int, substeps: int) -> list[list[str]]:
    """One row a case: nanoseconds a step, Numba's first, then ours with the ratio."""
    rows = []
    n_set = 1300.0 / 60.0 * (1.0 + 0.05 * np.sin(np.arange(samples) * DT))
    for name, (exponent, envelope) in CASES.items():
        parameters = PARAMETERS.copy()
        parameters[7] = exponent

        def twin(parameters=parameters, envelope=envelope):
            out = np.empty((4, samples))
            simulate(parameters, *envelope, n_set, DT, substeps, INITIAL, out)
            return out

        def kernel(parameters=parameters, envelope=envelope):
            return by_the_ship(parameters, envelope, n_set, substeps)

        np.testing.assert_allclose(kernel(), twin(), rtol=1e-9, atol=1e-9)
        numba, ours = (median_time(call) * 1e9 / (samples * substeps) for call in (twin, kernel))
        rows.append([name, f"{substeps}", f"{numba:.2f}", f"{ours:.2f}", f"{numba / ours:.1f}x"])
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Benchmark the plant kernel")
    parser.add_argument("--quick", action="store_true", help="short runs, just to see that it runs")
    samples = 2_000 if parser.parse_args().quick else 20_000
    print(f"One run of {samples:,} samples, ns a step")
    print_table(
        ["", "steps a sample", "numba", "kernel", "faster"],
        [row for steps in (1, 10) for row in measure(samples, steps)],
    )


if __name__ == "__main__":
    main()
