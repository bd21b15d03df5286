"""Cost of the linear structure against SciPy and Numba.

Build with `maturin develop --release`, then `python -m benches.bench_cost`.

All times are nanoseconds a sample of the record, two outputs (speed and engine torque), first-order hold. Ours is
`linear_products`, the pass of a search: it gives the cost for any weights, with offsets of the outputs beside it.
"""

import argparse
from collections.abc import Callable

import numba
import numpy as np
import scipy.linalg
import scipy.signal
from numpy.typing import NDArray

from benches.timing import median_time, print_table
from shipfp_rs import _core

Array = NDArray[np.float64]
Cost = Callable[[Array], float]

DT = 0.01
OUTPUTS, START, NO_FILTERS = [0, 2], np.zeros(2), np.ones((2, 1))
FIVE, SEVEN = [0, 1, 2, 3, 4], [0, 1, 2, 3, 4, 7, 8]
LAUNCH = np.array([1.5, -0.583, 1.583, 4.0, 1.0, 2.0, 1.0, 0.0, 0.0])
DEAD_TIMES = LAUNCH + np.array([0, 0, 0, 0, 0, 0, 0, 0.12, 0.035])


def padé(order: int, T: float) -> tuple[Array, Array, Array]:
    """Legendre delay network, Voelker and Eliasmith 2018."""
    i, j = np.mgrid[:order, :order]
    A = (2 * i + 1) * np.where(i < j, -1.0, (-1.0) ** (i - j + 1)) / T
    k = np.arange(order)
    return A, (2 * k + 1) * (-1.0) ** k / T, np.ones(order)


def state_space(parameters: Array) -> tuple[Array, Array, Array, Array]:
    """Continuous states from (u1, u2) to (dn, dM_b)."""
    tau_n, g, v, K_p, K_i, p, _, T_d, _ = parameters
    a, b, c = (p - g) / tau_n, v * K_p / tau_n, v * K_i / tau_n
    if T_d == 0:
        A = np.array([[-a - b, c], [-1.0, 0.0]])
    else:
        network, into, out = padé(6, T_d)
        A = np.zeros((8, 8))
        A[0, 0], A[1, 0], A[0, 2:], A[2:, 2:] = -a, -1.0, out, network
        A[2:, 0], A[2:, 1] = -b * into, c * into
    B = np.zeros((len(A), 2))
    B[0, 1], B[1, 0] = b, 1.0
    torque = tau_n * A[0]
    torque[0] += p
    return A, B, np.vstack([np.eye(len(A))[0], torque]), np.array([[0.0, 0.0], [0.0, tau_n * b]])


def delayed(dn_set: Array, delay: float) -> Array:
    """Linear interpolation of the late set point at the samples: SciPy knows no corner inside one."""
    position = np.arange(dn_set.size) - delay / DT
    return np.interp(position, np.arange(dn_set.size), dn_set)


def lsim_cost(parameters: Array, dn_set: Array, measured: Array) -> float:
    inputs = np.column_stack([delayed(dn_set, parameters[8]), delayed(dn_set, parameters[7] + parameters[8])])
    _, simulated, _ = scipy.signal.lsim(state_space(parameters), inputs, np.arange(dn_set.size) * DT)
    return float(((measured - simulated.T) ** 2).sum())


def lfilter_cost(parameters: Array, dn_set: Array, measured: Array) -> float:
    A, B, C, D = state_space(parameters)
    discrete = scipy.signal.cont2discrete(
        (A, B.sum(axis=1, keepdims=True), C, D.sum(axis=1, keepdims=True)), DT, "foh"
    )
    numerators, denominator = scipy.signal.ss2tf(*discrete[:4])
    simulated = np.array([scipy.signal.lfilter(numerator, denominator, dn_set) for numerator in numerators])
    return float(((measured - simulated) ** 2).sum())


@numba.njit(fastmath=False)
def numba_loop(Phi: Array, Gamma: Array, C: Array, D: Array, u1: Array, u2: Array, measured: Array) -> float:
    order = Phi.shape[0]
    x, following = np.zeros(order), np.zeros(order)
    cost = 0.0
    for k in range(u1.size):
        for output in range(C.shape[0]):
            y = D[output, 0] * u1[k] + D[output, 1] * u2[k]
            for i in range(order):
                y += C[output, i] * x[i]
            cost += (measured[output, k] - y) ** 2
        late = min(k + 1, u1.size - 1)
        for i in range(order):
            total = (
                Gamma[i, 0] * u1[k] + Gamma[i, 1] * u2[k] + Gamma[i, 2] * u1[late] + Gamma[i, 3] * u2[late]
            )
            for j in range(order):
                total += Phi[i, j] * x[j]
            following[i] = total
        x[:] = following
    return cost


