"""Elements of the ship model: which act, which do not up to a limit, which the data leave open."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.report.answer import unit_shown
from shipfp_rs.report.findings import not_to_be_used
from shipfp_rs.report.language import Say
from shipfp_rs.report.markup import Cell, number, paragraph, table

STATES = {"on": "acts", "off": "not found to act", "open": "undecided"}
TONES = {"on": "good", "off": "", "open": "warn"}


def choice(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    """Yield the elements as a table."""
    if not fingerprint.elements:
        return
    yield from not_to_be_used(fingerprint, say)
    yield paragraph(
        say(
            "An element is a part of the model that may act or not, such as a dead time. It acts where its interval leaves "
            "no room for none, and is undecided where the interval reaches from none to something that would matter."
        )
    )
    head = say.each("element", "found", "change of the deviance", "limit at 95 %")
    yield table(
        say("elements of the model"),
        head,
        [
            [
                Cell(say(row["words"])),
                Cell(say(STATES[row["state"]]), tone="" if fingerprint.why_not else TONES[row["state"]]),
                number("" if row["evidence"] is None else f"{_gain(row):.3g}", key=row["evidence"]),
                Cell(_limit(name, row, say)),
            ]
            for name, row in fingerprint.elements.items()
        ],
    )


def _gain(row: Mapping[str, Any]) -> float:
    """What an element buys; one whose trial fitted worse than none bought nothing."""
    return max(float(row["evidence"] or 0.0), 0.0)


def _limit(name: str, row: Mapping[str, Any], say: Say) -> str:
    limit = row["limit"]
    if not limit:
        return ""
    side = say("above") if name == "torque_limit" else say("below")
    value = say.number(f"{limit['value']:.3g}")
    return f"{limit['parameter']} {side} {value} {unit_shown(limit['unit'])}".strip()
