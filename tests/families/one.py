"""One draw in a process of its own: make it, let the package answer, write what came back as JSON.

    python -m tests.families.one tug 7 experiments OUT.json

The only generator or study here that imports the package, beside `undescribed`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

from tests.families import genset, recording, score
from tests.families.draw import draw
from tests.families.matters import judged
from tests.families.wrong import wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("family")
    parser.add_argument("seed", type=int)
    parser.add_argument("mode", choices=["experiments", "raw"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--structure", choices=["none", "true"], default="none")
    parser.add_argument("--load", default="", help="name of the load torque's signal; '': no load steps")
    parser.add_argument("--no-matters", action="store_true")
    parser.add_argument("--longest", type=float)
    parser.add_argument("--late", type=float, help="begin the window so long after the excitation [s]")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    result = {"family": options.family, "seed": options.seed, "mode": options.mode}
    if options.family == "wrong":
        made = wrong(options.seed)
        result |= {"kind": made.kind, "harm": list(made.harm)}
        result |= identified(made.experiment, None)
    else:
        drawn = draw(options.family, options.seed, load=bool(options.load), longest_s=options.longest)
        drawn = drawn if options.late is None else replace(drawn, late_s=options.late)
        result["truth"] = drawn.truth()
        judging = not options.no_matters and options.family not in ("strangers", "charged")
        result["matters"] = judged(drawn) if judging else None
        # For the case that no answer comes: the truth is there.
        options.out.write_text(json.dumps(result | {"answer": None, "error": None}), encoding="utf-8")
        if options.mode == "raw":
            result |= run(drawn, options.load)
            result["truth"]["parameters"]["T_M"] = result["sensors"]["T_M"]
        else:
            experiment = drawn.experiment()
            for part in ("signals", "operating_point"):
                if "M_load" in experiment[part] and options.load:
                    experiment[part][options.load] = experiment[part].pop("M_load")
            given = result["truth"] if options.structure == "true" else None
            result |= identified(experiment, given, figures="loop" in result["truth"])
    options.out.write_text(json.dumps(result), encoding="utf-8")


def identified(experiment, truth, figures=False) -> dict:
    """Let the package identify arrays or experiments; with `truth`, the elements that are on are given; `figures`: the
    loop's, too."""
    import shipfp_rs as fp

    began, worked = time.perf_counter(), time.process_time()
    answer, error, loop = None, None, None
    try:
        data = fp.Experiment(**experiment) if isinstance(experiment, dict) else experiment
        found = fp.identify(data) if truth is None else fp.identify(data, true_structure(fp, truth))
        answer = found.to_dict()
        loop = loop_told(found) if figures else None
    except Exception as problem:  # every failure is a result here
        error = {"type": type(problem).__name__, "text": str(problem)[:500]}
        error["refused"] = isinstance(problem, fp.errors.InputError)
    return {
        "answer": answer,
        "loop": loop,
        "error": error,
        "seconds": time.perf_counter() - began,
        "processor_s": time.process_time() - worked,
    }


def loop_told(fingerprint) -> dict | None:
    """Return crossover and margins as the package tells them; None where its model has no loop."""
    import shipfp_rs as fp
    from shipfp_rs.assessment.closed_loop import closed_loop

    try:
        figures = closed_loop(fingerprint)
    except fp.ShipfpError:
        return None
    return {name: figures[name].to_dict() for name in score.LOOP if name in figures}


def loop_of_file(file) -> dict | None:
    """Return the figures of a fingerprint that `shipfp run` wrote."""
    import shipfp_rs as fp

    return loop_told(fp.Fingerprint.load(file))


ELEMENTS = {
    "T_d": "dead_time_loop",
    "T_set": "dead_time_set_point",
    "tau_act": "actuator_lag",
    "T_s": "sampling",
    "M_max": "torque_limit",
    "rate": "rack_rate",
    "c_2": "curvature",
    "tau_twist": "twist",
}
"""Parameters of the elements that may be on, and what the ship model calls these."""


def true_structure(fp, truth):
    """Return the ship with the elements that are on."""
    elements = [ELEMENTS[name] for name in truth["on"] if name in ELEMENTS]
    return fp.Structure.ship(elements, torque=truth["place"])


def run(drawn, load) -> dict:
    """Write the raw log and its trial file, and let `shipfp run` answer."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began = time.perf_counter()
        if load:
            genset.LOAD_TABLE = genset.LOAD_TABLE.replace("channels.load", f"channels.{load}")
        trial, log = recording.write(drawn, folder)
        made = time.perf_counter()
        command = [sys.executable, "-m", "shipfp_rs.cli", "run", str(trial), "--out", str(folder / "out")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - made
        answer, error, loop = None, None, None
        file = folder / "out" / "fingerprint.json"
        if done.returncode == 0 and file.is_file():
            answer = json.loads(file.read_text(encoding="utf-8"))
            loop = loop_of_file(file) if "loop" in drawn.truth() else None
        else:
            error = {
                "type": f"exit {done.returncode}",
                "text": done.stderr[-500:],
                "refused": done.returncode == 2,
            }
        return {
            "answer": answer,
            "loop": loop,
            "error": error,
            "seconds": seconds,
            "made_s": made - began,
            "sensors": log.facts,
        }


if __name__ == "__main__":
    main()
