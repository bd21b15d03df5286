"""What the catalogues of languages must hold: every text that a report can say.

`python -m tests.report.catalogues de` brings `python/shipfp_rs/locale/de` up to date: texts that are new are put in, to be
translated by hand, those that no report says any more go, and the file that is read at run time is compiled.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from babel.messages import Catalog
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

import shipfp_rs
from shipfp_rs.identification import wording
from shipfp_rs.identification.estimate import ALONG, ASSUMED, STATUS
from shipfp_rs.plot import style
from shipfp_rs.plot.estimates import STATES as KNOWN
from shipfp_rs.processing.trial import KINDS as WINDOWS
from shipfp_rs.report.fate import FATES
from shipfp_rs.report.findings import FIGURES, STATES
from shipfp_rs.report.markup import KINDS, LABEL
from shipfp_rs.report.pictures import BUTTONS, HELP
from shipfp_rs.structures import glossary
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.names import NAMES, OF_WHAT
from shipfp_rs.support.sentences import CATALOGUES, DOMAIN, FIELD

SAYS = {"say", "self", "say.each", "Sentence", "_translated"}
"""Calls whose texts are said."""
SOURCE = Path(shipfp_rs.__file__).parent
HEADER = b'msgid ""\nmsgstr "Content-Type: text/plain; charset=utf-8\\n"\n\n'
LABELS = (
    "distance from the truth", "distance from the estimate", "95 % by chance", "95 % of samples", "autocorrelation",
    "95 % band", "missed",
    "with the set point", "lag of the residual behind the set point",
    "lag of the residual behind the set point [samples]", "lag", "lag [samples]", "within", "outside", "measured",
    "model", "model of", "set point", "masked", "time", "frequency", "amplitude ratio", "phase",
    "governor's speed error", "rate of the actuator",
)  # fmt: skip
"""Words of axes and legends that `plot` writes."""
TABLES: tuple[Iterable[str], ...] = (
    *(BUTTONS, [HELP], KNOWN, STATES.values(), FIGURES.values(), LABELS),
    *(NAMES.values(), OF_WHAT.values(), [one.meaning for one in (*glossary.LINEAR, *glossary.FORMULAS)]),
    *([one.words for one in ELEMENTS.values()], STATUS.values(), [ALONG, ASSUMED], wording.OUTPUTS.values()),
    *(FATES.values(), wording.FAULTS.values(), [KINDS.get(kind, kind) for kind in WINDOWS]),
    [LABEL.fullmatch(label)[1] for label in (*style.LABELS.values(), *style.QUANTITIES.values())],
)


def marked(tree: ast.AST) -> Iterator[str]:
    """Yield the texts that a module says, or makes sentences of."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).removeprefix("self.") in SAYS:
            for text in node.args:
                choices = [text.body, text.orelse] if isinstance(text, ast.IfExp) else [text]
                yield from (one.value for one in choices if isinstance(one, ast.Constant))


@cache
def said() -> tuple[str, ...]:
    """Return every text that a report can say; one without a word needs no language."""
    texts = {text for table in TABLES for text in table}
    for source in SOURCE.rglob("*.py"):
        texts |= {
            text for text in marked(ast.parse(source.read_text(encoding="utf-8"))) if isinstance(text, str)
        }
    return tuple(sorted(text for text in texts if any(map(str.isalnum, FIELD.sub("", text)))))


def po_of(language: str) -> Path:
    """Return the file of a language's texts."""
    return CATALOGUES / language / "LC_MESSAGES" / f"{DOMAIN}.po"


def read(language: str) -> Catalog:
    """Return what a file of texts holds; a catalogue without a text where there is none yet."""
    if not po_of(language).exists():
        return Catalog(language)
    with po_of(language).open("rb") as file:
        return read_po(file, language)


def update(language: str) -> list[str]:
    """Bring a language's files up to date, and return what is still to be translated."""
    old = {one.id: one.string for one in read(language) if one.id}
    new = Catalog(language)
    for text in said():
        new.add(text, old.get(text, ""))
        new[text].flags.clear()
    po_of(language).parent.mkdir(parents=True, exist_ok=True)
    with po_of(language).open("wb") as file:
        file.write(HEADER)
        write_po(file, new, width=110, omit_header=True)
    with po_of(language).with_suffix(".mo").open("wb") as file:
        write_mo(file, new)
    return [text for text in said() if not old.get(text)]


if __name__ == "__main__":
    print(*update(sys.argv[1]), sep="\n")
