"""Sentences that keep their template and values, and their translation by the catalogues in `locale`."""

from __future__ import annotations

import gettext
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shipfp_rs.support.arguments import expect

DOMAIN = "shipfp_rs"
CATALOGUES = Path(__file__).parents[1] / "locale"


def found(catalogues: Path) -> tuple[str, ...]:
    """Languages of the catalogues in a folder, English first."""
    return "en", *sorted(path.parts[-3] for path in catalogues.glob(f"*/LC_MESSAGES/{DOMAIN}.mo"))


LANGUAGES = found(CATALOGUES)
"""Languages of reports."""


def catalogue(language: str) -> gettext.NullTranslations:
    """Translations from English into one of `LANGUAGES`."""
    if language == "en":
        return gettext.NullTranslations()
    return gettext.translation(DOMAIN, CATALOGUES, [language])


FIELD = re.compile(r"{(\w+)}")


def filled(template: str, values: Mapping[str, str]) -> str:
    """Replace the fields in braces for which there is a value; braces in values are not replaced."""
    return FIELD.sub(lambda field: values.get(field[1], field[0]), template)


class Sentence(str):
    """English sentence, or part of a sentence, with its template and values for translation.

    Parameters
    ----------
    template
        English text with named fields in braces; the key in the catalogues of other languages.
    values
        Values of the fields. A value that is a `Sentence` is translated, other values are not.

    Examples
    --------
    >>> Sentence("The model explains nothing of {output}.", output=Sentence("the torque"))
    'The model explains nothing of the torque.'
    """

    template: str
    values: Mapping[str, str]

    def __new__(cls, template: str, /, **values: object) -> Sentence:
        """Create the sentence as a `str`."""
        given = ((name, value) for name, value in values.items() if f"{{{name}}}" in template)
        texts = {name: value if isinstance(value, str) else str(value) for name, value in given}
        made = super().__new__(cls, filled(template, texts))
        made.template, made.values = str(template), texts
        return made

    def __getnewargs_ex__(self) -> tuple[tuple[str], dict[str, str]]:
        return (self.template,), dict(self.values)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        values = {
            name: one.to_dict() if isinstance(one, Sentence) else one for name, one in self.values.items()
        }
        return {"template": self.template, "values": values}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Sentence:
        """Sentence from its JSON form."""
        template, values = entry["template"], entry["values"]
        expect(isinstance(template, str), "sentences: template", template, "a text")
        expect(isinstance(values, Mapping), "sentences: values", values, "a table")
        made = {name: cls.from_dict(one) if isinstance(one, Mapping) else one for name, one in values.items()}
        return cls(template, **made)


def joined(parts: Sequence[str], separator: str = ", ") -> Sentence:
    """Join parts into a sentence in which the parts can still be translated."""
    named = {f"p{place}": part for place, part in enumerate(parts)}
    return Sentence(separator.join(f"{{{name}}}" for name in named), **named)


def listed(parts: Sequence[str]) -> str:
    """Enumerate parts, as in "tau_n, g and p"; empty without parts."""
    if len(parts) < 2:
        return parts[0] if parts else ""
    return Sentence("{others} and {last}", others=joined(parts[:-1]), last=parts[-1])


def parts_of(content: Any) -> dict[str, Any]:
    """Templates and values, by text, of all sentences in nested tables and lists; sentences without values are omitted."""
    if isinstance(content, Sentence) and content.values:
        return {content: content.to_dict()}
    if isinstance(content, Mapping):
        content = [*content.values()]
    found: dict[str, Any] = {}
    for one in content if isinstance(content, list | tuple) else ():
        found |= parts_of(one)
    return found


def with_parts(content: Any, parts: Mapping[str, Sentence]) -> Any:
    """Replace texts in nested JSON tables and lists by the sentences whose template and values are given."""
    if isinstance(content, str):
        return parts.get(content, content)
    if isinstance(content, Mapping):
        return {key: with_parts(value, parts) for key, value in content.items()}
    if isinstance(content, list):
        return [with_parts(value, parts) for value in content]
    return content
