"""Sentences that keep what they were made of, so that another language can say them, too."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from shipfp_rs.support.checks import expect

FIELD = re.compile(r"{(\w+)}")


def filled(template: str, values: Mapping[str, str]) -> str:
    """Return a template with its fields in braces filled in, those that have a value.

    What a value holds is never read as a template.
    """
    return FIELD.sub(lambda field: values.get(field[1], field[0]), template)


class Sentence(str):
    """An English sentence, or a part of one, with the template that it was made by and the values in it.

    Parameters
    ----------
    template
        English, with named fields in braces; catalogues of other languages know it by this text.
    values
        What fills the fields, those that the template has. One that is a `Sentence` itself is translated, any other stays
        as it is.

    Examples
    --------
    >>> Sentence("The model explains nothing of {output}.", output=Sentence("the torque"))
    'The model explains nothing of the torque.'
    """

    template: str
    values: Mapping[str, str]

    def __new__(cls, template: str, /, **values: object) -> Sentence:
        """Make the sentence, as a text of its own kind."""
        texts = {
            name: value if isinstance(value, str) else str(value)
            for name, value in values.items()
            if f"{{{name}}}" in template
        }
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
        """Return the sentence that a JSON form describes."""
        template, values = entry["template"], entry["values"]
        expect(isinstance(template, str), "sentences: template", template, "a text")
        expect(isinstance(values, Mapping), "sentences: values", values, "a table")
        made = {name: cls.from_dict(one) if isinstance(one, Mapping) else one for name, one in values.items()}
        return cls(template, **made)


def joined(parts: Sequence[str], separator: str = ", ") -> Sentence:
    """Return parts one after the other, each still a part of its own."""
    return Sentence(
        separator.join(f"{{p{place}}}" for place in range(len(parts))),
        **{f"p{place}": part for place, part in enumerate(parts)},
    )


def listed(parts: Sequence[str]) -> str:
    """Return parts as a sentence lists them: "tau_n, g and p"; nothing where there are none."""
    if len(parts) < 2:
        return parts[0] if parts else ""
    return Sentence("{others} and {last}", others=joined(parts[:-1]), last=parts[-1])


def parts_of(content: Any) -> dict[str, Any]:
    """Return the parts of every sentence in nested tables and lists, by its text; those that are all template have none."""
    if isinstance(content, Sentence) and content.values:
        return {content: content.to_dict()}
    if isinstance(content, Mapping):
        content = [*content.values()]
    found: dict[str, Any] = {}
    for one in content if isinstance(content, list | tuple) else ():
        found |= parts_of(one)
    return found


def with_parts(content: Any, parts: Mapping[str, Sentence]) -> Any:
    """Return nested tables and lists, as JSON has them, with sentences in place of the texts of which parts are known."""
    if isinstance(content, str):
        return parts.get(content, content)
    if isinstance(content, Mapping):
        return {key: with_parts(value, parts) for key, value in content.items()}
    if isinstance(content, list):
        return [with_parts(value, parts) for value in content]
    return content
