"""Colours, labels and axes shared by all plots."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE, GREEN, PURPLE, GREY, RED = "#3f7fbf", "#d9822b", "#4b9b6b", "#9b6fb5", "#8a8f98", "#cf4d4d"
BROWN = "#9a6b3f"
SET_POINT = GREEN
"""Colour of set points; no other line in the same panel has it."""
LABELS: Mapping[str, str] = {
    "n_set": "set point $n_{set}$",
    "command": "command",
    "n_e": "speed $n_e$",
    "n_s": "shaft speed $n_s$",
    "M_s": "shaft torque $M_s$",
    "M_b": "brake torque $M_b$",
    "M_g": "gauge torque $M_g$",
    "X_f": "fuel rack $X_f$",
    "E_n": "speed error $E_n$",
    "M_load": "load torque $M_{load}$",
}
"""Names of the signals in legends."""
QUANTITIES: Mapping[str, str] = {
    "rpm": "speed [rpm]",
    "": "command",
    "rev/s": "shaft speed [rev/s]",
    "Nm": "torque [Nm]",
    "mm": "fuel rack [mm]",
    "rev": "integrated error [rev]",
}
"""Axis label by unit; signals of one unit share a panel."""
COLOURS: Mapping[str, str] = {
    "n_set": SET_POINT,
    "command": GREY,
    "n_e": BLUE,
    "n_s": BLUE,
    "M_s": ORANGE,
    "M_b": PURPLE,
    "M_g": ORANGE,
    "X_f": BROWN,
    "E_n": BROWN,
    "M_load": GREY,
}
REFLECTORS = (BLUE, ORANGE, GREEN, PURPLE, GREY, RED)
COMPARED = (BLUE, ORANGE, GREEN, PURPLE, RED)
LEGEND_COLUMNS = 5
LETTER_PT, HANDLE_PT = 5.0, 40.0
"""Widths in a legend [pt] at the usual font size of 10 points: of a letter, and of a line's sample with its gaps."""
ENVELOPE_BINS = 1000
"""Number of stretches whose extremes are drawn for a long signal."""


def envelope(time: Array, samples: npt.ArrayLike, bins: int = ENVELOPE_BINS) -> tuple[Array, Array]:
    """Reduce a signal for drawing to the smallest and largest sample of each of `bins` stretches, in order.

    Parameters
    ----------
    time, samples
        Shape (N,); NaN samples are ignored, and a stretch with only NaN stays NaN.
    bins
        Number of stretches.

    Returns
    -------
    tuple of ndarray
        Time and samples, unchanged if N is at most 4 `bins`, else of shape (2 `bins`,).
    """
    values = np.asarray(samples, dtype=np.float64)
    if len(values) <= 4 * bins:
        return time, values
    edges = np.linspace(0, len(values), bins + 1).astype(np.intp)
    lowest = np.where(np.isnan(values), np.inf, values)
    highest = np.where(np.isnan(values), -np.inf, values)
    picked = np.empty((bins, 2), dtype=np.intp)
    for index, (first, last) in enumerate(pairwise(edges)):
        picked[index] = first + np.argmin(lowest[first:last]), first + np.argmax(highest[first:last])
    order = np.sort(picked, axis=1).ravel()
    return time[order], values[order]


def panels_of(axes: Sequence[Axes] | None, count: int, *, sharex: bool = False) -> Sequence[Axes]:
    """Return the given axes, which must be `count`, or `count` new axes below each other."""
    if axes is None:
        from matplotlib import pyplot

        _, made = pyplot.subplots(
            count, 1, sharex=sharex, squeeze=False, layout="constrained", figsize=(8.0, 1.0 + 2.2 * count)
        )
        return [*made[:, 0]]
    if len(axes) != count:
        raise InputError(f"{len(axes)} axes given, expected {count}")
    return axes


def plain_numbers(ax: Axes) -> None:
    """Write tick labels in full, without Matplotlib's common offset for a narrow range."""
    from matplotlib.ticker import ScalarFormatter

    for axis in (ax.xaxis, ax.yaxis):
        formatter = axis.get_major_formatter()
        if isinstance(formatter, ScalarFormatter):
            formatter.set_useOffset(False)


def _columns(ax: Axes) -> int:
    """Number of columns of a legend that fits the width of the figure."""
    from matplotlib import rcParams

    labels = [re.sub(r"\\\w+|[${}^_]", "", label) for label in ax.get_legend_handles_labels()[1]]
    room = 72.0 * float(ax.get_figure(root=True).get_size_inches()[0])  # type: ignore[union-attr]
    scale = rcParams["font.size"] / 10.0
    for count in range(min(len(labels), LEGEND_COLUMNS), 1, -1):
        columns = (max(map(len, part)) for part in np.array_split(np.array(labels, dtype=object), count))
        if scale * sum(LETTER_PT * longest + HANDLE_PT for longest in columns) < room:
            return count
    return 1


def dress(ax: Axes, ylabel: str, *, legend: bool = True) -> None:
    """Add a label, a faint grid and a legend above the axes."""
    ax.set_ylabel(ylabel)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(visible=True, color=GREY, alpha=0.25, lw=0.6)
    ax.set_axisbelow(True)
    plain_numbers(ax)
    if legend:
        # The legend is above the panel, beside the title, where it can't cover a signal.
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=_columns(ax),
            frameon=False,
            fontsize="small",
            borderaxespad=0.2,
        )
