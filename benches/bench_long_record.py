"""Time per sample of a long record over that of a short one, for every kernel that carries states.

States and derivatives that decay must not reach subnormal numbers, with which a processor computes many times slower. The
records are 100 s and 1600 s at 200 Hz; the set point moves in one case, and stands still after a second in the other.
`python -m benches.bench_long_record`, with a release build installed. Processor seconds of one thread, the least of the
repeats.

Fresh memory is no part of the question: what is freed is kept and used again, and sixteen short results are held at once,
so that they fill as much of it as the long one.
"""

import argparse
import contextlib
import ctypes
from collections.abc import Callable

import numpy as np

from benches.timing import in_turn, print_table, spread
from shipfp_rs import _core
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.state_space import LinearEquations

RATE_HZ = 200.0
SHORT_S, LONG_S = 100.0, 1600.0
POLES = {"slow": (1.5, 10.0, 1.0), "fast": (0.03, 1.0, 50.0)}
"""Time constant tau_n of the shaft [s], K_p, K_i: the slowest pole decays at 0.09 and at 23 per second."""


def set_point(moves: bool, samples: int) -> np.ndarray:
    """Relative deviation: a sine of 0.2 Hz, or a step of one second and nothing after it."""
    time = np.arange(samples) / RATE_HZ
    return 0.01 * np.sin(2.0 * np.pi * 0.2 * time) if moves else 0.01 * (time < 1.0)


def linear_calls(poles: str, dn_set: np.ndarray, dead_time: float) -> dict[str, Callable[[], object]]:
    tau_n, k_p, k_i = POLES[poles]
    values = {"tau_n": tau_n, "g": -0.583, "v": 1.583, "K_p": k_p, "K_i": k_i, "p": 2.0, "initial dn": 0.01}
    names = ["tau_n", "g", "v", "K_p", "K_i", "initial dn", "initial dE"]
    if dead_time:
        values["T_d"] = dead_time
    run = Experiment("run", RATE_HZ, {"n_set": 1.0 + dn_set}, {"n_set": 1.0}, hold="first")
    equations = LinearEquations(("dn", "dM"), gauge=False)
    name = f"linear structure{', dead time' if dead_time else ''}"
    return {name: lambda: equations.sensitivities(values, run, names)}


def ship_calls(poles: str, dn_set: np.ndarray) -> dict[str, Callable[[], object]]:
    tau_n, k_p, k_i = POLES[poles]
    names = _core.SHIP_PARAMETERS
    told = {
        "tau_n": tau_n,
        "g": -0.583,
        "v": 1.583,
        "K_p": k_p,
        "K_i": k_i,
        "p": 2.17,
        "tau_prop": 0.4 * tau_n,
    }
    values = dict(zip(names, _core.SHIP_OFF, strict=True)) | told | {"initial_N": 1.001}

    def simulation(**changes: float) -> Callable[[], object]:
        vector = np.array([float((values | changes)[name]) for name in names])
        return lambda: _core.simulate_ship(
            vector, 1.0 + dn_set, np.empty(0), 1.0 / RATE_HZ, 1, "first", [0, 2]
        )

    return {
        "simulate_ship": simulation(),
        "simulate_ship, lag and dead time": simulation(tau_act=0.005, T_d=0.004),
    }


def calls(poles: str, moves: bool, duration_s: float) -> dict[str, Callable[[], object]]:
    dn_set = set_point(moves, round(duration_s * RATE_HZ))
    return {
        **linear_calls(poles, dn_set, 0.0),
        **linear_calls(poles, dn_set, 0.05 if poles == "slow" else 0.004),
        **ship_calls(poles, dn_set),
    }


def keep_memory() -> None:
    """Have the C library keep what is freed, where it is glibc."""
    map_threshold, trim_threshold = -3, -1
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(map_threshold, 2**30)
        library.mallopt(trim_threshold, 2**31 - 1)


def measure(repeats: int, short_s: float, long_s: float, only: str = "") -> list[list[str]]:
    """Rows: kernel, poles, set point, ns a sample of the short record and of the long one, their ratio and its spread."""
    rows = []
    for poles in POLES:
        for moves in (True, False):
            short, long = calls(poles, moves, short_s), calls(poles, moves, long_s)
            for name in filter(lambda name: only in name, short):
                # As many samples in one turn: the clock is coarse.
                turns = round(long_s / short_s)

                def often(call: Callable[[], object] = short[name], turns: int = turns) -> list[object]:
                    return [call() for _ in range(turns)]

                times = in_turn({"short": often, "long": long[name]}, repeats)
                samples = long_s * RATE_HZ
                figures = [min(times[key]) / samples * 1e9 for key in ("short", "long")]
                ratios = [late / early for late, early in zip(times["long"], times["short"], strict=True)]
                rows.append(
                    [
                        name,
                        poles,
                        "moves" if moves else "stands",
                        *(f"{figure:.1f}" for figure in figures),
                        f"{figures[1] / figures[0]:.3f}",
                        spread(ratios),
                    ]
                )
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="short records, just to see that it runs")
    parser.add_argument("--only", default="", help="part of the name of a kernel")
    options = parser.parse_args()
    keep_memory()
    short_s, long_s = (1.0, 4.0) if options.quick else (SHORT_S, LONG_S)
    rows = measure(1 if options.quick else options.repeats, short_s, long_s, options.only)
    print_table(
        [
            "kernel",
            "poles",
            "set point",
            f"ns at {short_s:g} s",
            f"ns at {long_s:g} s",
            "long / short",
            "quartiles",
        ],
        rows,
    )


if __name__ == "__main__":
    main()
