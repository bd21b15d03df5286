"""The whole of `identify`, selection included, beside the rival's one structure from one start on the same samples.

    python -m benches.bench_identify [--seconds 500] [--repeats 3] [--quick]

Both use one thread. The rival knows the structure and starts near the truth; `identify` is given nothing but the signals.
"""

import time

import numpy as np
from threadpoolctl import threadpool_limits

import shipfp_rs as fp
from benches import rival_ship
from benches.timing import asked, print_table

N_E, M_G = 1183.8, 1725.0
SHIP = ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop", "T_d", "T_set")


def experiment(u, y, dt) -> fp.Experiment:
    """Return the rival's trial as an experiment."""
    signals = {"n_set": u * N_E, "n_e": y[0] * N_E, "M_g": y[1] * M_G}
    point = {"n_set": N_E, "n_e": N_E, "M_g": M_G}
    return fp.Experiment("trial", 1.0 / dt, signals, operating_point=point, hold="first")


def main() -> None:
    quick = {"seconds": 200.0, "repeats": 1}
    options = asked(__doc__, quick, seconds=500.0, repeats=3)
    u, y, dt = rival_ship.trial(1, options.seconds)
    data = experiment(u, y, dt)
    given = fp.Structure.ship(["dead_time_loop", "dead_time_set_point"], torque="gauge")
    given = given.with_start(**dict(zip(SHIP, rival_ship.START[:8].tolist(), strict=True)))
    calls = {
        "rival: SciPy over Numba, structure and start given": lambda: rival_ship.fit(u, y, dt),
        "identify, structure and start given": lambda: fp.identify(data, given, starts=1),
        "identify, nothing given": lambda: fp.identify(data),
    }
    times, found = {}, None
    with threadpool_limits(1):
        rival_ship.fit(u[:2000], y[:, :2000], dt)
        for name, call in calls.items():
            spent = []
            for _ in range(options.repeats):
                began = time.process_time()
                found = call()
                spent.append(time.process_time() - began)
            times[name] = float(np.median(spent))
    rival = next(iter(times.values()))
    rows = [[name, f"{seconds:.2f}", f"{rival / seconds:.2f}"] for name, seconds in times.items()]
    print_table(["fit", "processor s", "times faster than the rival"], rows)
    print()
    truth = dict(zip(SHIP, rival_ship.TRUTH, strict=False))
    rows = [
        [
            name,
            f"{value:g}",
            f"{found[name].value:.4g}",
            f"{found[name].ci95[0]:.4g}",
            f"{found[name].ci95[1]:.4g}",
        ]
        for name, value in truth.items()
        if name in found.parameters and found[name].ci95 is not None
    ]
    print_table(["parameter", "truth", "estimate", "95 % from", "to"], rows)


if __name__ == "__main__":
    main()
