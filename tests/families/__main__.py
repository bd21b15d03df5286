"""Let the package answer many draws of a family, and count how often it is right.

    python -m tests.families --family tug --draws 20 --seed 1000 --experiments
    python -m tests.families --family all --draws 5 --raw
    python -m tests.families --family strangers --draws 40 --raw
    python -m tests.families --family wrong --draws 200
    python -m tests.families --family tug --draws 20 --windows

Each draw runs in a process of its own with a time limit, so that an abort or an endless search is a result, too. Every
draw's truth, answer and score go into a file of its own as soon as they are there: a study that was stopped goes on where it
was when it is called again. With `--windows` each ship is answered four times, from windows that begin later and later in
the excitation, and the answers are held against each other.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path

from tests.families.draw import FAMILIES, draw
from tests.families.score import LATE_S, LOOP, agreement, is_known, loop_inside, score, summary, table
from tests.families.wrong import KINDS

CIRCUMSTANCES = {
    "a limited rate": lambda truth: "rate" in truth["on"],
    "a drifting exponent": lambda truth: "c_2" in truth["on"],
    "steps off every clock": lambda truth: not truth["excitation"]["keeps_time"],
    "a late window": lambda truth: truth["late_s"] is not None,
    "a channel without noise": lambda truth: truth["noise_free"],
}
"""What makes a trial harder, by the truth that it is read from."""
ROOT = Path(__file__).resolve().parents[2]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.families", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--family", choices=[*FAMILIES, "strangers", "charged", "all", "wrong"], default="tug"
    )
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--experiments", dest="mode", action="store_const", const="experiments", default="experiments"
    )
    mode.add_argument("--raw", dest="mode", action="store_const", const="raw")
    parser.add_argument(
        "--structure", choices=["none", "true"], default="none", help="true: with the elements that are on"
    )
    parser.add_argument(
        "--load", default="", help="name of the load torque's signal, where the package takes one"
    )
    parser.add_argument(
        "--windows", action="store_true", help=f"windows begun {LATE_S} s into the excitation"
    )
    parser.add_argument("--no-matters", action="store_true", help="take every element that is on to matter")
    parser.add_argument(
        "--only", choices=["smooth", "limits"], help="ships without a limit of torque or rate, or with one"
    )
    parser.add_argument("--longest", type=float, help="longest excitation [s], at least 200")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--limit", type=float, default=600.0, help="seconds a draw")
    parser.add_argument("--out", type=Path, default=None, help="folder; default below target/families")
    options = parser.parse_args()
    families = FAMILIES if options.family == "all" else (options.family,)
    late = LATE_S if options.windows and options.family != "wrong" else (None,)
    tasks = [
        (family, seed, late_s) for family in families for seed in chosen(family, options) for late_s in late
    ]
    began = time.perf_counter()
    out = options.out or ROOT / "target" / "families" / f"{options.family}-{options.mode}-{options.structure}"
    out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(options.processes) as pool:
        results = list(pool.map(lambda task: kept(*task, options, out), tasks))
    print(report(families, results))
    if families != ("wrong",):
        print(judged(results))
        print(by_circumstance(results))
    if families[0] in ("strangers", "charged"):
        print(by_kind(results))
        print(loops(results))
    if options.windows:
        print(agreement(results))
    print(f"\n{len(results)} draws in {time.perf_counter() - began:.0f} s; wrote {out}")


def chosen(family, options) -> list[int]:
    """Return the first seeds of a family from one on whose ships are of a kind."""
    first, draws = options.seed, options.draws
    if options.only is None or family == "wrong":
        return list(range(first, first + draws))
    found: list[int] = []
    # Whether one hunts, and is drawn anew, takes a simulation or more.
    with ProcessPoolExecutor(options.processes) as pool:
        while len(found) < draws:
            seeds = range(first, first + draws)
            limited = pool.map(partial(is_limited, family, load=bool(options.load)), seeds)
            found += [
                seed for seed, has in zip(seeds, limited, strict=True) if has == (options.only == "limits")
            ]
            first += draws
    return found[:draws]


def is_limited(family, seed, load) -> bool:
    """Whether a draw of a family has a limit of torque or rate."""
    return bool({"M_max", "rate", "set_rate"} & set(draw(family, seed, load=load).truth()["on"]))


def kept(family, seed, late_s, options, out) -> dict:
    """Return a draw's result, from its file where a study before has written it."""
    file = out / (f"{family}-{seed}.json" if late_s is None else f"{family}-{seed}-{late_s}s.json")
    if not file.is_file():
        result = answered(family, seed, late_s, options)
        part = file.with_suffix(".part")
        part.write_text(json.dumps(result), encoding="utf-8")
        part.rename(file)
    return json.loads(file.read_text(encoding="utf-8"))


