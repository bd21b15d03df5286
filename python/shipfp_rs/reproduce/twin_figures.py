"""What each part of the twin's trial tells, beside the truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.plot import style
from shipfp_rs.reproduce import Reproduction, Row
from shipfp_rs.reproduce.pictures import Picture, legend_above, save
from shipfp_rs.reproduce.twin import FREE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDEST_PCT = 12.0
"""Beyond this a parameter is off; an arrow says which way."""


def draw(folder: Path, found: Reproduction, progress: Callable[[int, int], None] | None = None) -> None:
    """Write the figure into a folder as PNG; `progress` gets (figures done, figures in all)."""
    save(PICTURES, found, folder, progress)


def _parts(found: Reproduction, figure: Figure) -> str:
    truth = next(row for row in found.rows if row.way == "truth").parameters
    ours = [row for row in found.rows if row.way == "ours"]
    thesis = {row.case: row for row in found.rows if row.way == "thesis"}
    panels = figure.subplots(2, 3, sharex=True).ravel()
    for ax, name in zip(panels, FREE, strict=True):
        _parameter(ax, name, float(truth[name] or np.nan), ours, thesis)
    legend_above(figure, panels[2])
    return (
        "Difference from the truth; bars are 95 % intervals. Crosses with a number lie so far off. The thesis's structure "
        "takes p for 2 and has neither tau_prop nor dead times."
    )


def _parameter(
    ax: Axes,
    name: str,
    truth: float,
    ours: list[Row],
    thesis: dict[str, Row],
) -> None:
    def off(value: float) -> float:
        return 100.0 * (value / truth - 1.0)

    reach = 0.0
    for place, row in enumerate(ours):
        low, high = row.intervals[name]
        value = off(float(row.parameters[name] or np.nan))
        first = place == 0
        bars = [[value - off(low)], [off(high) - value]]
        ax.errorbar(
            place,
            value,
            bars,
            fmt="o",
            color=style.BLUE,
            capsize=3,
            label="ship, 95 %" if first else None,
        )
        reach = max(reach, abs(off(low)), abs(off(high)), 0.5)
        if row.case in thesis and (old := thesis[row.case].parameters.get(name)) is not None:
            _marked(ax, place - 0.2, off(old), "thesis's structure" if first else None)
            reach = max(reach, min(abs(off(old)), WIDEST_PCT))
    limit = 1.15 * reach
    ax.axhline(0.0, color="black", lw=0.8)
    ax.set_ylim(-limit, limit)
    ax.set_xlim(-0.5, len(ours) - 0.5)
    ax.set_xticks(range(len(ours)), [row.case.replace(" ", "\n", 1) for row in ours], fontsize="small")
    style.dress(ax, f"{name}, off the truth [%]", legend=False)


def _marked(ax: Axes, place: float, value: float, label: str | None) -> None:
    inside = abs(value) <= WIDEST_PCT
    shown = value if inside else np.sign(value) * 0.9 * WIDEST_PCT
    ax.plot(place, shown, "x", color=style.RED, label=label)
    if not inside:
        ax.annotate(
            f"{value:+.0f} %",
            (place, shown),
            (0, -12 * np.sign(value)),
            textcoords="offset points",
            fontsize="x-small",
            ha="center",
            va="center",
            color=style.RED,
        )


PICTURES: tuple[Picture[Reproduction], ...] = (
    Picture("twin.png", "The twin's trial: parts beside the truth", _parts, 6.2),
)
FILES = tuple(picture.file for picture in PICTURES)
"""Names of the files that `draw` writes."""
