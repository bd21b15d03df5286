"""Both sides of the drive train separately: the load from speed and torque alone, and the engine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.identification.estimate import Row
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fingerprint_tables import agreement, beside_the_whole
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, dress
from shipfp_rs.report.language import Say
from shipfp_rs.report.markup import Cell, number, paragraph, piece, table
from shipfp_rs.report.pictures import NARROW, Pictures
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LARGE_IN, SMALL_IN = 1.9, 1.1
"""Height of a panel if the engine's side is not described, and if it is."""
BARS = 2.0
"""Half-length of an error bar, in standard errors."""


def section(fingerprint: Fingerprint, pictures: Pictures, say: Say) -> Iterable[str]:
    """Yield the table of the load's side, and the picture of the engine torque's residual."""
    if fingerprint.load_side:
        yield piece(
            "heading", say("The load's side by itself (speed and torque alone, no model of the engine)")
        )
        rows = [*beside_the_whole(fingerprint)]
        bare = not any(whole.low for _, whole in rows)
        head = [*say.each("symbol", "name", "by itself", "95 % interval"), say("whole model")]
        yield table(
            say("the load's side by itself and by the whole model"),
            [*head, *([] if bare else [say("95 % interval")]), say("unit")],
            [
                [
                    Cell(alone.name, code=True),
                    say.name(alone.name),
                    number(alone.value),
                    number(ends(alone, say)),
                    number(whole.value),
                    *([] if bare else [number(ends(whole, say))]),
                    unit_shown(alone.unit),
                ]
                for alone, whole in rows
            ],
        )
        yield paragraph(say(agreement(fingerprint)))
    curves = fingerprint.adequate.get("engine_curves")
    if not curves or not all(curve["at"] for curve in curves.values()):
        return
    yield piece("heading", say("What the engine's torque has beyond the model"))
    yield pictures.draw(
        len(curves),
        lambda axes: _draw(axes, curves),
        say(
            "Mean of it against the speed error that the governor sees, and against the rate at which the fuel rack moves; "
            "bars of two standard errors. It is zero where the model describes engine and governor. A dead band, or a gain "
            "that grows in steps, makes an S through zero error. A torque limit bends both ends of a curve to the same "
            "side. A limit of the rack's rate makes a step at zero rate, a slower way down bends one end only."
        ),
        height=SMALL_IN if fingerprint.engine_described else LARGE_IN,
        width=NARROW,
        sharex=False,
    )


def ends(row: Row, say: Say) -> str:
    """Format the interval of a row; empty if it has none."""
    return say("{low} to {high}", low=row.low, high=row.high) if row.low else ""


def _draw(axes: Sequence[Axes], curves: Mapping[str, Mapping[str, Sequence[float]]]) -> None:
    labels = {"error": "governor's speed error [%]", "slope": "rate of the fuel rack [%/s]"}
    for ax, (name, curve), colour in zip(axes, curves.items(), (BLUE, ORANGE), strict=True):
        at, torque, std = (100.0 * np.asarray(curve[key]) for key in ("at", "torque", "std"))
        ax.axhline(0.0, color=GREY, lw=1.0)
        ax.errorbar(at, torque, BARS * std, fmt="o-", color=colour, ms=4, lw=1.0, capsize=2)
        dress(ax, "torque [%]", legend=False)
        ax.set_xlabel(labels[name])