def judged(results) -> str:
    """Return how many answers were grossly wrong, how many of these were called usable, and how many intervals held."""
    scored = [one for one in results if "score" in one]
    gross, believed, inside, known, claimed = [], [], 0, 0, 0
    for one in scored:
        rows = one["score"]["parameters"]
        label = f"{one['family']} {one['seed']}"
        inside += sum(bool(row.get("inside_as_told")) for row in rows.values() if row["known"])
        known += sum(row["known"] for row in rows.values())
        claimed += any(row["kind"] == "false" for row in one["score"]["elements"].values())
        if any(row["gross_as_told"] for row in rows.values()):
            gross.append(label)
            if not one["answer"]["usable"].startswith("Not usable"):
                believed.append(label)
    refused = len(results) - sum(not one["answer"]["usable"].startswith("Not usable") for one in scored)
    return "\n".join(
        (
            f"grossly wrong: {len(gross)} of {len(results)} ({', '.join(gross)})",
            f"of these called usable: {len(believed)}",
            f"intervals that hold, as told: {inside} of {known} ({100.0 * inside / max(known, 1):.0f} %)",
            f"refused or not usable: {refused}; an element claimed that is not there: {claimed}",
        )
    )


def by_circumstance(results) -> str:
    """Return how many answers were grossly wrong among the trials that have what makes them harder, and among the rest."""
    scored = [one for one in results if "score" in one]
    lines = []
    for name, has in CIRCUMSTANCES.items():
        counts = []
        for wanted in (True, False):
            mine = [one["score"]["parameters"] for one in scored if bool(has(one["truth"])) == wanted]
            wrong = sum(any(row["gross_as_told"] for row in rows.values()) for rows in mine)
            counts.append(f"{wrong} of {len(mine)}")
        lines.append(f"grossly wrong with {name}: {counts[0]}, without: {counts[1]}")
    return "\n".join(lines)


def by_kind(results) -> str:
    """Return a line for each kind of stranger."""
    lines = [f"{'kind':12}{'draws':>7}{'answers':>9}{'grossly wrong':>15}{'usable for tuning':>19}"]
    for kind in dict.fromkeys(one["truth"]["kind"] for one in results if "truth" in one):
        mine = [one for one in results if "truth" in one and one["truth"]["kind"] == kind]
        scored = [one for one in mine if "score" in one]
        wrong = sum(
            any(row["gross_as_told"] for row in one["score"]["parameters"].values()) for one in scored
        )
        lines.append(
            f"{kind:12}{len(mine):7}{len(scored):9}{wrong:15}{sum(is_for_tuning(one) for one in scored):19}"
        )
    return "\n".join(lines)


def is_for_tuning(result) -> bool:
    """Whether an answer is called usable for control tuning."""
    return bool(result["answer"]) and result["answer"]["usable"].startswith(
        "Usable for simulation, control tuning"
    )


