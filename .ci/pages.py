"""Checks the built site in Chromium: no code of any page, and no page, scrolls sideways in a window 1300 px wide.

    python .ci/pages.py docs/_build

Status 0 also where there is no Chromium; then nothing was checked, which is said.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

WIDTH = 1300
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WIDER = """() => [...document.querySelectorAll("pre"), document.documentElement]
    .filter((element) => element.scrollWidth > element.clientWidth)
    .map((element) => element.tagName === "PRE"
        ? element.innerText.split("\\n").reduce((a, b) => (b.length > a.length ? b : a))
        : "the page itself")"""


def main(site: Path) -> int:
    """Return how many pieces of code are wider than their place, after naming each with its longest line."""
    pages = [page for page in sorted(site.rglob("*.html")) if "_static" not in page.parts]
    if not pages:
        raise SystemExit(f"{site}: no pages, expected a built site")
    if CHROMIUM is None:
        print("no Chromium: whether the site's code scrolls sideways was not checked")
        return 0
    wide = 0
    with sync_playwright() as driver:
        # As root, as in a container, Chromium runs without its sandbox or not at all.
        browser = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"] if os.geteuid() == 0 else []
        )
        window = browser.new_page(viewport={"width": WIDTH, "height": 900})
        for page in pages:
            window.goto(page.resolve().as_uri())
            for line in window.evaluate(WIDER):
                wide += 1
                print(f"{page.relative_to(site)}: wider than a window of {WIDTH} px has room for: {line}")
        browser.close()
    print(f"{len(pages)} pages, {wide} pieces of code too wide")
    return wide


if __name__ == "__main__":
    sys.exit(min(main(Path(sys.argv[1])), 1))