def numba_cost(parameters: Array, dn_set: Array, measured: Array) -> float:
    A, B, C, D = state_space(parameters)
    n = len(A)
    augmented = np.zeros((n + 4, n + 4))
    augmented[:n, :n], augmented[:n, n : n + 2] = A * DT, B * DT
    augmented[n : n + 2, n + 2 :] = np.eye(2)
    exponential = scipy.linalg.expm(augmented)
    ramp = exponential[:n, n + 2 :]
    Gamma = np.hstack([exponential[:n, n : n + 2] - ramp, ramp])
    u1, u2 = delayed(dn_set, parameters[8]), delayed(dn_set, parameters[7] + parameters[8])
    return float(numba_loop(np.ascontiguousarray(exponential[:n, :n]), Gamma, C, D, u1, u2, measured))


def products(parameters: Array, dn_set: Array, measured: Array, wrt: list[int]) -> Array:
    """Sums of products of derivatives, offsets and residuals, as a search has them."""
    return _core.linear_products(
        parameters, dn_set, DT, "first", START, OUTPUTS, measured, np.zeros(2), NO_FILTERS, wrt
    )[0]


def differences(cost: Cost, parameters: Array, wrt: list[int]) -> Array:
    """Forward differences of the cost: a gradient, but no Gauss-Newton matrix."""
    base = cost(parameters)
    step = 1e-6
    return np.array([(cost(parameters + step * row) - base) / step for row in np.eye(9)[wrt]])


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmark the cost kernel")
    parser.add_argument("--quick", action="store_true", help="short records, just to see that it runs")
    short = parser.parse_args().quick
    count, few = (3_000, 300) if short else (150_000, 15_000)
    rng = np.random.default_rng(804)
    dn_set = np.cumsum(rng.normal(size=count)) * 1e-3
    dn_set -= dn_set[0]
    measured = {}
    for name, parameters in (("none", LAUNCH), ("both", DEAD_TIMES)):
        values = _core.simulate_linear(parameters, dn_set, DT, "first", START, OUTPUTS)
        measured[name] = values + rng.normal(scale=1e-3, size=values.shape)

    def kernel(parameters: Array, wrt: list[int], name: str) -> Callable[[], object]:
        return lambda: products(parameters, dn_set, measured[name], wrt)

    def rival(
        cost: Callable[[Array, Array, Array], float],
        parameters: Array,
        wrt: list[int],
        name: str,
        samples: int,
    ):
        record, values = dn_set[:samples], np.ascontiguousarray(measured[name][:, :samples])
        if not wrt:
            return lambda: cost(parameters, record, values)
        return lambda: differences(lambda x: cost(x, record, values), parameters, wrt)

    def check() -> None:
        """All of them compute the same cost, but for the corners that SciPy rounds off."""
        sums = products(LAUNCH, dn_set, measured["none"], [])
        expected = sums[0, -1, 0, -1] + sums[1, -1, 1, -1]
        for cost in (lfilter_cost, lsim_cost, numba_cost):
            np.testing.assert_allclose(cost(LAUNCH, dn_set, measured["none"]), expected, rtol=1e-6)

    check()
    cases = [
        ("cost", LAUNCH, [], "none"),
        ("cost, gradient, Gauss-Newton by 5", LAUNCH, FIVE, "none"),
        ("cost, both dead times", DEAD_TIMES, [], "both"),
        ("cost, gradient, Gauss-Newton by 7, both dead times", DEAD_TIMES, SEVEN, "both"),
    ]
    rows = []
    for title, parameters, wrt, name in cases:
        times = [median_time(kernel(parameters, wrt, name)) / count]
        times.append(
            median_time(rival(lfilter_cost, parameters, wrt, name, count)) / count
            if name == "none"
            else np.nan
        )
        times.append(median_time(rival(lsim_cost, parameters, wrt, name, few), 3) / few)
        times.append(median_time(rival(numba_cost, parameters, wrt, name, count), 3) / count)
        rows.append([title, *("-" if np.isnan(time) else f"{1e9 * time:.1f}" for time in times)])
    one_filter = median_time(lambda: scipy.signal.lfilter([0.0, 0.1, 0.05], [1.0, -1.5, 0.6], dn_set)) / count
    rows.append(["one lfilter call of order 2, nothing else", "", f"{1e9 * one_filter:.1f}", "", ""])
    print_table(["ns a sample", "shipfp_rs", "SciPy lfilter", "SciPy lsim", "Numba"], rows)
    print("Gradients of SciPy and Numba are forward differences, without a Gauss-Newton matrix.")


if __name__ == "__main__":
    main()