def loops(results) -> str:
    """Return on how many ships called usable for tuning the figures of the loop hold, and on how many that tell any."""
    told = [one for one in results if "score" in one and any_told(one["loop"])]
    tuning = [one for one in results if "score" in one and is_for_tuning(one)]
    lines = []
    for mine, who in ((tuning, "called usable for tuning"), (told, "that tell any of them")):
        inside = [loop_inside(one["loop"], one["truth"]["loop"]) for one in mine]
        whole = sum(all(one.values()) for one in inside)
        each = ", ".join(f"{name} {sum(one[name] for one in inside)}" for name in LOOP)
        lines.append(f"loop figures inside on {whole} of {len(mine)} ships {who} ({each})")
    return "\n".join(lines)


def any_told(loop) -> bool:
    """Whether a fingerprint gives an interval of one of the loop's figures."""
    return any(one["ci95"] for one in (loop or {}).values())


def answered(family, seed, late_s, options) -> dict:
    """Run one draw in a process of its own, and score it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "result.json"
        command = [sys.executable, "-m", "tests.families.one", family, str(seed), options.mode, str(file)]
        command += ["--structure", options.structure, "--load", options.load]
        command += ["--no-matters"] if options.no_matters else []
        command += ["--longest", str(options.longest)] if options.longest else []
        command += [] if late_s is None else ["--late", str(late_s)]
        problem = ""
        try:
            done = subprocess.run(
                command, cwd=ROOT, capture_output=True, text=True, timeout=options.limit, check=False
            )
            if done.returncode:
                problem = f"process ended with {done.returncode}: {done.stderr[-400:]}"
        except subprocess.TimeoutExpired:
            problem = f"no end within {options.limit:g} s"
        result = {"family": family, "seed": seed, "mode": options.mode, "answer": None, "error": None}
        if family == "wrong":
            result |= {"kind": KINDS[seed % len(KINDS)], "harm": []}
        if file.is_file():
            result = json.loads(file.read_text(encoding="utf-8"))
        if problem:
            result["error"] = {"type": "process", "text": problem, "refused": False}
    if family != "wrong" and result["answer"]:
        result["score"] = score(result["answer"], result["truth"], result["matters"])
    told = result["error"]["type"] if result["error"] else f"{result.get('seconds', 0.0):.1f} s"
    begun = "" if late_s is None else f", window begun {late_s} s late"
    print(f"{family} {seed}{begun}: {told}", file=sys.stderr, flush=True)
    return result


def report(families, results) -> str:
    """Return the tables of all families."""
    if families == ("wrong",):
        return wrong_table(results)
    texts = []
    for family in families:
        mine = [one for one in results if one["family"] == family]
        texts.append(f"{family}: {len(mine)} draws, {sum(one['answer'] is not None for one in mine)} answers")
        errors = Counter(
            f"{one['error']['type']}: {one['error']['text'][:100]}" for one in mine if one["error"]
        )
        texts += [f"  {count} x {text}" for text, count in errors.most_common(5)]
        scores = [one["score"] for one in mine if "score" in one]
        texts += [table(summary(scores)), ""] if scores else [""]
    if len(families) > 1:
        scores = [one["score"] for one in results if "score" in one]
        texts += [f"all families: {len(results)} draws", table(summary(scores))] if scores else []
    return "\n".join(texts)


def named(result) -> list[str]:
    """Parameters that an answer to wrong data calls known and must not."""
    parameters = (result["answer"] or {}).get("parameters", {})
    known = [name for name, estimate in parameters.items() if is_known(estimate)]
    return [name for name in known if not result["harm"] or name in result["harm"]]


def wrong_table(results) -> str:
    """Return a line a kind of wrong data: refused, answered with nothing known, answered with something known."""
    lines = [f"{'wrong data':38}{'refused':>9}{'nothing known':>15}{'KNOWN':>7}{'failed':>8}"]
    for kind in dict.fromkeys(one["kind"] for one in results):
        mine = [one for one in results if one["kind"] == kind]
        refused = sum(bool(one["error"] and one["error"]["refused"]) for one in mine)
        failed = sum(bool(one["error"] and not one["error"]["refused"]) for one in mine)
        known = sum(bool(one["answer"] and named(one)) for one in mine)
        lines.append(f"{kind:38}{refused:9}{len(mine) - refused - failed - known:15}{known:7}{failed:8}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
