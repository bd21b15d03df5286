"""What a branch of the estimator is worth: frozen draws answered by the code at hand, beside a stored run.

    python -m tests.price                     every draw, beside the stored run
    python -m tests.price --only smooth       those without limits
    python -m tests.price --keep              store this run as the one to compare with

Half of the draws are smooth, half have a limit of torque or rate. Each draw is a raw log that `shipfp.process` has read,
since a removal that changes nothing behind the noise of 50 Hz signals may lose a fifth of the intervals of raw logs with
limits. The signals are made once and kept below target/price; each answer runs in a process of its own, with a time limit,
and goes to a file at once, so that a study that was stopped goes on. A branch whose removal changes fewer than two draws
does not earn its lines.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import shipfp_rs as fp
from shipfp_rs.experiments.parquet import read_experiments, write_experiments
from tests.families import recording
from tests.families.draw import draw
from tests.families.one import identified
from tests.families.score import score

ROOT = Path(__file__).resolve().parents[1]
STORED = Path(__file__).with_suffix(".json")
WORK = ROOT / "target" / "price"
SMOOTH = {
    "strangers": tuple(range(41000, 41020)),
    "tug": (41000, 41002, 41004, 41009, 41011),
    "launch": (41000, 41003, 41004, 41006, 41007),
    "genset": (41001, 41010, 41011, 41013, 41016),
    "lab_drive": (41000, 41001, 41004, 41008, 41009),
}
LIMITS = {
    "tug": (41001, 41003, 41005, 41006, 41007, 41008, 41010, 41012, 41013, 41015),
    "launch": (41001, 41002, 41005, 41008, 41009, 41012, 41013, 41015, 41016, 41017),
    "genset": (41000, 41002, 41003, 41004, 41005, 41006, 41007, 41008, 41009, 41012),
    "lab_drive": (41002, 41003, 41005, 41006, 41007, 41010, 41012, 41013, 41014, 41016),
}
"""Family to seeds of the frozen draws: of each family the first from 41000 on that are smooth, or limited."""
SHIFTED = 0.5
"""Change of the deviance from which a draw counts as changed."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.price", description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=["smooth", "limits"])
    parser.add_argument("--keep", action="store_true", help="store this run")
    parser.add_argument("--out", type=Path, default=WORK / "answers", help="folder of the answers")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds a draw")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--answer", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.answer:
        family, seed, signals, file = options.answer
        answer(family, seed, Path(signals), Path(file))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    groups = {"smooth": SMOOTH, "limits": LIMITS}
    groups = {name: one for name, one in groups.items() if options.only in (None, name)}
    tasks = [
        (name, family, seed)
        for name, one in groups.items()
        for family, seeds in one.items()
        for seed in seeds
    ]
    with ThreadPoolExecutor(options.processes) as pool:
        rows = dict(pool.map(lambda task: priced(*task[1:], options), tasks))
    stored = json.loads(STORED.read_text(encoding="utf-8")) if STORED.is_file() else {}
    print(beside(rows, stored))
    for group in groups:
        own = [f"{family} {seed}" for name, family, seed in tasks if name == group]
        print(f"\n{group}: {summed([rows[one] for one in own])}")
        if before := [stored[one] for one in own if one in stored]:
            print(f"{'stored':>{len(group)}}: {summed(before)}")
            print(f"widths over the stored: {widths(rows, stored, own)}")
    if options.keep:
        STORED.write_text(json.dumps(stored | rows, indent=0, sort_keys=True) + "\n", encoding="utf-8")


def priced(family: str, seed: int, options: Any) -> tuple[str, dict[str, Any]]:
    """Return a draw's name and its row, from its file where one is there."""
    name = f"{family}-{seed}"
    signals, file = WORK / "raw" / f"{name}.parquet", options.out / f"{name}.json"
    if not file.is_file():
        command = [
            sys.executable,
            "-m",
            "tests.price",
            "--answer",
            family,
            str(seed),
            str(signals),
            str(file),
        ]
        try:
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=options.limit)
            ended = "" if file.is_file() else done.stderr[-300:] or f"process ended with {done.returncode}"
        except subprocess.TimeoutExpired:
            ended = f"no end within {options.limit:g} s"
        if ended:
            file.write_text(json.dumps({"answer": None, "error": ended}), encoding="utf-8")
    result = json.loads(file.read_text(encoding="utf-8"))
    row = row_of(result, json.loads(signals.with_suffix(".json").read_text(encoding="utf-8")))
    print(f"{family} {seed}: {row['error'] or told(row)}", file=sys.stderr, flush=True)
    return f"{family} {seed}", row


