"""The choice by the data: what each element of the ship model bought, what was left out, what could not be told."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.promise import threshold
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, dress
from shipfp_rs.report.answer import unit_shown
from shipfp_rs.report.findings import not_to_be_used
from shipfp_rs.report.language import Say
from shipfp_rs.report.markup import Cell, number, paragraph, table
from shipfp_rs.report.pictures import NARROW, Pictures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"on": BLUE, "off": GREY, "open": ORANGE}
STATES = {"on": "acts", "off": "not found to act", "open": "undecided"}
TONES = {"on": "good", "off": "", "open": "warn"}


def choice(fingerprint: Fingerprint, pictures: Pictures, say: Say) -> Iterable[str]:
    """Yield the ladder of elements as a picture and as a table."""
    if not fingerprint.elements:
        return
    yield from not_to_be_used(fingerprint, say)
    yield paragraph(
        say(
            "An element is a part of the model that the data can switch on, such as a dead time. The bar shows how much "
            "worse the fit is without an element that acts, or how much better with one that does not."
        )
    )
    rows = list(fingerprint.elements.values())
    yield pictures.draw(
        1,
        lambda axes: ladder(axes[0], rows, say),
        say(
            "Gain of fit by each element, as the change of the deviance. Left of the line the gain may be chance. An "
            "element right of it acts, unless the others explain as much when they are fitted together with it."
        ),
        height=0.2 + 0.36 * len(rows),
        width=NARROW,
        table="element,state,change_of_deviance\n"
        + "".join(f"{row['words']},{row['state']},{row['evidence']}\n" for row in rows),
    )
    head = [say(text) for text in ("element", "found", "change of the deviance", "limit at 95 %")]
    yield table(
        say("elements of the model"),
        head,
        [
            [
                Cell(say.word(str(row["words"]))),
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


def ladder(ax: Axes, rows: Sequence[Mapping[str, Any]], say: Say) -> None:
    """Draw what each element buys, on a logarithmic scale from one up, and what it must buy to be taken on."""
    level = threshold(max(len(rows), 1))
    for place, row in enumerate(reversed(rows)):
        gain, state = _gain(row), row["state"]
        if row["evidence"] is None:
            ax.text(1.15, place, say("forced by the user"), va="center", fontsize="small")
            continue
        ax.barh(place, max(gain, 1.0), left=0.0, height=0.62, color=COLOURS[state])
        words = "the others explain it" if state == "off" and gain > level else STATES[state]
        ax.text(max(gain, 1.0) * 1.15, place, say(words), va="center", fontsize="small")
    ax.axvline(level, color=GREY, lw=1.0, ls="--")
    ax.set_xscale("log")
    most = max((_gain(row) for row in rows), default=1.0)
    ax.set_xlim(1.0, 10.0 ** (math.log10(max(most, 10.0)) * 1.35 + 0.2))
    ax.set_yticks(range(len(rows)), [say.word(str(row["words"])) for row in reversed(rows)])
    ax.set_ylim(-0.6, len(rows) - 0.4)
    ax.set_xlabel(say("change of the deviance [-]"))
    dress(ax, "", legend=False)
    ax.grid(visible=False, axis="y")
