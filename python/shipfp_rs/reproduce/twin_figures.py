"""Estimates from each part of the twin's trial, with the true values."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs import plot
from shipfp_rs.plot import style
from shipfp_rs.reproduce import Reproduction
from shipfp_rs.reproduce.pictures import Picture, save
from shipfp_rs.reproduce.twin import FREE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _parts(found: Reproduction, figure: Figure) -> str:
    rows = {(row.way, row.case): row.parameters for row in found.rows}
    truth = {name: float(rows["truth", "truth"][name] or np.nan) for name in FREE}
    parts = [case for way, case in rows if way == "ours"]
    for ax, part in zip(figure.subplots(2, 2).ravel(), parts, strict=False):
        plot.intervals(found.fingerprints[f"ours, {part}"], truth, ax)
        ax.set_title(part, loc="left")
        edge, thesis = ax.get_xlim()[1], rows.get(("thesis", part), {})
        names = [label.get_text().split(" = ")[0] for label in ax.get_yticklabels()]
        for place, name in enumerate(names):
            if (value := thesis.get(name)) is not None:
                off = 100.0 * (value / truth[name] - 1.0)
                at = (float(np.clip(off, -edge, edge)), place)
                ax.plot(*at, "x", color=style.RED, clip_on=False)
                if at[0] != off:
                    ax.annotate(f"{off:+.0f} %", at, (0, 6), textcoords="offset points", fontsize="x-small")
    return (
        "Bars are 95 % intervals of the ship's structure, crosses the thesis's; those with a number lie so far off. "
        "The thesis's takes p for 2 and has neither tau_prop nor dead times."
    )


PICTURES: tuple[Picture[Reproduction], ...] = (
    Picture("twin.png", "The twin's trial: parts beside the truth", _parts, 6.2),
)
FILES = tuple(picture.file for picture in PICTURES)
draw = partial(save, PICTURES)
