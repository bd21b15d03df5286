"""The points that a picture draws, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

Row = tuple[str, str, str, float, float, float | str, float | str]


def curves_csv(axes: Sequence[Axes]) -> str:
    """Return every point of the panels' lines: both axes' names, series, place, value, ends of its bar."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["value_of", "against", "series", "place", "value", "low", "high"])
    for ax in axes:
        for row in _rows(ax, ax.get_xlabel() or axes[-1].get_xlabel()):
            writer.writerow(
                [f"{cell:.9g}" if isinstance(cell, float | np.floating) else cell for cell in row]
            )
    return text.getvalue()


def _rows(ax: Axes, against: str) -> Iterator[Row]:
    """Yield the rows of a panel; lines across all of it, such as a limit's, are no data."""
    from matplotlib.container import ErrorbarContainer

    panel = ax.get_ylabel()
    barred = {one.lines[0]: one for one in ax.containers if isinstance(one, ErrorbarContainer)}
    caps = {cap for container in barred.values() for cap in container.lines[1]}
    for line in ax.lines:
        if line in caps or line.get_transform() != ax.transData:
            continue
        container = barred.get(line)
        label = str(container.get_label() if container is not None else line.get_label())
        series = "" if label.startswith("_") else label
        ends = [bar for bars in container.lines[2] for bar in bars.get_segments()] if container else []
        x, y = _points(line)
        for place, (across, value) in enumerate(zip(x, y, strict=True)):
            low, high = (ends[place][0][1], ends[place][1][1]) if place < len(ends) else ("", "")
            yield panel, against, series, across, value, low, high


def _points(line: Line2D) -> tuple[Sequence[float], Sequence[float]]:
    x, y = (np.asarray(values, dtype=np.float64) for values in line.get_data())
    return x.tolist(), y.tolist()
