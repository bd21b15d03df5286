"""The ship's steps against a Numba twin of the same model at the same step.

Build with `maturin develop --release`, then `python -m benches.bench_ship`.

All times are nanoseconds a step of 5 ms, four to a sample of a chirp at 50 Hz, outputs dn and dM_g, first-order hold, one
thread.
"""

import argparse
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from benches.timing import in_turn, print_table, spread
from shipfp_rs import _core

Array = NDArray[np.float64]

DT, SUBSTEPS = 0.02, 4
NAMES = _core.SHIP_PARAMETERS
OUTPUTS = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_g")]
OF_TWIN = ["tau_n", "g", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set", "tau_act", "s_u", "s_M", "initial_N"]
NO_LOAD = np.zeros(0)
SHIP = {
    "tau_n": 1.5, "g": -0.583, "v": 1.0, "K_p": 6.33, "K_i": 1.583, "p": 2.17, "tau_prop": 1.0, "T_d": 0.1213,
    "T_set": 0.0351, "tau_act": 0.06,
}  # fmt: skip
SHIPS: dict[str, dict[str, float]] = {
    "both dead times and a lag": {},
    "torque and rate limits, too": {"M_max": 1.1, "rate_up": 0.8, "rate_down": 0.8},
    "a governor that samples at 50 Hz": {"T_s": 0.02},
    "a shaft that twists at 10 Hz": {"tau_prop": 0.4, "tau_twist": 8.6e-4, "zeta_twist": 1.0},
}


def vector(**changes: float) -> Array:
    values = dict(zip(NAMES, _core.SHIP_OFF, strict=True)) | SHIP | changes
    return np.array([float(values[name]) for name in NAMES])


def chirp(samples: int) -> Array:
    t = DT * np.arange(samples)
    return 1.0 + 0.05 * np.sin(2.0 * np.pi * (0.01 * t + 0.5 * t * t * 0.99 / t[-1]))


@numba.njit(fastmath=True)
def numba_twin(q: Array, u: Array, h: float, substeps: int) -> Array:
    """Heun's steps, the lag exact for a command that stands at its mean, dead times by straight lines."""
    tau_n, g, k_p, k_i, p, tau_prop, T_d, T_set, tau_act, s_u, s_M, N = q
    steps = (u.size - 1) * substeps
    command, out = np.zeros(steps + 2), np.zeros((2, u.size))
    stays = np.exp(-h / tau_act)
    late, delay = T_d / h, T_set / h
    A = total = 0.0
    total = -k_p * (s_u * u[0] - N) / k_i
    for step in range(steps + 1):
        at = max((step - delay) / substeps, 0.0)
        i = int(at)
        e = s_u * (u[i] + (at - i) * (u[min(i + 1, u.size - 1)] - u[i])) - N
        command[step] = k_p * e + k_i * total
        at = max(step + 0.5 - late, 0.0)
        i = int(at)
        X = command[i] + (at - i) * (command[min(i + 1, step)] - command[i])
        law = N**p
        rate = (1.0 + g * (N - 1.0) + A - law) / tau_n
        if step % substeps == 0:
            out[0, step // substeps] = N - 1.0
            out[1, step // substeps] = s_M * (law + tau_prop * rate) - 1.0
        A = X + (A - X) * stays
        ahead = N + h * rate
        total += h * (e - 0.5 * h * rate)
        N += 0.5 * h * (rate + (1.0 + g * (ahead - 1.0) + A - ahead**p) / tau_n)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmark the ship model")
    parser.add_argument("--quick", action="store_true", help="a short record, just to see that it runs")
    quick = parser.parse_args().quick
    samples, rounds = (2_000, 3) if quick else (25_000, 15)
    u, h, steps = chirp(samples), DT / SUBSTEPS, (samples - 1) * SUBSTEPS
    q = vector()[[NAMES.index(name) for name in OF_TWIN]]

    def kernel(**changes: float) -> Callable[[], object]:
        ship = vector(**changes)
        return lambda: _core.simulate_ship(ship, u, NO_LOAD, DT, SUBSTEPS, "first", OUTPUTS)

    expected = numba_twin(q, u, h, SUBSTEPS)
    found = _core.simulate_ship(vector(), u, NO_LOAD, DT, SUBSTEPS, "first", OUTPUTS)
    np.testing.assert_allclose(found, expected, atol=1e-2 * np.abs(expected).max())
    calls = {name: kernel(**changes) for name, changes in SHIPS.items()}
    calls["Numba"] = lambda: numba_twin(q, u, h, SUBSTEPS)
    times = {name: np.array(seconds) for name, seconds in in_turn(calls, rounds).items()}
    print_table(
        ["ns a step", "median [quartiles]", "least", "steps a ms"],
        [
            [
                name,
                spread(list(seconds / steps * 1e9)),
                f"{seconds.min() / steps * 1e9:.1f}",
                f"{steps / seconds.min() / 1e3:,.0f}",
            ]
            for name, seconds in times.items()
        ],
    )
    ratios = times["Numba"] / times[next(iter(SHIPS))]
    print(f"Numba over the first of them: {spread(list(ratios))}")


if __name__ == "__main__":
    main()
