"""Language of a report: translation of English texts, with words that suit the trial's drive and load."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

from shipfp_rs.identification import driven
from shipfp_rs.structures import glossary
from shipfp_rs.structures.names import plain_name
from shipfp_rs.support.checks import one_of
from shipfp_rs.support.languages import LANGUAGES, catalogue
from shipfp_rs.support.sentences import Sentence, filled

NUMBER = re.compile(r"[-+]?\d+\.\d+(e[-+]?\d+)?")
POINT = re.compile(r"(?<=\d)\.(?=\d)")
"""A decimal point between two digits."""
KINDS = {
    "sine": "one sine",
    "sines": "sines one after the other",
    "chirp": "chirp, a gliding sine",
    "multisine": "sum of sines",
    "squares": "square waves",
    "prbs": "pseudo-random steps",
}
"""Motion of the set point by kind of window; other kinds are plain or the user's own words."""
LABEL = re.compile(r"(.*?)((?: (?:[$\[(]|\w+_).*)?)$")
"""A label: its words, followed by symbols, units and fractions."""
CELL = re.compile(r'(<td class="number[^>]*>)([^<]*)')
"""A numeric table cell: its opening tag and its text."""


class Say:
    """Translator of report texts into one language; `instead` replaces words that do not suit the trial's drive or load."""

    def __init__(self, language: str = "en", instead: Iterable[str] = ()) -> None:
        one_of("language", language, LANGUAGES)
        self.language = language
        self._translated = catalogue(language).gettext
        self._decimal = self._translated("1.5")[1]
        self._instead = driven.pairs_of(map(self._translated, instead))

    def __call__(self, text: str, /, **values: Any) -> str:
        """Translate a text and fill in its fields; texts missing from the catalogue stay English."""
        return self.told(Sentence(text, **values) if values else text, self.figure)

    def each(self, *texts: str) -> list[str]:
        """Translate each text, such as the headings of a table; empty ones stay empty."""
        return [self(text) for text in texts]

    def told(self, text: str, leaf: Callable[[str], str]) -> str:
        """Translate a text; `leaf` formats its values that are not sentences."""
        template = text.template if isinstance(text, Sentence) else text
        said = self.fitting(self._translated(template)) if template else ""
        if not isinstance(text, Sentence):
            return said
        values = {
            name: self.told(one, leaf) if isinstance(one, Sentence) else leaf(one)
            for name, one in text.values.items()
        }
        return filled(said, values)

    def fitting(self, text: str) -> str:
        """Replace words of a text that do not suit the trial's drive and load."""
        return driven.fitting(text, self._instead, is_english=self.language == "en")

    def figure(self, text: str) -> str:
        """Format a value; numbers with the language's decimal sign."""
        return self.number(text) if NUMBER.fullmatch(text) else text

    def number(self, text: str) -> str:
        """Replace decimal points in numbers by the language's decimal sign."""
        return POINT.sub(self._decimal, text)

    def cells(self, page: str) -> str:
        """Replace decimal points in the numeric cells of a page."""
        return CELL.sub(lambda found: found[1] + self.number(found[2]), page)

    def called(self, experiment: str, kind: str, driver: str = "set point") -> str:
        """Name of an experiment and the motion of its set point or other driver, if known."""
        if not kind:
            return experiment
        return f"{experiment} ({self(driver)}: {self(KINDS.get(kind, kind))})"

    def name(self, symbol: str) -> str:
        """Plain name of a parameter or combination, followed in brackets by the part of a joint structure."""
        own, bracket, part = symbol.partition(" (")
        return self(plain_name(own)) + bracket + part if plain_name(symbol) else ""

    def meaning(self, symbol: str) -> str:
        """Meaning of a parameter; empty for a user's own."""
        return self(glossary.meaning(symbol.partition(" (")[0]))

    def label(self, text: str) -> str:
        """Translate the label of an axis or a legend, except symbols and units."""
        if (said := self(text)) != text:
            return said
        return LABEL.sub(lambda found: self(found[1]) + self.number(found[2]), text, count=1)
