"""State spaces against scipy.signal.lsim and a numba loop over the same discretised model.

Build with `maturin develop --release`, then `python -m benches.bench_statespace`. All figures come from one run.
"""

import argparse
from types import SimpleNamespace

import numpy as np
from numba import njit
from scipy.signal import cont2discrete, lsim

from benches.timing import median_time, print_table
from shipfp_rs.structures.custom import MatrixEquations

DT = 0.01


def model(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(order)
    A = rng.normal(size=(order, order)) - 3 * np.eye(order)
    return A, rng.normal(size=order), rng.normal(size=(2, order)), np.zeros(2)


@njit(cache=False)
def step_through(phi: np.ndarray, gamma: np.ndarray, C: np.ndarray, u: np.ndarray) -> np.ndarray:
    order, outputs = len(gamma), len(C)
    y = np.empty((outputs, len(u)))
    x, following = np.zeros(order), np.zeros(order)
    for k in range(len(u)):
        for i in range(outputs):
            y[i, k] = 0.0
            for j in range(order):
                y[i, k] += C[i, j] * x[j]
        for i in range(order):
            following[i] = gamma[i] * u[k]
            for j in range(order):
                following[i] += phi[i, j] * x[j]
        x[:] = following
    return y


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="a short record, just to see that it runs")
    options = parser.parse_args()
    if options.quick:
        options.samples, options.repeats = 10_000, 1
    u = np.random.default_rng(1).normal(size=options.samples)
    run = SimpleNamespace(dn_set=u, rate_hz=1.0 / DT, hold="zero")
    rows = []
    for order in (2, 4, 8, 12):
        A, B, C, D = model(order)
        time = DT * np.arange(len(u))
        phi, gamma, *_ = cont2discrete((A, B[:, None], C, D[:, None]), DT, "zoh")
        calls = {
            "ours": lambda matrices=(A, B, C, D): MatrixEquations(
                lambda q: matrices, (), ("y1", "y2")
            ).simulate({}, run),
            "numba": lambda phi=phi, gamma=gamma[:, 0], C=C: step_through(phi, gamma, C, u),
            "SciPy": lambda A=A, B=B, C=C, D=D, time=time: (
                lsim((A, B[:, None], C, D[:, None]), u, time, interp=False)[1].T
            ),
        }
        for call in calls.values():
            np.testing.assert_allclose(call(), calls["ours"](), rtol=1e-8, atol=1e-10)
        times = {name: median_time(call, options.repeats) for name, call in calls.items()}
        for name, seconds in times.items():
            ratio = f"{seconds / times['ours']:.1f}"
            rows.append([f"{name}, {order} states", f"{seconds / len(u) * 1e9:.1f}", ratio])
    print_table(["case", "ns a sample", "times ours"], rows)


if __name__ == "__main__":
    main()
