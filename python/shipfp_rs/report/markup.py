"""Pieces of the report as HTML: tables that sort, lists, figures; the templates escape every text."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from shipfp_rs.support.html import environment

LONGEST_WORD = 24
"""Letters of a word that stays whole in a column."""


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Parameters
    ----------
    text
        What it shows.
    number
        Whether it is set to the right, as figures are.
    tone
        "good", "warn", "bad", "note" or nothing.
    code
        Whether it is a name out of a file or a program.
    key
        Key by which the cell is sorted; None: its text, or the number that the text begins with.
    """

    text: str
    number: bool = False
    tone: str = ""
    code: bool = False
    key: float | None = None

    @property
    def classes(self) -> str:
        """Classes of the element; one with a word that no column has room for may break within words."""
        words = [self.text] if self.code else self.text.split()
        long = any(len(word) > LONGEST_WORD for word in words)
        return " ".join(filter(None, ["number" if self.number else "", self.tone, "long" if long else ""]))

    @property
    def sorted_by(self) -> str:
        """The key with all its digits."""
        return repr(self.key)


Row = Sequence[Cell | str]
"""Cells of a row of a table; a text is a cell of its own."""


def piece(name: str, *content: object) -> Markup:
    """Return one of the macros of `markup.html`, filled in."""
    macro = getattr(environment().get_template("markup.html").module, name)
    return Markup(macro(*content))


def number(text: str, tone: str = "", key: float | None = None) -> Cell:
    """Return a cell for a figure."""
    return Cell(text, number=True, tone=tone, key=key)


def table(about: str, head: Sequence[str], rows: Iterable[Row]) -> Markup:
    """Return a table that sorts by a click on its heads.

    Parameters
    ----------
    about
        What the table holds, for readers who do not see it.
    head
        Names of the columns; those above figures are aligned to the right, as the figures of the first row are.
    rows
        Cells of each row, the first one its name.
    """
    lines = [[one if isinstance(one, Cell) else Cell(one) for one in row] for row in rows]
    return piece("table", about, head, lines)


def bullets(lines: Iterable[str]) -> Markup:
    """Return a list."""
    return piece("bullets", lines)


def paragraph(text: str, tone: str = "") -> Markup:
    """Return a paragraph."""
    return piece("paragraph", text, tone)


def link(text: str, name: str, kind: str, content: bytes) -> Markup:
    """Return a link that saves content, which stands in the page itself, as a file of this name and media type."""
    return piece("link", text, name, link_to(kind, content))


def link_to(kind: str, content: bytes) -> str:
    """Return the address of content that stands in the page itself."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def details(summary: str, content: Markup, *, printed: bool = True) -> Markup:
    """Return what is shown on demand, and on paper, where nobody can ask for it, if it is to be printed."""
    return piece("details", summary, content, printed)


def plain(value: Any) -> str:
    """Write a setting or an account in words."""
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
    """Return a cell for a count, with its per cent of a whole where that is given."""
    text = f"{part:,}".replace(",", "\u202f")
    return number(f"{text} ({100.0 * part / whole:.3g} %)" if part and whole else text, key=part)