def freeze(family: str, seed: int, signals: Path) -> None:
    """Write the experiments of a draw's raw log, and its truth beside them."""
    drawn = draw(family, seed, load=False)
    signals.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        trial, log = recording.write(drawn, Path(folder))
        experiments = fp.process(trial)
    known = drawn.truth()
    known["parameters"]["T_M"] = log.facts["T_M"]
    signals.with_suffix(".json").write_text(json.dumps(known), encoding="utf-8")
    write_experiments(signals, experiments)


def answer(family: str, seed: str, signals: Path, file: Path) -> None:
    """Answer one frozen draw in this process; its signals are made first where they are missing."""
    warnings.simplefilter("ignore")
    if not signals.is_file():
        freeze(family, int(seed), signals)
    file.write_text(json.dumps(identified(read_experiments(signals), None)), encoding="utf-8")


def row_of(result: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is compared of an answer."""
    answer, error = result["answer"], result.get("error")
    if answer is None:
        text = error["text"] if isinstance(error, Mapping) else str(error)
        return {"error": text.strip().splitlines()[-1][:90] if text.strip() else "no answer"}
    rows = score(answer, truth)["parameters"]
    known = {name: row for name, row in rows.items() if row["known"]}
    return {
        "error": "",
        "criterion": round(answer["settings"]["criterion"], 2) if "criterion" in answer["settings"] else None,
        "inside": sum(bool(row["inside_as_told"]) for row in known.values()),
        "known": len(known),
        "gross": any(row["gross_as_told"] for row in rows.values()),
        "usable": not answer["usable"].startswith("Not usable"),
        "widths": {
            name: float(f"{row['half_width']:.3g}") for name, row in known.items() if row.get("half_width")
        },
        "processor_s": round(result.get("processor_s", 0.0), 1),
    }


def told(row: Mapping[str, Any]) -> str:
    """Return a row in words."""
    if row["error"]:
        return str(row["error"])
    marks = ("  gross" if row["gross"] else "") + ("" if row["usable"] else "  not usable")
    return f"{row['inside']} of {row['known']}, {row['processor_s']:.1f} s{marks}"


def beside(rows: Mapping[str, Mapping[str, Any]], stored: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the draws that changed."""
    lines = []
    for name, row in rows.items():
        before = stored.get(name)
        if before is None:
            continue
        apart = (row.get("criterion") or 0.0) - (before.get("criterion") or 0.0)
        same = all(row.get(one) == before.get(one) for one in ("error", "inside", "known", "gross", "usable"))
        if not same or abs(apart) > SHIFTED:
            lines.append(f"{name:18}{apart:+10.1f}   {told(before)}  ->  {told(row)}")
    return "\n".join([f"{len(lines)} of {len(rows)} draws changed", *lines])


def summed(rows: list[Mapping[str, Any]]) -> str:
    """Return the sums of some rows."""
    answered = [row for row in rows if not row["error"]]
    inside, known = (sum(row[name] for row in answered) for name in ("inside", "known"))
    gross = [row for row in answered if row["gross"]]
    share = 100 * inside / max(known, 1)
    return (
        f"{len(answered)} of {len(rows)} answered, {inside} of {known} intervals hold ({share:.1f} %), "
        f"{len(gross)} grossly wrong, {sum(row['usable'] for row in gross)} of these usable, "
        f"{sum(row['processor_s'] for row in answered):.0f} s of processor"
    )


def widths(
    rows: Mapping[str, Mapping[str, Any]], stored: Mapping[str, Mapping[str, Any]], names: list[str]
) -> str:
    """Return the median ratio of half widths for each parameter that both runs know on three draws or more."""
    ratios: dict[str, list[float]] = {}
    for name in names:
        own, before = (run.get(name, {}).get("widths", {}) for run in (rows, stored))
        for parameter in own.keys() & before.keys():
            ratios.setdefault(parameter, []).append(own[parameter] / before[parameter])
    return ", ".join(
        f"{name} {np.median(found):.2f}" for name, found in sorted(ratios.items()) if len(found) > 2
    )


if __name__ == "__main__":
    main()
