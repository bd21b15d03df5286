"""The language of a report: English sentences are their own keys, German ones stand in one table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from shipfp_rs.report.german import SENTENCES
from shipfp_rs.report.german_meanings import MEANINGS
from shipfp_rs.report.german_verdicts import PHRASES
from shipfp_rs.report.german_words import LABELS, WORDS
from shipfp_rs.structures import glossary
from shipfp_rs.structures.names import Language, plain_name
from shipfp_rs.support.checks import one_of

LANGUAGES = ("en", "de")
NUMBER = re.compile(r"-?\d+\.\d+(e-?\d+)?")
POINT = re.compile(r"(?<=\d)\.(?=\d)")
"""A decimal point; a section of a book has one, too, but no sentence that a fingerprint holds names any."""
KINDS = {
    "sine": "one sine",
    "sines": "sines one after the other",
    "chirp": "chirp, a gliding sine",
    "multisine": "sum of sines",
    "squares": "square waves",
    "prbs": "pseudo-random steps",
}
"""Kind of a window to what the set point does in it; any other is a plain word, or the user's own."""
CELL = re.compile(r'(<td class="number[^>]*>)([^<]*)')
"""A table's cell of figures: what opens it, and its text."""


class Say:
    """Says what a report has to say in one language.

    Parameters
    ----------
    language
        "en" or "de".
    replacements
        Patterns of words that do not go with the trial's drive or load, each with what to write instead.
    """

    def __init__(
        self, language: Language = "en", replacements: Sequence[tuple[re.Pattern[str], str]] = ()
    ) -> None:
        one_of("language", language, LANGUAGES)
        self.language = language
        self.replacements = replacements

    def fitting(self, text: str) -> str:
        """Return a text of the report in words that go with the trial's drive and load."""
        for pattern, word in self.replacements:
            text = pattern.sub(word, text)
        return text

    def __call__(self, text: str, **values: Any) -> str:
        """Return a sentence of the report, its names in braces filled in."""
        said = self.fitting(SENTENCES[text] if self.language == "de" else text)
        shown = {
            key: self.number(value) if isinstance(value, str) and NUMBER.fullmatch(value) else value
            for key, value in values.items()
        }
        return said.format(**shown) if values else said

    def number(self, text: str) -> str:
        """Return text whose numbers have the language's decimal sign."""
        return POINT.sub(",", text) if self.language == "de" else text

    def cells(self, page: str) -> str:
        """Return a page whose cells of figures have the language's decimal sign."""
        return CELL.sub(lambda found: found[1] + self.number(found[2]), page)

    def word(self, text: str) -> str:
        """Return a word or name that a fingerprint or an experiment holds; as it is where it has no translation."""
        return self.fitting(WORDS.get(text, text) if self.language == "de" else text)

    def called(self, experiment: str, kind: str) -> str:
        """Return an experiment's name and what the set point did in it, where that is known."""
        if not kind:
            return experiment
        return f"{experiment} ({self('set point: {kind}', kind=self.word(KINDS.get(kind, kind)))})"

    def name(self, symbol: str) -> str:
        """Return the plain name of a parameter or combination."""
        return self.fitting(plain_name(symbol, self.language))

    def meaning(self, symbol: str) -> str:
        """Return what a parameter means; empty for a parameter of a user's own."""
        own = symbol.partition(" (")[0]
        return self.fitting(MEANINGS.get(own, "") if self.language == "de" else glossary.meaning(own))

    def label(self, text: str) -> str:
        """Return the label of an axis or of a legend, its symbols and units as they are."""
        for english, german in LABELS:
            text = re.sub(rf"\b{re.escape(english)}\b", german, text) if self.language == "de" else text
        return self.fitting(text)

    def sentence(self, text: str) -> str:
        """Return a sentence of a fingerprint's verdict; as it is where none of the patterns is its own."""
        for pattern, said in PHRASES if self.language == "de" else ():
            text = re.sub(pattern, said, text)
        return self.fitting(self.number(text))
