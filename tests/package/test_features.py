"""Each feature that README.md and the pages under docs promise stands in features.csv, beside a test that there is."""

from __future__ import annotations

import ast
import csv
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLES = {f"docs/background/{name}.md" for name in ("keys", "api", "glossary")}
TABLES |= {page.relative_to(ROOT).as_posix() for page in (ROOT / "docs" / "reference").glob("*.md")}
TABLES |= {f"docs/{name}.md" for name in ("changelog", "citing", "install")}
"""Pages that list names, which tests of their own hold, and pages that show a file."""

with Path(__file__).with_name("features.csv").open(encoding="utf-8", newline="") as _file:
    ROWS = list(csv.DictReader(_file))


@cache
def names_in(path: str) -> set[str]:
    """Return the tests of a file as they stand behind it in a node id; nothing is imported."""
    file = ROOT / path
    if not (path.startswith("tests/") and file.name.startswith("test_") and file.is_file()):
        return set()
    found = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
            found |= {f"{node.name}::{part.name}" for part in node.body if isinstance(part, ast.FunctionDef)}
        elif isinstance(node, ast.FunctionDef):
            found.add(node.name)
    return {name for name in found if name.rpartition("::")[2].startswith("test_")}


def test_each_row_names_a_test_that_there_is():
    for row in ROWS:
        path, _, name = row["test"].partition("::")
        # An empty place is a feature that no test protects yet.
        assert not row["test"] or name in names_in(path), f"features.csv, no such test: {row}"


def test_each_page_promises_something():
    pages = {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")} | {"README.md"}
    for row in ROWS:
        assert row["page"] in pages, f"features.csv, no such page: {row}"
    silent = pages - TABLES - {row["page"] for row in ROWS}
    assert not silent, f"features.csv has no row of {sorted(silent)}"


def test_rows_are_whole_sorted_and_none_is_twice():
    for row in ROWS:
        assert list(row) == ["feature", "page", "test"], f"features.csv, not three columns: {row}"
        assert row["feature"], f"features.csv, no feature: {row}"
    twice = [name for name, rows in Counter(row["feature"] for row in ROWS).items() if rows > 1]
    assert not twice, f"features.csv has these twice: {twice}"
    for before, after in pairwise(ROWS):
        in_order = (before["page"], before["feature"]) < (after["page"], after["feature"])
        assert in_order, f"features.csv, not sorted by page, then feature: {after}"
