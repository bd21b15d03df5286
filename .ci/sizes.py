"""Checks sizes: no file of Python or Rust over 700 lines (the habit is 400), no function body over 60 without a reason.

The body of a function is what follows its signature and docstring; in Rust what stands between its braces. A longer
function has a comment "long: why" on one of its lines, a longer file among its first 25. Rust's tests at the end of a
file do not count. `STILL` names those that wait to be mended: none joins them, and one that is mended is struck out.
`BUDGETS` has the most lines of each room.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE_LINES = 700
BODY_LINES = 60
HEAD_LINES = 25
REASON = re.compile(r"(#|//) long: \S+")
RUST_FUNCTION = re.compile(r"^( *)(?:pub(?:\([a-z]+\))? )?(?:const )?(?:unsafe )?fn (\w+)")


BUDGETS = {
    "constants": 243,
    "python/shipfp_rs/identification": 10394,
    "python/shipfp_rs/structures": 2720,
    "python/shipfp_rs/logs": 7523,
    "python/shipfp_rs/tacho": 1744,
    "python/shipfp_rs/processing": 4524,
    "python/shipfp_rs/inspection": 881,
    "python/shipfp_rs/experiments": 576,
    "python/shipfp_rs/assessment": 2813,
    "python/shipfp_rs/report": 2245,
    "python/shipfp_rs/reproduce": 1799,
    "python/shipfp_rs/view": 2119,
    "python/shipfp_rs/sweeps": 1958,
    "python/shipfp_rs/cli": 2081,
    "python/shipfp_rs/vessel": 1667,
    "python/shipfp_rs/designs": 1542,
    "python/shipfp_rs/support": 2478,
    "python/shipfp_rs/runs": 473,
    "python/shipfp_rs/signals": 880,
    "python/shipfp_rs/simulation": 914,
    "python/shipfp_rs/frequency": 1131,
    "python/shipfp_rs/plot": 974,
    "python/shipfp_rs/exports": 821,
    "python": 52611,
    "rust/src": 9869,
    "tests": 40039,
}
"""Most lines of each room, and most numeric constants of identification and structures. A commit that earns it lowers a
number; none is raised without a word in the commit's text."""
ESTIMATOR = ("python/shipfp_rs/identification", "python/shipfp_rs/structures")
STILL: frozenset[str] = frozenset()


def python_bodies(lines: list[str]) -> Iterator[tuple[str, int, int]]:
    """Yield name, first and last line (from 1) of each function's body."""
    for node in ast.walk(ast.parse("\n".join(lines))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            if body:
                yield node.name, body[0].lineno, node.end_lineno or body[-1].lineno


def rust_bodies(lines: list[str]) -> Iterator[tuple[str, int, int]]:
    """Yield the same of formatted Rust, where a body ends with a brace under the function's first column."""
    for number, line in enumerate(lines):
        found = RUST_FUNCTION.match(line)
        if not found:
            continue
        indent, name = found[1], found[2]
        if line.endswith(";"):  # a trait's function without a body
            continue
        end = next(
            (k for k in range(number, len(lines)) if lines[k].rstrip() in (f"{indent}}}", f"{indent};")),
            number,
        )
        begin = next((k for k in range(number, end) if lines[k].endswith("{")), end)
        yield name, begin + 2, end


def offenders(path: Path) -> Iterator[tuple[str, str]]:
    """Yield a name and a line for the file, and for each of its functions, that is too long."""
    lines = path.read_text(encoding="utf-8").splitlines()
    if path.suffix == ".rs":
        tests = next((k for k, line in enumerate(lines) if line.startswith("#[cfg(test)]")), len(lines))
        lines = lines[:tests]
    name = path.relative_to(ROOT)
    if len(lines) > FILE_LINES and not any(map(REASON.search, lines[:HEAD_LINES])):
        yield str(name), f"{name}: {len(lines)} lines, expected at most {FILE_LINES}"
    bodies = python_bodies(lines) if path.suffix == ".py" else rust_bodies(lines)
    for function, first, last in bodies:
        if last - first + 1 > BODY_LINES and not any(map(REASON.search, lines[first - 1 : last])):
            line = f"{name}:{first}: {function} has {last - first + 1} lines, expected at most {BODY_LINES}"
            yield f"{name} {function}", line


def lines_of(folder: str) -> int:
    """Return the lines of Python and Rust below a folder, or of a package's own modules for "shipfp_rs"."""
    root = ROOT / folder
    files = [*root.rglob("*.py"), *root.rglob("*.rs")]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)


def constants(folders: Iterable[str]) -> int:
    """Return the number of numbers that modules assign to names in capitals."""
    count = 0
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            names = [
                one.id
                for target in targets
                if target
                for one in ast.walk(target)
                if isinstance(one, ast.Name)
            ]
            if getattr(node, "value", None) and names and all(name.isupper() for name in names):
                count += len(names) if holds_number(node.value) else 0
    return count


def holds_number(value: ast.expr) -> bool:
    """Whether an expression is a number, or made of numbers alone."""
    parts = value.elts if isinstance(value, ast.Tuple | ast.List) else [value]
    try:
        return all(isinstance(eval(ast.unparse(one), {"__builtins__": {}}), int | float) for one in parts)
    except Exception:
        return False


def main() -> int:
    """Print every offender; the exit status is 1 for a new one, for one that is mended, or for a room over its budget."""
    paths = sorted([*(ROOT / "python").rglob("*.py"), *(ROOT / "rust" / "src").rglob("*.rs")])
    found = [offender for path in paths for offender in offenders(path)]
    new = [line for name, line in found if name not in STILL]
    mended = sorted(STILL - {name for name, _ in found})
    for title, lines in (
        (f"files or functions too long, of {len(paths)} files", new),
        ("that are still too long", [line for name, line in found if name in STILL]),
        ("to be struck out of STILL, mended", mended),
    ):
        print(f"{len(lines)} {title}")
        for line in lines:
            print(f"    {line}")
    over = False
    for folder, most in BUDGETS.items():
        counted = constants(ESTIMATOR) if folder == "constants" else lines_of(folder)
        over |= counted > most
        print(f"{counted:7} of {most:6}  {folder}{'  OVER ITS BUDGET' if counted > most else ''}")
    return 1 if new or mended or over else 0


if __name__ == "__main__":
    sys.exit(main())
