"""Checks sizes: no file of Python or Rust over 700 lines (the habit is 400), no function body over 60 without a reason.

The body of a function is what follows its signature and docstring; in Rust what stands between its braces. A longer
function has a comment "long: why" on one of its lines, a longer file among its first 25. Rust's tests at the end of a
file do not count. `STILL` names those that wait to be mended: none joins them, and one that is mended is struck out.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE_LINES = 700
BODY_LINES = 60
HEAD_LINES = 25
REASON = re.compile(r"(#|//) long: \S+")
RUST_FUNCTION = re.compile(r"^( *)(?:pub(?:\([a-z]+\))? )?(?:const )?(?:unsafe )?fn (\w+)")


ROOMS = {
    "Python": "python",
    "identification": "python/shipfp_rs/identification",
    "structures": "python/shipfp_rs/structures",
    "Rust": "rust/src",
    "the ship's stepper": "rust/src/stepper",
    "tests": "tests",
}
"""What is counted: title and folder."""
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


def main() -> int:
    """Print every offender; the exit status is 1 where one is not among `STILL`, or one of these is mended."""
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
    for title, folder in ROOMS.items():
        files = [*(ROOT / folder).rglob("*.py"), *(ROOT / folder).rglob("*.rs")]
        print(
            f"{sum(len(path.read_text(encoding='utf-8').splitlines()) for path in files):7} lines of {title}"
        )
    return 1 if new or mended else 0


if __name__ == "__main__":
    sys.exit(main())
