"""How the library does on systems that it has never seen: generating sets, podded drives and boats.

    python -m tests.first_hour.fresh_systems --draws 12 --seed 300000 --out FOLDER

The systems of `fresh_machines` go as files of their loggers through the commands `init` and `run`. A trial gets no answer
but what a person knows: a calibration, pulses a turn, poles, a rating, an efficiency, a gear's ratio, a bus that holds.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.families.score import as_told, binomial, evaluated, score
from tests.first_hour.fresh_machines import WRITERS, System, drawn, loop_of, margins, way_of

CLOSE = 0.15
"""Error of a margin, over the true one."""
THIRD = 1.0 / 3.0
MARGINS, SAID = ("PM", "GM"), ("shown", "close", "holds")
KNOWN_WELL = 0.2
"""Half of an interval over its value up to which a report gives a value."""
ASKED = "to be given"
LIMIT_S = 600.0
"""Of a command."""


def commanded(arguments: Sequence[str]) -> str | None:
    """Call `shipfp` in a process of its own; return what went wrong."""
    command = [sys.executable, "-m", "shipfp_rs.cli", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"{arguments[0]}: {LIMIT_S} s"
    return f"{arguments[0]}: {done.returncode}: {done.stderr.strip()[-300:]}" if done.returncode else None


def answered(
    system: System, folder: Path, shipfp: Callable[[Sequence[str]], str | None] = commanded
) -> str | None:
    """Write a system's log, let the commands find its fingerprint in `folder`/result; return what went wrong."""
    log, answers = WRITERS[system.kind](system, folder)
    if (wrong := shipfp(["init", str(folder), "--log", str(log)])) is not None:
        return wrong
    trial = folder / "TRIAL.toml"
    text = trial.read_text(encoding="utf-8")
    for question, answer in answers.items():
        # An answer takes the place of the question's comment, too.
        text, count = re.subn(re.escape(question) + ".*", lambda _, answer=answer: answer, text)
        if count != 1:
            return f"init does not ask: {question}"
    if f'= "{ASKED}"' in text:
        return f"init asks for more: {text.partition(ASKED)[0][-40:]!r}"
    trial.write_text(text, encoding="utf-8")
    return shipfp(["run", str(trial), "--out", str(folder / "result")])


def told_truth(system: System, point: Mapping[str, float]) -> dict[str, float]:
    """Return the true parameters over a fingerprint's operating point."""
    torque_Nm = point["M_g"] if "M_g" in point else point.get("M_b", point.get("M_load"))
    over = point["n_e"] / system.rpm / (torque_Nm / system.torque_Nm)
    relative = {name: over * system.true[name] for name in ("tau_n", "g", "vK_p", "vK_i", "tau_prop")}
    return {**system.true, **relative} | ({"p": 0.0} if system.kind == "genset" else {})


def judged(system: System, result: Path) -> dict[str, Any]:
    """Hold a fingerprint against the truth."""
    from shipfp_rs import Fingerprint
    from shipfp_rs.report.loop import figures

    answer = json.loads((result / "fingerprint.json").read_text(encoding="utf-8"))
    truth = told_truth(system, answer["data"][0]["operating_point"])
    rows = score(answer, {"parameters": truth, "on": []})["parameters"]
    told, known = as_told(answer, truth), {**answer["parameters"], **answer["derived"]}
    off = {
        name: known[name]["value"] / evaluated(name, told) - 1.0
        for name in ("vK_p", "vK_i", "vK_p/tau_n", "vK_i/tau_n")
        if name in known and known[name]["value"] is not None
    }
    loop = {} if answer["why_not"] else figures(Fingerprint.load(result / "fingerprint.json"), None)
    found = [loop.get(name) for name in ("phase margin", "gain margin")]
    return {
        "usability": answer["usability"],
        "verdict": answer["verdict"][0],
        "rows": rows,
        "off": off,
        "margins": [one and one.value for one in found],
        "margins_ci95": [one and one.ci95 for one in found],
        "elements": {name: one["state"] for name, one in answer["elements"].items()},
        "told": told,
        "parameters": answer["parameters"],
        "derived": answer["derived"],
    }


def studied(task: tuple[str, int], out: Path | None, length_s: float = 200.0) -> dict[str, Any]:
    """Return one system's result, from its file where there is one."""
    kind, seed = task
    file = out / f"{kind}-{seed}.json" if out else None
    if file and file.exists():
        return json.loads(file.read_text(encoding="utf-8"))
    system, began = drawn(kind, seed, length_s), time.perf_counter()
    one = {
        "kind": kind,
        "seed": seed,
        "true": dict(system.true),
        "rpm": system.rpm,
        "torque_Nm": system.torque_Nm,
    }
    one["way"] = way_of(system)
    one |= {"true_margins": margins(loop_of(kind, system.true)), "ratio": system.ratio, "usability": ""}
    with tempfile.TemporaryDirectory() as name:
        one["error"] = answered(system, Path(name))
        one["seconds"] = time.perf_counter() - began
        if one["error"] is None:
            one |= judged(system, Path(name) / "result")
    if file:
        file.write_text(json.dumps(one, indent=1), encoding="utf-8")
    print(line(one), flush=True)
    return one


