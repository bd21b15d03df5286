"""The language of a report: English sentences are their own keys, German ones stand in one table."""

from __future__ import annotations

import re
from typing import Any

from shipfp_rs.report.german import LABELS, SENTENCES, WORDS
from shipfp_rs.report.german_meanings import MEANINGS
from shipfp_rs.report.german_verdicts import PHRASES
from shipfp_rs.structures import glossary
from shipfp_rs.structures.names import Language, plain_name
from shipfp_rs.support.checks import one_of

LANGUAGES = ("en", "de")
NUMBER = re.compile(r"-?\d+\.\d+(e-?\d+)?")
POINT = re.compile(r"(?<=\d)\.(?=\d)")
"""A decimal point; a section of a book has one, too, but no sentence that a fingerprint holds names any."""
CELL = re.compile(r'(<td class="number[^>]*>)([^<]*)')
"""A table's cell of figures: what opens it, and its text."""


class Say:
    """Says what a report has to say in one language.

    Parameters
    ----------
    language
        "en" or "de".
    """

    def __init__(self, language: Language = "en") -> None:
        one_of("language", language, LANGUAGES)
        self.language = language

    def __call__(self, text: str, **values: Any) -> str:
        """Return a sentence of the report, its names in braces filled in."""
        said = SENTENCES[text] if self.language == "de" else text
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
        return WORDS.get(text, text) if self.language == "de" else text

    def name(self, symbol: str) -> str:
        """Return the plain name of a parameter or combination."""
        return plain_name(symbol, self.language)

    def meaning(self, symbol: str) -> str:
        """Return what a parameter means; empty for a parameter of a user's own."""
        own = symbol.partition(" (")[0]
        return MEANINGS.get(own, "") if self.language == "de" else glossary.meaning(own)

    def label(self, text: str) -> str:
        """Return the label of an axis or of a legend, its symbols and units as they are."""
        for english, german in LABELS:
            text = re.sub(rf"\b{re.escape(english)}\b", german, text) if self.language == "de" else text
        return text

    def sentence(self, text: str) -> str:
        """Return a sentence of a fingerprint's verdict; as it is where none of the patterns is its own."""
        if self.language == "en":
            return text
        for pattern, said in PHRASES:
            text = re.sub(pattern, said, text)
        return self.number(text)
