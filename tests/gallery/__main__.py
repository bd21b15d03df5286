"""`python -m tests.gallery --inputs 10000`: run the gallery and print what became of it."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.gallery.inputs import inputs, prepare
from tests.gallery.outcome import outcome


def main() -> int:
    """Run so many inputs; the status is 1 where any breaks the contract."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="print each input that breaks the contract")
    parser.add_argument("--until", type=float, default=1e9, metavar="S", help="stop after so many seconds")
    wanted = parser.parse_args()
    broken, statuses, by_command = Counter[str](), Counter[str](), Counter[str]()
    slowest, began = 0.0, time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for given in inputs(folder, wanted.inputs, wanted.seed):
            if time.monotonic() - began > wanted.until:
                break
            found = outcome(given, folder)
            statuses[str(found.status)] += 1
            by_command[given.arguments[0]] += 1
            broken.update(found.broken)
            slowest = max(slowest, found.took_s)
            if found.broken and wanted.show:
                line = " ".join(found.line.split())[:300]
                shown = " ".join(word[:40] for word in given.arguments)
                print(
                    f"{', '.join(found.broken)} | {shown} | {given.about} | {found.took_s:.1f} s | {line}",
                    flush=True,
                )
    print(f"{statuses.total()} inputs in {time.monotonic() - began:.0f} s: {dict(by_command)}")
    print(f"status: {dict(statuses)}; slowest {slowest:.1f} s")
    kinds = ("traceback", "panic", "exception", "slow", "not one line", "words of the code")
    others = {kind: count for kind, count in broken.items() if kind.startswith("status")}
    print(f"broken: { ({kind: broken[kind] for kind in kinds} | others) }")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
