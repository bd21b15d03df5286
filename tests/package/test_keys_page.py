"""The page of keys says what the models say that read the files."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def keys():
    spec = importlib.util.spec_from_file_location("keys", DOCS / "keys.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_agrees_with_the_models(keys):
    assert keys.PAGE.read_text(encoding="utf-8") == keys.page(), "run python docs/keys.py"


def test_every_key_has_a_sentence(keys):
    rows = [line.split(" | ") for line in keys.page().splitlines() if line.startswith("| `")]
    assert len(rows) > 180
    assert [row[0] for row in rows if not row[-1].rstrip(" |").endswith(".")] == []


def test_a_row_has_type_unit_default_and_meaning(keys):
    page = keys.page()
    for row in (
        "| `longest_bridge_s` | number from 1e-06 to 3600 | s | `0.25` | Longest stretch without a valid set point",
        "| `K_i` | number from 1e-05 to 100000 | 1/s | *asked for* | Integral gain",
        '| `location` | "gauge", "brake", "shaft" |  | *needed* | "gauge": strain gauge',
        "| `n_s` | number from 0 to 1 |  | `0.0` | Of the shaft speed. |",
        "| `ship` | table |  |  | Motion of the ship under the thrust",
    ):
        assert row in page


def test_pages_whose_pictures_a_clone_lacks_say_so():
    for page in ("index.md", "gallery/index.md"):
        assert "when the site is built" in (DOCS / page).read_text(encoding="utf-8")
