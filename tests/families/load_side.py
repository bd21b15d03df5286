"""Count how often the load's side by itself is right: on the families, and with governors that the package has not.

    python -m tests.families.load_side --draws 20 --seed 140000
    python -m tests.families.load_side --draws 5 --seed 140000 --identify

Each line is a draw: true and found p and inertia with their deviations, as it goes. With `--identify` ships without a limit
are identified as a whole, too, and the intervals' widths are compared.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np

import shipfp_rs as fp
from shipfp_rs.identification.load_side import Fit, Record
from shipfp_rs.identification.spectra import Spectra
from tests.families import other_governors
from tests.families.draw import FAMILIES, draw

LIMITS = {"M_max", "rate"}
LEAST_TORQUE = -1.5
"""Deviation of a torque over its operating point that no draw has: see `draw`."""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.families.load_side", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--draws", type=int, default=20, help="of each family and each governor")
    parser.add_argument("--seed", type=int, default=140000)
    parser.add_argument("--of", nargs="*", choices=[*FAMILIES, *other_governors.KINDS])
    parser.add_argument("--identify", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    for name in options.of or [*FAMILIES, *other_governors.KINDS]:
        for seed in range(options.seed, options.seed + options.draws):
            ship = draw(name, seed) if name in FAMILIES else other_governors.draw(name, seed)
            try:
                experiment = fp.Experiment(**ship.experiment())
            except RuntimeError as problem:  # the integrator of the launches gives up on some
                print(f"{name} {seed}: no trial, {problem}", flush=True)
                continue
            place = "M_g" if ship.place == "gauge" else "M_b"
            if np.min(experiment.normalised(place)) < LEAST_TORQUE:
                print(f"{name} {seed}: no trial, the launches' integrator went astray at the torque's limit")
                continue
            row = answered(name, ship.truth(), experiment, options.identify)
            rows.append(row)
            print(f"{name} {seed}: {row['text']}", flush=True)
    print(counted(rows))


def answered(name, truth, experiment, whole) -> dict:
    """Return what the load's side tells of a trial, beside the truth; with `whole` also widths over `identify`'s."""
    inertia = "tau_prop" if truth["place"] == "gauge" else "tau_n"
    true = {
        "p": truth["parameters"]["p"] + truth["parameters"]["damping"],
        inertia: truth["parameters"][inertia],
    }
    limited = bool(LIMITS & set(truth["on"]))
    group = f"{name}, {'limits' if limited else 'no limits'}" if name in FAMILIES else f"governor {name}"
    row = {"group": group, "seconds": None, "inside": None, "widths": None}
    try:
        side = fp.load_side(experiment, torque=truth["place"])
    except fp.InputError as problem:
        return row | {"text": f"refused: {problem}"}
    found = {key: side.parameters[key] for key in true}
    row["inside"] = [one.ci95[0] <= true[key] <= one.ci95[1] for key, one in found.items()]
    row["seconds"] = search_time(experiment, side)
    told = [f"{key} {true[key]:.4f}: {one.value:.4f} ± {one.std:.4f}" for key, one in found.items()]
    told += [
        f"{1e3 * row['seconds']:.1f} ms, {truth['place']}, {' '.join(truth['on'])}",
        "" if all(row["inside"]) else "OUTSIDE",
    ]
    if whole and not limited:
        row["widths"] = ratios(experiment, truth["place"], found)
        told.append(f"widths over the whole's {row['widths']}")
    return row | {"text": "; ".join(filter(None, told))}


def search_time(experiment, side) -> float:
    """Least time of three from ready spectra on [s]."""
    signal = "M_g" if side.torque == "gauge" else "M_b"
    measured = np.array([experiment.normalised("n_e"), experiment.normalised(signal)])
    spectra = Spectra.of(experiment, ("dn", "dM"), measured, load="k_L" in side.parameters)
    times = []
    for _ in range(3):
        record = Record(spectra)
        began = time.perf_counter()
        Fit([record], side.torque == "gauge").found()
        times.append(time.perf_counter() - began)
    return min(times)


def ratios(experiment, place, found) -> list[float | None]:
    """Widths of the intervals over those of the whole identification; None where it has none."""
    try:
        whole = fp.identify(experiment, torque=place).parameters
    except fp.ShipfpError:
        return [None, None]
    widths = []
    for key, one in found.items():
        other = whole[key].ci95 if key in whole else None
        wide = None if other is None else other[1] - other[0]
        widths.append(round((one.ci95[1] - one.ci95[0]) / wide, 2) if wide and np.isfinite(wide) else None)
    return widths


def counted(rows) -> str:
    """Return a line for each group, and for all of them."""
    lines = [f"{'':28}{'draws':>6}{'refused':>9}{'p holds':>9}{'inertia holds':>15}"]
    groups = dict.fromkeys(row["group"] for row in rows)
    for group in [*groups, "all"]:
        mine = [row for row in rows if group in (row["group"], "all")]
        told = [row["inside"] for row in mine if row["inside"] is not None]
        holds = [sum(one[at] for one in told) for at in (0, 1)]
        lines.append(f"{group:28}{len(mine):6}{len(mine) - len(told):9}{holds[0]:9}{holds[1]:15}")
    seconds = [row["seconds"] for row in rows if row["seconds"]]
    lines += [f"median {1e3 * np.median(seconds):.1f} ms from ready spectra on"] if seconds else []
    for at, name in enumerate(("p", "inertia")):
        widths = [row["widths"][at] for row in rows if row["widths"] and row["widths"][at] is not None]
        lines += (
            [f"{name}: {len(widths)} widths, median {np.median(widths):.2f} of the whole's"] if widths else []
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
