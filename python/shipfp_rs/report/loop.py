"""The speed loop at the estimate: its answer to a step, its poles and margins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.errors import InputError
from shipfp_rs.identification import wording
from shipfp_rs.identification.estimate import Estimate, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, dress
from shipfp_rs.report.answer import interval, unit_shown
from shipfp_rs.report.language import Say
from shipfp_rs.report.markup import Cell, number, paragraph, table
from shipfp_rs.report.pictures import NARROW, Pictures
from shipfp_rs.structures.linearised import StateSpace, state_space
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INSTANTS = 400
LONGER = 2.5
"""Length of the picture over the time of recovery."""


def figures(fingerprint: Fingerprint, structure: Structure | None) -> Mapping[str, Estimate]:
    """Return poles, margins and times; nothing for a structure without a linearisation."""
    if "optimum" not in fingerprint.settings:
        return {}
    try:
        return closed_loop(fingerprint, structure)
    except InputError:
        return {}


def section(
    fingerprint: Fingerprint,
    structure: Structure | None,
    loop: Mapping[str, Estimate],
    pictures: Pictures,
    say: Say,
) -> Iterable[str]:
    """Yield the step response and the table of the loop's figures."""
    if not loop:
        return
    yield paragraph(say("From the model linearised about the operating point, for small motions."))
    if "alternatives" in fingerprint.settings:
        yield paragraph(
            say(
                "The intervals hold as well for structures that fit as well, and for elements that were not found, each at "
                "its limit."
            )
        )
    recovery = loop["recovery time"].value
    if recovery:
        model = structure or Structure.from_dict(fingerprint.structure)
        space = state_space(model, fingerprint.optimum, 5)
        times = np.linspace(0.0, LONGER * recovery, INSTANTS)
        rows = space.step(times)
        text = "time_s," + ",".join(f"{output}_pct" for output in space.outputs) + "\n"
        text += "\n".join(",".join(f"{value:.9g}" for value in line) for line in np.vstack([times, rows]).T)
        yield pictures.draw(
            len(space.outputs),
            lambda axes: _draw(axes, space, times, rows, say),
            say(
                "Answer to a step of the set point by 1 %; the speed stays within 5 % of the step after the dotted line."
            ),
            height=1.6,
            width=NARROW,
            table=text,
        )
    yield table(
        say("poles, margins and gains of the loop"),
        [say(text) for text in ("figure", "estimate", "95 % interval", "unit", "why not")],
        [
            [
                Cell(say.name(row.name) or say.word(row.name)),
                number(row.value, key=loop[row.name].value),
                number(interval(row, loop[row.name], say)),
                Cell(unit_shown(row.unit)),
                Cell(say.word(say.sentence(row.reason)), tone="note"),
            ]
            for row in rounded_rows(loop)
        ],
    )


def _draw(axes: Sequence[Axes], space: StateSpace, times: Array, rows: Array, say: Say) -> None:
    for ax, output, row in zip(axes, space.outputs, rows, strict=True):
        ax.plot(times, row, color=BLUE if output == "dn" else ORANGE, lw=1.6)
        if output == "dn":
            inside = np.flatnonzero(np.abs(row - 1.0) > 0.05)
            ax.axhline(1.0, color=GREY, lw=0.8, ls="--")
            ax.axvline(times[inside[-1]], color=GREY, lw=1.0, ls=":")
        dress(ax, f"{say.word(wording.OUTPUTS.get(output, output))} [%]", legend=False)
    axes[-1].set_xlabel(say("time [s]"))
    axes[-1].set_xlim(0.0, times[-1])
