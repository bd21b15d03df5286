"""Show up to which noise of the speed a governor's gains, over the inertia, hold to 10 per cent.

    python -m tests.families.speed_noise --draws 6 --seed 225100

Smooth tugs and launches, each with white noise of several sizes on its speed, over the operating speed in the band of 25 Hz.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace

import numpy as np

import shipfp_rs as fp
from tests.families.draw import draw
from tests.families.sensors import Noise

LEVELS = (1e-4, 5e-4, 2e-3, 5e-3, 1e-2, 2e-2)
CLOSE = 0.1
"""Error of a gain, over it, up to which it holds."""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.families.speed_noise", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--draws", type=int, default=6, help="of tugs, and of launches")
    parser.add_argument("--seed", type=int, default=225100)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(options.seed, options.seed + options.draws)
    ships = [draw(family, seed) for family in ("tug", "launch") for seed in seeds]
    ships = [ship for ship in ships if not {"M_max", "rate"} & set(ship.truth()["on"])]
    print(f"{len(ships)} ships without a limit")
    print(
        f"{'noise of the speed':>20}{'of the response':>17}{'told':>6}{'within 10 %':>13}{'interval 10 %':>15}"
    )
    for level in LEVELS:
        rows = [row for ship in ships for row in gains(ship, level)]
        errors, widths, shares = np.array(rows).T
        told = np.isfinite(errors)
        print(
            f"{100 * level:18.2f} %{100 * np.median(shares):15.1f} %{told.sum():6}{np.sum(errors <= CLOSE):13}"
            f"{np.sum(widths <= CLOSE):15}",
            flush=True,
        )


def gains(ship, level: float) -> list[tuple[float, float, float]]:
    """Return error and half of the interval of both gains, over their values, and the noise over the response."""
    noisy = replace(ship, noise=(Noise(((level, ()),)), ship.noise[1]), noise_free=())
    experiment, true = fp.Experiment(**noisy.experiment()), noisy.truth()["parameters"]
    share = level / float(np.std(experiment.normalised("n_e")))
    # A governor that samples acts as a continuous one with a smaller gain.
    less = (true["update"] - 0.5) * true["T_s"] * true["vK_i"]
    known = {"vK_p/tau_n": (true["vK_p"] + less) / true["tau_n"], "vK_i/tau_n": true["vK_i"] / true["tau_n"]}
    try:
        found = fp.identify(experiment, torque=noisy.place).derived
    except fp.ShipfpError:
        return [(np.inf, np.inf, share)] * len(known)
    rows = []
    for name, value in known.items():
        one = found.get(name)
        error = np.inf if one is None or one.value is None else abs(one.value / value - 1.0)
        width = np.inf if one is None or one.ci95 is None else (one.ci95[1] - one.ci95[0]) / (2.0 * value)
        rows.append((error, width, share))
    return rows


if __name__ == "__main__":
    main()
