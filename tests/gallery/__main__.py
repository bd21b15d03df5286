"""`python -m tests.gallery --inputs 10000`: run the gallery and print what became of it."""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.gallery.calls import Call
from tests.gallery.inputs import Input, inputs, prepare
from tests.gallery.outcome import Outcome, outcome


def main() -> int:
    """Run so many inputs; the status is 1 where any breaks the contract."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="print each input that breaks the contract")
    parser.add_argument(
        "--accepted", type=int, default=0, metavar="N", help="print every N-th that is accepted"
    )
    parser.add_argument("--until", type=float, default=1e9, metavar="S", help="stop after so many seconds")
    wanted = parser.parse_args()
    broken, statuses, by_command = Counter[str](), Counter[str](), Counter[str]()
    slowest, largest, accepted, began = 0.0, 0.0, 0, time.monotonic()
    _bound_memory()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for given in inputs(folder, wanted.inputs, wanted.seed):
            if time.monotonic() - began > wanted.until:
                break
            found = outcome(given, folder)
            statuses[str(found.status)] += 1
            by_command[given.arguments[0] if isinstance(given, Input) else "Python"] += 1
            accepted += found.status == 0
            broken.update(found.broken)
            slowest, largest = max(slowest, found.took_s), max(largest, found.peak_mib)
            if found.broken and wanted.show:
                print(f"{', '.join(found.broken)} | {_shown(given, found)}", flush=True)
            elif found.status == 0 and wanted.accepted and accepted % wanted.accepted == 0:
                print(f"accepted | {_shown(given, found)} | {' '.join(found.said.split())[:600]}", flush=True)
    print(f"{statuses.total()} inputs in {time.monotonic() - began:.0f} s: {dict(by_command)}")
    print(f"status: {dict(statuses)}; slowest {slowest:.1f} s, most memory {largest:.0f} MiB")
    kinds = (
        "traceback",
        "panic",
        "exception",
        "slow",
        "memory",
        "half written",
        "temporary file",
        "input changed",
        "not one line",
        "words of the code",
    )
    others = {kind: count for kind, count in broken.items() if kind.startswith("status")}
    print(f"broken: { ({kind: broken[kind] for kind in kinds} | others) }")
    return int(bool(broken))


def _shown(given: Input | Call, found: Outcome) -> str:
    words = given.arguments if isinstance(given, Input) else (given.name,)
    shown = " ".join(word[:40] for word in words)
    line = " ".join(found.line.split())[:300] + "".join(
        f" | {name}" for name in [*found.left, *found.changed][:5]
    )
    return f"{shown} | {given.about} | {found.took_s:.1f} s, {found.peak_mib:.0f} MiB | {line}"


def _bound_memory() -> None:
    """Have what asks for memory without bound fail in this process, and harm no other."""
    with contextlib.suppress(ImportError):  # not on Windows
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (12 * 2**30, most))


if __name__ == "__main__":
    sys.exit(main())
