"""Count what is told of ships whose governor the package has not, and of smooth ships beside them.

    python -m tests.families.undescribed --draws 20 --seed 160000 --out FOLDER

Of each ship: whether drive and governor are called not described, whether p and the inertia behind the torque's place are
told and hold, and whether a gain that is off by a third is called usable for control tuning.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from tests.families import other_governors
from tests.families.draw import FAMILIES, draw

OFF = 1.0 / 3.0
"""Part of a gain by which it is wrong."""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.families.undescribed", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--draws", type=int, default=20, help="of each governor, and of each family's smooth ships"
    )
    parser.add_argument("--seed", type=int, default=160000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--out", type=Path, help="folder of a JSON for each ship; what is there is not done again"
    )
    options = parser.parse_args()
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    tasks = [
        (name, seed)
        for seed in range(options.seed, options.seed + options.draws)
        for name in (*other_governors.KINDS, *FAMILIES)
    ]
    rows = []
    with ProcessPoolExecutor(options.processes) as pool:
        for row in pool.map(partial(kept, out=options.out), tasks):
            if row is not None:
                rows.append(row)
                print(row["text"], flush=True)
    print(counted(rows))


def kept(task, out: Path | None) -> dict | None:
    """Identify a ship, or read what was found of it before."""
    file = out and out / f"{task[0]}-{task[1]}.json"
    if file and file.exists():
        return json.loads(file.read_text(encoding="utf-8"))
    row = told(task)
    if file:
        file.write_text(json.dumps(row), encoding="utf-8")
    return row


def told(task) -> dict | None:
    """Identify a ship; None where it has a limit, or no trial."""
    import shipfp_rs as fp

    warnings.simplefilter("ignore")
    name, seed = task
    try:
        ship = draw(name, seed) if name in FAMILIES else other_governors.draw(name, seed)
        truth = ship.truth()
        if name in FAMILIES and {"M_max", "rate"} & set(truth["on"]):
            return None
        experiment = fp.Experiment(**ship.experiment())
    except RuntimeError:
        return None
    true, began = dict(truth["parameters"]), time.perf_counter()
    # A governor that samples acts as a continuous one with a smaller gain.
    true["vK_p"] += (true.get("update", 0.0) - 0.5) * (true.get("T_s") or 0.0) * true["vK_i"]
    row = {"group": name if name in other_governors.KINDS else "smooth", "ship": f"{name} {seed}"}
    try:
        found = fp.identify(experiment, torque=truth["place"])
    except fp.ShipfpError as problem:
        return row | {
            "told": False,
            "inside": [],
            "described": None,
            "false": False,
            "text": f"{name} {seed}: {problem}",
        }
    inertia = "tau_prop" if truth["place"] == "gauge" else "tau_n"
    sides = {"p": true["p"] + (true.get("damping") or 0.0), inertia: true[inertia]}
    known = [key for key in sides if key in found.load_side]
    inside = [
        bool(found.load_side[key].ci95[0] <= sides[key] <= found.load_side[key].ci95[1]) for key in known
    ]
    off = [
        key
        for key in ("vK_p", "vK_i")
        if (value := found.parameters[key].value) is not None and abs(value / true[key] - 1.0) > OFF
    ]
    tuning = found.usable.startswith("Usable for simulation, control tuning")
    described = bool(found.adequate["sides"]["engine"])
    words = [
        f"{name} {seed}: {time.perf_counter() - began:.1f} s",
        "described" if described else "not described",
        *(f"{key} {'holds' if one else 'OUTSIDE'}" for key, one in zip(known, inside, strict=True)),
        *(f"{key} off by more than a third" for key in off),
        *(["called usable for control tuning"] if off and tuning else []),
    ]
    return row | {
        "told": len(known) == 2,
        "inside": inside,
        "described": described,
        "false": bool(off and tuning),
        "text": ", ".join(words),
    }


def counted(rows) -> str:
    """Return a line for each kind of ship."""
    lines = [
        f"{'':14}{'ships':>6}{'load told':>11}{'inside':>12}{'not described':>15}{'wrong gain for tuning':>23}"
    ]
    groups = dict.fromkeys(row["group"] for row in rows)
    others = [group for group in groups if group != "smooth"]
    for label, members in (*((group, [group]) for group in groups), ("all others", others)):
        mine = [row for row in rows if row["group"] in members]
        inside = [one for row in mine for one in row["inside"]]
        lines.append(
            f"{label:14}{len(mine):6}{sum(row['told'] for row in mine):11}{f'{sum(inside)} of {len(inside)}':>12}"
            f"{sum(row['described'] is False for row in mine):15}{sum(row['false'] for row in mine):23}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
