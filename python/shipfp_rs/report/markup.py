"""Pieces of HTML: tables that sort, lists, sections. Whatever is not HTML already is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Parameters
    ----------
    text
        What it shows, not yet escaped.
    number
        Whether it is set to the right, as figures are.
    tone
        "good", "warn", "bad", "note" or nothing.
    code
        Whether it is a name out of a file or a program.
    key
        What it is sorted by; None: its text, as a number where it begins with one.
    """

    text: str
    number: bool = False
    tone: str = ""
    code: bool = False
    key: float | None = None

    def html(self, tag: str = "td") -> str:
        """Return the element."""
        classes = " ".join(part for part in ("number" if self.number else "", self.tone) if part)
        attributes = f' class="{classes}"' if classes else ""
        if self.key is not None:
            attributes += f' data-key="{self.key!r}"'
        if tag == "th":
            attributes += ' scope="row"'
        text = escape(self.text)
        return f"<{tag}{attributes}>{f'<code>{text}</code>' if self.code else text}</{tag}>"


def number(text: str, tone: str = "", key: float | None = None) -> Cell:
    """Return a cell for a figure."""
    return Cell(text, number=True, tone=tone, key=key)


def table(about: str, head: Sequence[str], rows: Iterable[Sequence[Cell]], *, tail: int = 0) -> str:
    """Return a table that sorts by a click on its heads; `tail` rows at its end stay there.

    Parameters
    ----------
    about
        What the table holds, for readers who do not see it.
    head
        Names of the columns, those of figures to the right as in the first row.
    rows
        Cells of each row, the first one its name.
    tail
        Number of last rows that are no part of what is sorted.
    """
    lines = [*rows]
    first = lines[0] if lines else ()
    heads = "".join(
        f'<th scope="col"{_to_right(first, index)}>{escape(name)}</th>' for index, name in enumerate(head)
    )

    def body(part: Sequence[Sequence[Cell]]) -> str:
        return "".join(
            "<tr>"
            + "".join(cell.html("td" if column else "th") for column, cell in enumerate(line))
            + "</tr>\n"
            for line in part
        )

    end = len(lines) - tail
    foot = f"<tfoot>{body(lines[end:])}</tfoot>" if tail else ""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(about)}"><table class="sortable">'
        f'<caption class="unseen">{escape(about)}</caption><thead><tr>{heads}</tr></thead>\n'
        f"<tbody>{body(lines[:end])}</tbody>{foot}</table></div>"
    )


def _to_right(cells: Sequence[Cell], index: int) -> str:
    return ' class="number"' if index < len(cells) and cells[index].number else ""


def section(anchor: str, title: str, parts: Iterable[str]) -> str:
    """Return a section with its heading, which the table of contents points at."""
    content = "\n".join(part for part in parts if part)
    return (
        f'<section aria-labelledby="{anchor}"><h2 id="{anchor}">{escape(title)}</h2>\n{content}\n</section>'
    )


def bullets(lines: Iterable[str]) -> str:
    """Return a list."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def paragraph(text: str, tone: str = "") -> str:
    """Return a paragraph."""
    return f'<p class="{tone}">{escape(text)}</p>' if tone else f"<p>{escape(text)}</p>"


def details(summary: str, content: str, *, printed: bool = True) -> str:
    """Return what is shown on demand, and on paper, where nobody can ask for it, if it is to be printed."""
    kind = "" if printed else ' class="unprinted"'
    return f"<details{kind}><summary>{escape(summary)}</summary>{content}</details>"


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
