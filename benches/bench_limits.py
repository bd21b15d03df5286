"""What limits take off a ship, by the engine's side alone: `python -m benches.bench_limits`, release build.

A call follows governor, actuator, rate and torque limit for 500 s of set point and speed at 50 Hz as they were measured; a
step of a search takes one for each parameter. Beside it what a user would write in Numba, without delays between samples,
and the two simulations of the ship, with limits and without, that tell the same of the whole.
"""

import numpy as np
from numba import njit
from tests.twins.ship import vector as ship

from benches.timing import asked, in_turn, print_table
from shipfp_rs import _core

RATE_HZ, FINE = 50.0, 2
KNOWN = {
    "g": -0.6,
    "vK_p": 4.0,
    "vK_i": 5.0,
    "T_d": 0.06,
    "tau_act": 0.05,
    "rate": 0.4,
    "rate_down": 0.4,
    "M_max": 1.1,
    "s_M": 1.0,
    "leads": 1.0,
}


@njit
def by_numba(u, n, m, h, g, gain, integral, dead, lag, rate, highest, leads):
    """The same by Euler's rule, the dead time in whole samples."""
    found, back, stays = np.empty_like(n), int(dead / h + 0.5), np.exp(-h / lag)
    total = m[0] - g * n[0] - gain * (u[0] - n[0])
    free = rack = gain * (u[0] - n[0]) + total
    for k in range(len(n)):
        late = max(k - back, 0)
        error = u[late] - n[late]
        total += integral * error * h
        command = gain * error + total
        free = command + (free - command) * stays
        rack += min(max((command - rack) * (1.0 - stays), -rate * h), rate * h)
        whole = 1.0 + g * n[k] + rack
        given = min(whole, highest)
        found[k] = given - whole + rack - free
        beyond = (1.0 + m[k] - given) * leads * h
        total += beyond
        rack += beyond
        free += beyond
    return found


def main() -> None:
    options = asked(__doc__.splitlines()[0], {"seconds": 50.0, "repeats": 2}, seconds=500.0, repeats=15)
    t = np.arange(round(options.seconds * RATE_HZ * FINE)) / (RATE_HZ * FINE)
    u = 0.03 * np.sin(2.0 * np.pi * 0.05 * t * (1.0 + 0.005 * t))
    values = {"v": 1.0, "g": -0.6, "K_p": 4.0, "K_i": 5.0, "T_d": 0.06, "tau_act": 0.05}
    limited, free = (
        ship(**values | limits) for limits in ({"M_max": 1.1, "rate_up": 0.4, "rate_down": 0.4}, {})
    )
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b")]

    def simulated(parameters: np.ndarray) -> np.ndarray:
        return _core.simulate_ship(
            parameters, 1.0 + u, np.empty(0), 1.0 / (RATE_HZ * FINE), 0, "first", outputs
        )

    speed, torque = (np.ascontiguousarray(row[::FINE]) for row in simulated(limited))
    coarse, h = np.ascontiguousarray(u[::FINE]), 1.0 / RATE_HZ
    parameters = np.array([KNOWN.get(name, 0.0) for name in _core.ENGINE_SIDE_PARAMETERS])
    calls = {
        "ours": lambda: _core.taken_by_limits(parameters, coarse, speed, torque, h),
        "Numba, Euler": lambda: by_numba(coarse, speed, torque, h, -0.6, 4.0, 5.0, 0.06, 0.05, 0.4, 1.1, 1.0),
        "two simulations": lambda: (simulated(limited), simulated(free)),
    }
    times = {name: float(np.median(every)) for name, every in in_turn(calls, options.repeats).items()}
    rows = [
        (name, f"{1e3 * time:.3f}", f"{1e9 * time / len(coarse):.1f}", f"{time / times['ours']:.2f}")
        for name, time in times.items()
    ]
    print_table((f"{options.seconds:g} s at {RATE_HZ:g} Hz", "ms", "ns a sample", "over ours"), rows)


if __name__ == "__main__":
    main()
