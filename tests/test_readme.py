"""The code of the README and of every page of the documentation runs as printed; the README's figures are the command's."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))
from page_code import RUN, SHOWN, blocks, run_page  # noqa: E402 the site's own, which builds with it

README = (ROOT / "README.md").read_text(encoding="utf-8")


PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_code_of_a_page_runs(page, tmp_path):
    printed = run_page(page, tmp_path)
    if page.name == "README.md":
        assert "tau_n=" in printed
    if page.parent.name == "tutorials":
        assert printed
    # A picture that the page shows is one that its code makes.
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", page.read_text(encoding="utf-8")):
        _, _, made = picture.partition(f"made/{page.parent.name}/{page.stem}/")
        assert (tmp_path / made).is_file(), picture


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_of_a_page_is_run_or_can_not_be(page):
    assert {language for language, *_ in blocks(page)} <= {*RUN, *SHOWN}


def test_a_page_whose_code_fails_is_found_out(tmp_path):
    page = tmp_path / "page.md"
    for wrong in (
        "```python\n1 / 0\n```\n",
        "```sh\nshipfp simulate stan-lunch\n```\n",
        "```sh\nrm log\n```\n",
    ):
        page.write_text(wrong)
        with pytest.raises((ZeroDivisionError, RuntimeError)):
            run_page(page, tmp_path)


def test_the_table_of_full_scale_results_is_what_the_command_prints(fullscale):
    rows = {(row.case, row.way): row for row in fullscale.rows if row.case in ("ii", "ii, ten points")}
    printed = [
        f"{rows[key].fit['dn']:.1f} / {rows[key].fit['dM']:.1f}"
        for key in (("ii", "printed"), ("ii", "thesis"), ("ii", "ours"), ("ii, ten points", "ours"))
    ]
    for figures in printed:
        assert figures in README
    assert (
        f"{rows['ii', 'ours'].parameters['p']:.2f} | {rows['ii', 'ours'].parameters['tau_prop']:.2f}"
        in README
    )
