"""HTML elements of the report: sortable tables, lists, figures; the templates escape every text."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from shipfp_rs.support.html import environment

LONGEST_WORD = 24
"""Longest word that is not broken in a column."""


@dataclass(frozen=True)
class Cell:
    """Cell of a table: text, alignment of numbers, tone ("good", "warn", "bad", "note" or empty), code, and sort key."""

    text: str
    number: bool = False
    tone: str = ""
    code: bool = False
    key: float | None = None

    @property
    def classes(self) -> str:
        """CSS classes of the cell; one with a word too long for a column may break within words."""
        words = [self.text] if self.code else self.text.split()
        long = any(len(word) > LONGEST_WORD for word in words)
        return " ".join(filter(None, ["number" if self.number else "", self.tone, "long" if long else ""]))

    @property
    def sorted_by(self) -> str:
        """Sort key with all its digits."""
        return repr(self.key)


Row = Sequence[Cell | str]
"""Cells of a table's row; a text becomes a cell."""


def piece(name: str, *content: object) -> Markup:
    """Render a macro of `markup.html`."""
    macro = getattr(environment().get_template("markup.html").module, name)
    return Markup(macro(*content))


def number(text: str, tone: str = "", key: float | None = None) -> Cell:
    """Numeric cell."""
    return Cell(text, number=True, tone=tone, key=key)


def table(about: str, head: Sequence[str], rows: Iterable[Row]) -> Markup:
    """Table that is sorted by a click on a heading; `about` describes it for screen readers."""
    lines = [[one if isinstance(one, Cell) else Cell(one) for one in row] for row in rows]
    return piece("table", about, head, lines)


def bullets(lines: Iterable[str]) -> Markup:
    """HTML list."""
    return piece("bullets", lines)


def paragraph(text: str, tone: str = "") -> Markup:
    """HTML paragraph."""
    return piece("paragraph", text, tone)


def link(text: str, name: str, kind: str, content: bytes) -> Markup:
    """Link that saves content embedded in the page as a file with this name and media type."""
    return piece("link", text, name, link_to(kind, content))


def link_to(kind: str, content: bytes) -> str:
    """Data URL of embedded content."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def details(summary: str, content: Markup, *, printed: bool = True) -> Markup:
    """Collapsible content, expanded on paper if `printed`."""
    return piece("details", summary, content, printed)


def plain(value: Any) -> str:
    """Format a setting or a record in words."""
    if isinstance(value, Mapping):
        told = {key: entry for key, entry in value.items() if entry is not None and entry != ""}
        return "; ".join(f"{key}: {plain(entry)}" for key, entry in told.items())
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Iterable):
        return ", ".join(plain(entry) for entry in value)
    return str(value)


def count(part: int, whole: int = 0) -> Cell:
    """Cell with a count, and its percentage of a whole if given."""
    text = f"{part:,}".replace(",", "\u202f")
    return number(f"{text} ({100.0 * part / whole:.3g} %)" if part and whole else text, key=part)