def line(one: Mapping[str, Any]) -> str:
    """Return a result in a line."""
    head = f"{one['kind']:7}{one['seed']:7} {one['way']:10} {one['usability'] or 'none':13}"
    if one["error"] is not None:
        return f"{head} {one['seconds']:4.0f} s  {one['error']}"
    known = {name: row for name, row in one["rows"].items() if row["known"]}
    missed = [name for name, row in known.items() if not row["inside_as_told"]]
    shown = " ".join(
        f"{name} {'-' if found is None else format(found, '.3g')}/{true:.3g}"
        for name, found, true in zip(("PM", "GM"), one["margins"], one["true_margins"], strict=True)
    )
    return (
        f"{head} {len(known) - len(missed):2}/{len(known):2} hold  {shown}  {one['seconds']:4.0f} s"
        + (f"  not: {', '.join(missed)}" if missed else "")
        + ("  a gain far off" if is_far(one) else "")
    )


def is_far(one: Mapping[str, Any]) -> bool:
    """Whether it is called usable for tuning, and a gain is off by more than a third."""
    return one["usability"] == "usable" and any(abs(off) > THIRD for off in one["off"].values())


def margin_of(one: Mapping[str, Any], at: int) -> tuple[bool, bool, bool]:
    """Return whether a report has a value of a margin, whether that is `CLOSE`, and whether what it says holds the truth.

    A margin that is not known to `KNOWN_WELL` has its interval, or its lower end, in place of a value.
    """
    value, ends = one.get("margins", [None] * 2)[at], one.get("margins_ci95", [None] * 2)[at]
    if ends is None:
        return False, False, False
    true = one["true_margins"][at]
    shown = value is not None and ends[1] - ends[0] <= 2.0 * KNOWN_WELL * max(abs(value), 0.5)
    return shown, shown and abs(value / true - 1.0) <= CLOSE, ends[0] <= true <= ends[1]


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Return coverage by kind and parameter, and how many margins and gains are right."""
    held: dict[str, dict[str, list[bool]]] = defaultdict(lambda: defaultdict(list))
    for one in results:
        for name, row in one.get("rows", {}).items():
            if row["known"]:
                for key in ((one["kind"], name), (one["kind"], "all"), ("all", name), ("all", "all")):
                    held[key[0]][key[1]].append(row["inside_as_told"])
    lines = [f"{'kind':8}{'parameter':20}{'known':>6}{'hold':>6}{'share':>8}  95 % of it"]
    for kind, names in held.items():
        for name, inside in sorted(names.items()):
            low, high = binomial(sum(inside), len(inside))
            share = f"{100 * np.mean(inside):.0f} %"
            lines.append(
                f"{kind:8}{name:20}{len(inside):6}{sum(inside):6}{share:>8}  {100 * low:.0f} to {100 * high:.0f} %"
            )
    heads = ("systems", "errors", "usable", *(f"{name} {of}" for name in MARGINS for of in SAID), "far gains")
    lines += ["", f"{'kind':8}" + "".join(f"{head:>10}" for head in heads)]
    for kind in [*dict.fromkeys(one["kind"] for one in results), "all"]:
        of = [one for one in results if kind in (one["kind"], "all")]
        errors = sum(one["error"] is not None for one in of)
        usable = sum(one["usability"] == "usable" for one in of)
        margins = np.array([[*margin_of(one, 0), *margin_of(one, 1)] for one in of]).sum(axis=0)
        row = (len(of), errors, usable, *margins, sum(map(is_far, of)))
        lines.append(f"{kind:8}" + "".join(f"{one:>10}" for one in row))
    asked = "asked: 90 % hold, margins are shown in 70 % and close there, no gain is far; one not shown has its interval"
    return "\n".join([*lines, "", asked])


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.first_hour.fresh_systems", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--kind", choices=[*WRITERS, "all"], default="all")
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--seed", type=int, default=300000)
    parser.add_argument(
        "--out", type=Path, help="folder of a JSON for each system; what is there is not done again"
    )
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    kinds = list(WRITERS) if options.kind == "all" else [options.kind]
    tasks = [(kind, seed) for kind in kinds for seed in range(options.seed, options.seed + options.draws)]
    with ThreadPoolExecutor(options.processes) as pool:
        results = list(pool.map(partial(studied, out=options.out), tasks))
    print("\n" + table(results))


if __name__ == "__main__":
    main()
