"""Draws of a fingerprint's parameters from the likelihood of the rival's record: time.

    python -m benches.bench_draws [--seconds 500] [--draws 10000] [--quick]

The fit with the structure given has ten unknowns; the full ship, of which the record tells little of many lags, eighteen.
"""

import time

import shipfp_rs as fp
from benches import rival_ship
from benches.bench_identify import SHIP, experiment
from benches.timing import asked, print_table


def main() -> None:
    options = asked(__doc__, {"seconds": 200.0, "draws": 1000}, seconds=500.0, draws=10_000)
    data = experiment(*rival_ship.trial(1, options.seconds))
    given = fp.Structure.ship(["dead_time_loop", "dead_time_set_point"], torque="gauge")
    given = given.with_start(**dict(zip(SHIP, rival_ship.START[:8].tolist(), strict=True)))
    rows = []
    for name, structure in (("structure given", given), ("nothing given", None)):
        found = fp.identify(data, structure)
        for seed in range(3):
            began = time.perf_counter()
            try:
                drawn = found.draws(options.draws, seed)
                told = f"{len(drawn.table)}"
            except fp.ShipfpError as error:
                told = str(error)[:40]
            rows.append([name, str(seed), f"{time.perf_counter() - began:.2f}", told])
    print_table(["fit", "seed", "s", "draws"], rows)


if __name__ == "__main__":
    main()
