"""HTML elements of the report, and its translation; the templates escape every text."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from shipfp_rs.structures import glossary
from shipfp_rs.structures.names import plain_name
from shipfp_rs.support.arguments import one_of
from shipfp_rs.support.files import words_of
from shipfp_rs.support.sentences import LANGUAGES, Sentence, catalogue, filled
from shipfp_rs.support.tables import environment

NUMBER = re.compile(r"[-+]?\d+\.\d+(e[-+]?\d+)?")
POINT = re.compile(r"(?<=\d)\.(?=\d)")
"""A decimal point between two digits."""
KINDS: Mapping[str, str] = words_of("report_words")["motions"]
"""Words for the motion of the set point, by kind of window; any other kind is shown as it is."""
LABEL = re.compile(r"(.*?)((?: (?:[$\[(]|\w+_).*)?)$")
"""A label of an axis or a legend: words, followed by symbols, units and fractions."""
CELL = re.compile(r'(<td class="number[^>]*>)([^<]*)')
"""A numeric table cell: its opening tag and its text."""


class Say:
    """Translator of report texts into one language."""

    def __init__(self, language: str = "en") -> None:
        one_of("language", language, LANGUAGES)
        self.language = language
        self._translated = catalogue(language).gettext
        self._decimal = self._translated("1.5")[1]

    def __call__(self, text: str, /, **values: Any) -> str:
        """Translate a text and fill in its fields; texts missing from the catalogue stay English."""
        return self.told(Sentence(text, **values) if values else text, self.figure)

    def each(self, *texts: str) -> list[str]:
        """Translate each text, such as the headings of a table; empty ones stay empty."""
        return [self(text) for text in texts]

    def told(self, text: str, leaf: Callable[[str], str]) -> str:
        """Translate a text; `leaf` formats field values that are not sentences."""
        template = text.template if isinstance(text, Sentence) else text
        said = self._translated(template) if template else ""
        if not isinstance(text, Sentence):
            return said
        values = {
            name: self.told(one, leaf) if isinstance(one, Sentence) else leaf(one)
            for name, one in text.values.items()
        }
        return filled(said, values)

    def figure(self, text: str) -> str:
        """Format a value; a number gets the language's decimal sign."""
        return self.number(text) if NUMBER.fullmatch(text) else text

    def number(self, text: str) -> str:
        """Replace decimal points in numbers by the language's decimal sign."""
        return POINT.sub(self._decimal, text)

    def cells(self, page: str) -> str:
        """Replace decimal points in the numeric cells of a page."""
        return CELL.sub(lambda found: found[1] + self.number(found[2]), page)

    def called(self, experiment: str, kind: str, driver: str = "set point") -> str:
        """Name of an experiment, and the motion of its set point or other driver if known."""
        if not kind:
            return experiment
        return f"{experiment} ({self(driver)}: {self(KINDS.get(kind, kind))})"

    def name(self, symbol: str) -> str:
        """Plain name of a parameter or combination; in a joint structure, its part follows in brackets."""
        own, bracket, part = symbol.partition(" (")
        return self(plain_name(own)) + bracket + part if plain_name(symbol) else ""

    def meaning(self, symbol: str) -> str:
        """Meaning of a parameter; empty for a parameter that the user defined."""
        return self(glossary.meaning(symbol.partition(" (")[0]))

    def label(self, text: str) -> str:
        """Translate the label of an axis or a legend, except symbols and units."""
        if (said := self(text)) != text:
            return said
        return LABEL.sub(lambda found: self(found[1]) + self.number(found[2]), text, count=1)


LONGEST_WORD = 24
"""Longest word [characters] that is kept whole in a column."""


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
        """CSS classes of the cell; a cell with a word too long for a column may break within words."""
        words = [self.text] if self.code else self.text.split()
        long = any(len(word) > LONGEST_WORD for word in words)
        return " ".join(filter(None, ["number" if self.number else "", self.tone, "long" if long else ""]))

    @property
    def sorted_by(self) -> str:
        """Sort key with all digits of a number."""
        return repr(self.key)


Row = Sequence[Cell | str]
"""Cells of a table's row; a string becomes a cell."""


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
