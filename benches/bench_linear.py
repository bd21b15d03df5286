"""Outputs and derivatives of the linear structure against SciPy and Numba.

Build with `maturin develop --release`, then `python -m benches.bench_linear`.

All times are nanoseconds a sample of the record, two outputs (speed and engine torque), first-order hold. Ours are
the equations of `Structure.linear`, matrices and discretisation included, as a fit calls them.
"""

import argparse
from collections.abc import Callable

import numba
import numpy as np
import scipy.linalg
import scipy.signal
from numpy.typing import NDArray

from benches.timing import median_time, print_table
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.state_space import LinearEquations

Array = NDArray[np.float64]
Outputs = Callable[[Array, Array], Array]

DT = 0.01
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


def lsim_outputs(parameters: Array, dn_set: Array) -> Array:
    inputs = np.column_stack([delayed(dn_set, parameters[8]), delayed(dn_set, parameters[7] + parameters[8])])
    return scipy.signal.lsim(state_space(parameters), inputs, np.arange(dn_set.size) * DT)[1].T


def lfilter_outputs(parameters: Array, dn_set: Array) -> Array:
    A, B, C, D = state_space(parameters)
    discrete = scipy.signal.cont2discrete(
        (A, B.sum(axis=1, keepdims=True), C, D.sum(axis=1, keepdims=True)), DT, "foh"
    )
    numerators, denominator = scipy.signal.ss2tf(*discrete[:4])
    return np.array([scipy.signal.lfilter(numerator, denominator, dn_set) for numerator in numerators])


@numba.njit(fastmath=False)
def numba_loop(Phi: Array, Gamma: Array, C: Array, D: Array, u1: Array, u2: Array) -> Array:
    order = Phi.shape[0]
    x, following = np.zeros(order), np.zeros(order)
    out = np.empty((C.shape[0], u1.size))
    for k in range(u1.size):
        for output in range(C.shape[0]):
            y = D[output, 0] * u1[k] + D[output, 1] * u2[k]
            for i in range(order):
                y += C[output, i] * x[i]
            out[output, k] = y
        late = min(k + 1, u1.size - 1)
        for i in range(order):
            total = (
                Gamma[i, 0] * u1[k] + Gamma[i, 1] * u2[k] + Gamma[i, 2] * u1[late] + Gamma[i, 3] * u2[late]
            )
            for j in range(order):
                total += Phi[i, j] * x[j]
            following[i] = total
        x[:] = following
    return out


def numba_outputs(parameters: Array, dn_set: Array) -> Array:
    A, B, C, D = state_space(parameters)
    n = len(A)
    augmented = np.zeros((n + 4, n + 4))
    augmented[:n, :n], augmented[:n, n : n + 2] = A * DT, B * DT
    augmented[n : n + 2, n + 2 :] = np.eye(2)
    exponential = scipy.linalg.expm(augmented)
    ramp = exponential[:n, n + 2 :]
    Gamma = np.hstack([exponential[:n, n : n + 2] - ramp, ramp])
    u1, u2 = delayed(dn_set, parameters[8]), delayed(dn_set, parameters[7] + parameters[8])
    return numba_loop(np.ascontiguousarray(exponential[:n, :n]), Gamma, C, D, u1, u2)


EQUATIONS = LinearEquations(("dn", "dM"), gauge=False)
NAMES = ("tau_n", "g", "v", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set")


def outputs(parameters: Array, dn_set: Array) -> Array:
    """Both outputs by our equations, shape (2, N)."""
    return EQUATIONS.simulate(values_of(parameters), run_of(dn_set))


def derivatives(parameters: Array, dn_set: Array, wrt: list[int]) -> Array:
    """Their derivatives by our equations, shape (W, 2, N); the outputs are computed beside them."""
    names = [NAMES[place] for place in wrt]
    return EQUATIONS.sensitivities(values_of(parameters), run_of(dn_set), names)[1]


def values_of(parameters: Array) -> dict[str, float]:
    # Where a dead time is none it is not declared, as in a structure.
    return {name: value for name, value in zip(NAMES, parameters.tolist(), strict=True) if value}


def run_of(dn_set: Array) -> Experiment:
    return Experiment("run", 1.0 / DT, {"n_set": 1.0 + dn_set}, {"n_set": 1.0}, hold="first")


def differences(simulate: Outputs, parameters: Array, dn_set: Array, wrt: list[int]) -> Array:
    """Their forward differences by another way to simulate, shape (W, 2, N)."""
    base = simulate(parameters, dn_set)
    step = 1e-6
    return np.array([(simulate(parameters + step * row, dn_set) - base) / step for row in np.eye(9)[wrt]])


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmark the linear structure")
    parser.add_argument("--quick", action="store_true", help="short records, just to see that it runs")
    short = parser.parse_args().quick
    count, few = (3_000, 300) if short else (150_000, 15_000)
    dn_set = np.cumsum(np.random.default_rng(804).normal(size=count)) * 1e-3
    dn_set -= dn_set[0]

    def ours(parameters: Array, wrt: list[int]) -> Callable[[], object]:
        if not wrt:
            return lambda: outputs(parameters, dn_set)
        return lambda: derivatives(parameters, dn_set, wrt)

    def rival(simulate: Outputs, parameters: Array, wrt: list[int], samples: int) -> Callable[[], object]:
        record = dn_set[:samples]
        if not wrt:
            return lambda: simulate(parameters, record)
        return lambda: differences(simulate, parameters, record, wrt)

    expected = outputs(LAUNCH, dn_set)
    for simulate in (lfilter_outputs, lsim_outputs, numba_outputs):
        np.testing.assert_allclose(
            simulate(LAUNCH, dn_set), expected, rtol=0, atol=1e-9 * np.abs(expected).max()
        )
    cases = [
        ("outputs", LAUNCH, []),
        ("derivatives by 5", LAUNCH, FIVE),
        ("outputs, both dead times", DEAD_TIMES, []),
        ("derivatives by 7, both dead times", DEAD_TIMES, SEVEN),
    ]
    rows = []
    for title, parameters, wrt in cases:
        times = [
            median_time(ours(parameters, wrt)) / count,
            median_time(rival(lfilter_outputs, parameters, wrt, count)) / count
            if parameters is LAUNCH
            else np.nan,
            median_time(rival(lsim_outputs, parameters, wrt, few), 3) / few,
            median_time(rival(numba_outputs, parameters, wrt, count), 3) / count,
        ]
        rows.append([title, *("-" if np.isnan(time) else f"{1e9 * time:.1f}" for time in times)])
    one_filter = median_time(lambda: scipy.signal.lfilter([0.0, 0.1, 0.05], [1.0, -1.5, 0.6], dn_set)) / count
    rows.append(["one lfilter call of order 2, nothing else", "", f"{1e9 * one_filter:.1f}", "", ""])
    print_table(["ns a sample", "shipfp_rs", "SciPy lfilter", "SciPy lsim", "Numba"], rows)
    print("Derivatives of SciPy and Numba are forward differences.")


if __name__ == "__main__":
    main()
