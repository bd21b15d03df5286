"""Sphinx builds the site: pages in Markdown, their code run and their pictures made on the way, API from docstrings."""

from __future__ import annotations

import os
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import matplotlib as mpl
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
mpl.use("agg")

from page_code import RUN, blocks, run_page  # noqa: E402 lies beside this file

import shipfp_rs  # noqa: E402

project = "shipfp_rs"
author = copyright = "shipfp_rs developers"
version = release = shipfp_rs.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "made"]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"shipfp_rs {release}"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
default_role = "code"


def _run_pages(app: Any) -> None:
    """Run every page's code; what it saves lies in made/FOLDER/PAGE, where the page's pictures are looked for.

    With SHIPFP_PAGES=as-they-are in the environment none is run.
    """
    if os.environ.get("SHIPFP_PAGES") == "as-they-are":
        return
    for page in sorted(HERE.rglob("*.md")):
        if not any(language in RUN for language, *_ in blocks(page)):
            continue
        folder = HERE / "made" / page.relative_to(HERE).with_suffix("")
        if (folder / ".done").exists() and (
            folder / ".done"
        ).stat().st_mtime > page.stat().st_mtime:
            continue
        for old in sorted(folder.rglob("*"), reverse=True):
            old.rmdir() if old.is_dir() else old.unlink()
        folder.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run_page(page, folder)
        (folder / ".done").touch()


_CODE = re.compile(r"(`[^`]*`)")


def _escape(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Keep stars, bars and trailing underscores of formulas from being read as markup of reStructuredText."""
    for index, line in enumerate(lines):
        if line.lstrip().startswith((">>>", "...")) or set(line.strip()) == {"-"}:
            continue
        parts = _CODE.split(line)
        parts[::2] = [re.sub(r"([*|]|_(?=\W|$))", r"\\\1", part) for part in parts[::2]]
        lines[index] = "".join(parts)


def _formula(translator: Any, node: Any) -> None:
    """Write a formula as MathML, which every browser shows without a script from elsewhere."""
    translator.body.append(
        tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block))
    )
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Hook the three steps in."""
    app.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    app.connect("builder-inited", _run_pages)
    app.connect("autodoc-process-docstring", _escape, priority=100)
