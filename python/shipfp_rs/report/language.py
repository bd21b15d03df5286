"""The language of a report: English texts, said as a catalogue has them and in words that go with the trial."""

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
"""Kind of a window to what the set point does in it; any other is a plain word, or the user's own."""
LABEL = re.compile(r"(.*?)((?: (?:[$\[(]|\w+_).*)?)$")
"""A label: its words, and what follows of symbols, units and shares."""
CELL = re.compile(r'(<td class="number[^>]*>)([^<]*)')
"""A table's cell of figures: what opens it, and its text."""


class Say:
    """Says what a report has to say in one language.

    Parameters
    ----------
    language
        One of `LANGUAGES`.
    instead
        Words that do not go with the trial's drive or load, with what to write in place of them, as `driven` lists them.
    """

    def __init__(self, language: str = "en", instead: Iterable[str] = ()) -> None:
        one_of("language", language, LANGUAGES)
        self.language = language
        self._translated = catalogue(language).gettext
        self._decimal = self._translated("1.5")[1]
        self._instead = driven.pairs_of(map(self._translated, instead))

    def __call__(self, text: str, /, **values: Any) -> str:
        """Return a text, its fields in braces filled in; as it is where the catalogue does not know it."""
        return self.told(Sentence(text, **values) if values else text, self.figure)

    def each(self, *texts: str) -> list[str]:
        """Return texts one by one, as heads of a table; an empty one stays empty."""
        return [self(text) for text in texts]

    def told(self, text: str, leaf: Callable[[str], str]) -> str:
        """Return a text; `leaf` writes the values in it that are no sentences themselves."""
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
        """Return a text of the report in words that go with the trial's drive and load."""
        return driven.fitting(text, self._instead, is_english=self.language == "en")

    def figure(self, text: str) -> str:
        """Return a value; of a number with the language's decimal sign."""
        return self.number(text) if NUMBER.fullmatch(text) else text

    def number(self, text: str) -> str:
        """Return text whose numbers have the language's decimal sign."""
        return POINT.sub(self._decimal, text)

    def cells(self, page: str) -> str:
        """Return a page whose cells of figures have the language's decimal sign."""
        return CELL.sub(lambda found: found[1] + self.number(found[2]), page)

    def called(self, experiment: str, kind: str, driver: str = "set point") -> str:
        """Return an experiment's name and what the set point, or another driver, did in it, where that is known."""
        if not kind:
            return experiment
        return f"{experiment} ({self(driver)}: {self(KINDS.get(kind, kind))})"

    def name(self, symbol: str) -> str:
        """Return the plain name of a parameter or combination, the part of a joint structure in brackets behind it."""
        own, bracket, part = symbol.partition(" (")
        return self(plain_name(own)) + bracket + part if plain_name(symbol) else ""

    def meaning(self, symbol: str) -> str:
        """Return what a parameter means; empty for a parameter of a user's own."""
        return self(glossary.meaning(symbol.partition(" (")[0]))

    def label(self, text: str) -> str:
        """Return the label of an axis or of a legend, its symbols and units as they are."""
        if (said := self(text)) != text:
            return said
        return LABEL.sub(lambda found: self(found[1]) + self.number(found[2]), text, count=1)
