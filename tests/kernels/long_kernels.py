"""`python -m tests.kernels.long_kernels NAME` runs a kernel with much to do, in little memory, until it is stopped.

`python -m tests.kernels.long_kernels NAME STOPS` stops it so often, and prints the longest processor time to its end.

`python -m tests.kernels.long_kernels all STOPS` does so with each kernel, soon after it has begun, a line a kernel.
"""

from __future__ import annotations

import random
import signal
import sys
import time
from collections.abc import Callable
from functools import cache

import numpy as np

from shipfp_rs import _core
from tests.twins import drive_train, engine_side, ship

KERNELS: dict[str, Callable[[], object]] = {
    "spin": lambda: _core._spin_for_test(),
    "simulate_ship_by": lambda: _core.simulate_ship_by(
        ship.vector(), np.ones(10_000), 0.01, 60_000, "rk4", "first", np.array([0.99, 0.0]), [0]
    ),
    "simulate_detailed_ship": lambda: _core.simulate_detailed_ship(
        ship.vector(T_d=0.05),
        drive_train.detail(),
        np.ones(6),
        np.empty((3, 0)),
        np.ones(1000),
        0.01,
        65_536,
        "first",
        [0],
    ),
    "simulate_ship": lambda: _core.simulate_ship(
        ship.vector(T_d=0.05, tau_act=0.05),
        1.0 + 0.02 * np.sin(np.arange(10_000_000) * 0.01),
        np.zeros(0),
        0.01,
        20,
        "first",
        [0, 2],
    ),
    "run_recursion": lambda: _core.run_recursion(
        np.full((8, 201, 201), 1e-3), np.zeros((8, 200)), np.ones(2_000_000), [0], 0.01
    ),
    "equation_products": lambda: _core.equation_products(
        np.array(
            [
                float(name in ("tau_n", "vK_p", "vK_i", "p", "v", "s_M", "s_B"))
                for name in _core.EQUATION_PARAMETERS
            ]
        ),
        *(np.zeros((8, 4, 2, 64_000)), 0.01, [(np.zeros((4, 2, 64_000)), 0.0)] * 2),
        *([0, 1], False, False, list(range(16)) * 30),
        *(np.zeros((2, 2, 2, 64_000)), np.zeros((0, 0, 2, 0)), np.zeros((0, 64_000))),
    ),
    "PulseTracker": lambda: _core.PulseTracker(6.0, 0.2).follow(_train_of_pulses(), 1 << 16),
    "pulse_levels": lambda: _core.pulse_levels(_train_of_pulses()),
    "pulses_are_even": lambda: _core.pulses_are_even(np.arange(60_000_000.0), 0.5, 2.0),
    "interval_speeds": lambda: _core.interval_speeds(
        np.arange(8_000_001.0),
        np.ones(8_000_000, dtype=np.int64),
        np.full(4, 0.25),
        np.full(4, 0.01),
        np.array([0.01]),
        np.array([0.1]),
        0.1,
    ),
    "taken_by_limits": lambda: _core.taken_by_limits(engine_side.vector(M_max=1.1), *(_noise(),) * 3, 0.01),
}
"""Of every kernel of `_core` a call that takes long; a test looks that none is missing."""
SAME = {
    "equation_residuals": "equation_products",
    "loop_is_stable": "equation_products",
}
"""Kernels that are another one without derivatives, or that it calls."""
SOON_S = 0.3
"""Longest processor time after which a kernel is stopped, where all of them are."""


@cache
def _noise() -> np.ndarray:
    return np.random.default_rng(0).standard_normal(20_000_000)


@cache
def _train_of_pulses() -> np.ndarray:
    return np.tile(np.sin(np.arange(3000) * 0.1) * 2.0 + 2.0, 10_000)


def longest_end(kernel: str, stops: int, within_s: float = 1.0) -> float:
    """Stop a kernel at so many processor times by chance, and return the longest one [s] that it went on for.

    The handler of a signal runs when the binding looks for one, and its interrupt asks the kernel to stop. What the process
    computes from then on is what the kernel computes until its next look. What else the machine does adds nothing.
    """
    asked = [0.0]

    def interrupt(*_: object) -> None:
        asked[0] = time.process_time()
        raise KeyboardInterrupt

    signal.signal(signal.SIGPROF, interrupt)
    chance = random.Random(1)
    longest = 0.0
    _noise(), _train_of_pulses()
    for _ in range(stops):
        try:
            signal.setitimer(signal.ITIMER_PROF, chance.uniform(0.001, within_s))
            while True:
                KERNELS[kernel]()
        except KeyboardInterrupt:
            longest = max(longest, time.process_time() - asked[0])
    return longest


def main() -> None:
    """Run the kernel that is named, again and again: a fast machine may be through with it in less than a second."""
    print("ready", flush=True)
    if sys.argv[1] == "all":
        for kernel in (kernel for kernel in KERNELS if kernel != "spin"):  # which sleeps
            print(kernel, longest_end(kernel, int(sys.argv[2]), SOON_S), flush=True)
        return
    if len(sys.argv) > 2:
        print(longest_end(sys.argv[1], int(sys.argv[2])))
        return
    while True:
        KERNELS[sys.argv[1]]()


if __name__ == "__main__":
    main()
