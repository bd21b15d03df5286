"""The ship model with its derivatives, against forward differences of a Numba twin.

Build with `maturin develop --release`, then `python -m benches.bench_ship`.

All times are nanoseconds a sample of a chirp of 25,000 samples at 50 Hz, outputs dn and dM_g, first-order hold, one thread.
The machine's own limit is the time of the multiply-adds that five terms of two states and eight derivatives need, at the
rate at which a matrix product of NumPy does them.
"""

import argparse
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from benches.timing import in_turn, print_table, spread
from shipfp_rs import _core

Array = NDArray[np.float64]

DT = 0.02
NAMES = _core.SHIP_PARAMETERS
OUTPUTS = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_g")]
EIGHT = [NAMES.index(name) for name in ("tau_n", "g", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set")]
TWELVE = EIGHT + [NAMES.index(name) for name in ("s_M", "s_u", "initial_N", "initial_F")]
NO_LOAD = np.zeros(0)
MULTIPLY_ADDS = 2 * 9 * (5 * 6 // 2 + 5)
"""Of a step: for two states and nine columns the products of five terms with each other, and their sums."""


def ship(**changes: float) -> Array:
    values = dict.fromkeys(NAMES, 0.0) | {
        "tau_n": 1.5,
        "g": -0.583,
        "v": 1.0,
        "K_p": 6.33,
        "K_i": 1.583,
        "p": 2.17,
        "tau_prop": 1.0,
        "M_max": np.inf,
        "M_min": -np.inf,
        "rate_up": np.inf,
        "rate_down": np.inf,
        "X_max": np.inf,
        "X_min": -np.inf,
        "s_u": 1.0,
        "s_M": 1.0,
        "initial_N": 1.0,
    }
    return np.array([(values | changes)[name] for name in NAMES])


def chirp(samples: int) -> Array:
    t = DT * np.arange(samples)
    return 1.0 + 0.05 * np.sin(2.0 * np.pi * (0.01 * t + 0.5 * t * t * 0.99 / t[-1]))


@numba.njit(fastmath=True)
def numba_twin(q: Array, u: Array) -> Array:
    """Classical Runge-Kutta steps of one sample, the past by straight lines: less accurate than the kernel, and simple."""
    tau_n, g, v, K_p, K_i, p, tau_prop, T_d, T_set = q
    count = u.size
    past, out = np.zeros(count + 1), np.zeros((2, count))
    N, total = 1.0, 0.0
    k1n = ke = sn = se = 0.0
    for k in range(count):
        for stage in range(4):
            c = 0.5 * ((stage + 1) // 2)
            y = N if stage == 0 else N + c * DT * k1n
            z = total if stage == 0 else total + c * DT * ke
            at = k + c - T_set / DT
            i = int(np.floor(at))
            w = (
                u[0]
                if i < 0
                else u[min(i, count - 1)] + (at - i) * (u[min(i + 1, count - 1)] - u[min(i, count - 1)])
            )
            e = w - y
            X = K_p * e + K_i * z
            if stage == 0:
                past[k] = X
            if T_d > 0.0:
                at = k + c - T_d / DT
                i = int(np.floor(at))
                X = past[0] if i < 0 else past[i] + (at - i) * (past[min(i + 1, k)] - past[i])
            k1n = (1.0 + g * (y - 1.0) + v * X - y**p) / tau_n
            ke = e
            if stage == 0:
                sn, se = k1n, ke
                out[0, k] = y - 1.0
                out[1, k] = y**p + tau_prop * k1n - 1.0
            elif stage < 3:
                sn += 2.0 * k1n
                se += 2.0 * ke
            else:
                sn += k1n
                se += ke
        N += DT / 6.0 * sn
        total += DT / 6.0 * se
    return out


def differences(q: Array, u: Array) -> Array:
    """Forward differences along the eight."""
    base, rows = numba_twin(q, u), []
    for at in (0, 1, 3, 4, 5, 6, 7, 8):
        moved = q.copy()
        moved[at] += 1e-6
        rows.append((numba_twin(moved, u) - base) / 1e-6)
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmark the ship model")
    parser.add_argument("--quick", action="store_true", help="a short record, just to see that it runs")
    quick = parser.parse_args().quick
    samples, rounds = (2_000, 3) if quick else (25_000, 15)
    u = chirp(samples)
    # The same ship in all; less of its inertia behind the shaft that twists, or its governor would make it swing.
    parameters = ship(T_d=0.1213, T_set=0.0351)
    q = parameters[
        [NAMES.index(name) for name in ("tau_n", "g", "v", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set")]
    ]
    measured, offsets = np.zeros((2, samples)), np.zeros(2)
    filters = np.full((2, 9), 0.1)
    filters[:, 0] = 1.0
    A = np.random.default_rng(1).normal(size=(256, 256))

    def values(wrt: list[int]) -> Callable[[], object]:
        return lambda: _core.ship_sensitivities(parameters, u, NO_LOAD, DT, 0, "first", OUTPUTS, wrt)

    def products(wrt: list[int], ship: Array = parameters, *, sharp: bool = True) -> Callable[[], object]:
        return lambda: _core.ship_products(
            ship, u, NO_LOAD, DT, 0, "first", OUTPUTS, measured, offsets, filters, wrt, sharp
        )

    def other(**changes: float) -> Callable[[], object]:
        return products(TWELVE, ship(T_d=0.1213, T_set=0.0351, **changes), sharp=False)

    expected = numba_twin(q, u)
    found = _core.simulate_ship(parameters, u, NO_LOAD, DT, 0, "first", OUTPUTS)
    np.testing.assert_allclose(found[0], expected[0], atol=2e-3 * np.abs(expected[0]).max())
    calls: dict[str, Callable[[], object]] = {
        "signals": values([]),
        "signals and 8 derivatives": values(EIGHT),
        "residual sums, 9 taps": products([]),
        "Gauss-Newton sums, 12 derivatives, 9 taps": products(TWELVE),
        "the same on the way to a minimum": products(TWELVE, sharp=False),
        "with an actuator lag of 60 ms": other(tau_act=0.06),
        "with a shaft that twists at 10 Hz": other(tau_prop=0.4, tau_twist=8.6e-4, zeta_twist=1.0),
        "with a governor that samples at 50 Hz": other(T_s=0.02),
        "with a torque limit that acts": other(M_max=1.1),
        "Numba, signals": lambda: numba_twin(q, u),
        "Numba, 8 forward differences": lambda: differences(q, u),
        "product of matrices": lambda: A @ A,
    }
    times = in_turn(calls, rounds)
    per_sample = {name: np.array(seconds) / samples * 1e9 for name, seconds in times.items()}
    limit = min(times["product of matrices"]) / 256**3 * MULTIPLY_ADDS * 1e9
    print_table(
        ["ns a sample", "median [quartiles]", "least"],
        [
            [name, spread(list(per_sample[name])), f"{per_sample[name].min():.1f}"]
            for name in list(calls)[:-1]
        ],
    )
    print("lag, twist, sampling and limit: 12 derivatives, 9 taps, on the way to a minimum")
    ratios = per_sample["Numba, 8 forward differences"] / per_sample["signals and 8 derivatives"]
    print(f"Numba's forward differences over the derivatives: {spread(list(ratios))}")
    print(f"multiply-adds of one step at the machine's rate: {limit:.1f} ns")


if __name__ == "__main__":
    main()
