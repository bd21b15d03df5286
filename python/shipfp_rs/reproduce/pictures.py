"""Pictures of reproduced tables: reproduced values beside printed ones, and measured responses beside modelled ones."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shipfp_rs import plot
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.plot import style
from shipfp_rs.reproduce import Progress, Reproduction, Row, counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 130
WIDTH_IN, LINE_IN, POINT_IN, LEGEND_IN, AROUND_IN = 10.0, 0.45, 0.16, 0.2, 1.6
"""Sizes [in]: width of a picture; heights of a parameter's row (at least), of a point in a row, of an entry of the legend,
and of title, axis and caption together.
"""
CAPTION_COLUMNS = 150
EVEN_PCT = 1.0
"""Distance from the printed value up to which the axis is linear [%]."""
MOST_PCT = 300.0
"""Largest distance on the axis [%]; a point farther off is drawn at the end of the axis, with the distance as text."""
SPREAD = 0.7
"""Share of a parameter's row height over which its points are spread."""
MARKS = "os^Dv"
REFERENCES = ("printed", "truth")
RESPONSES = "responses.png"
LOST_PHASE_STD = 1.0
"""Standard deviation of a phase from which the point is omitted [rad]."""


class Responses(NamedTuple):
    """Measured frequency responses, and at most six models' responses by label; the first is drawn behind the others."""

    measured: FrequencyResponse
    models: Mapping[str, FrequencyResponse]


class Point(NamedTuple):
    """Distances of a reproduced value and of its interval's ends from the reference value, relative to the reference [%]."""

    parameter: str
    off_pct: float
    low_pct: float
    high_pct: float


def files(tables: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the files that `draw` may write."""
    return (RESPONSES, *(_file(table) for table in tables))


def _file(table: str) -> str:
    return f"table_{table.removeprefix('eq. ').replace('.', '_')}.png"


def draw(
    folder: Path,
    found: Reproduction,
    progress: Progress | None = None,
    *,
    responses: Callable[[Reproduction], Responses] | None = None,
) -> None:
    """Write the pictures to a folder as PNG; `progress` is called with (pictures done, number of pictures)."""
    tables = dict.fromkeys(row.table for row in found.rows)
    painters: dict[str, Callable[[], Figure]] = {}
    for table in tables:
        rows = [row for row in found.rows if row.table == table]
        if distances(rows):
            painters[_file(table)] = partial(beside, rows)
    if responses is not None:
        painters[RESPONSES] = lambda: bode(responses(found))
    for name in counted([*painters], progress):
        painters[name]().savefig(folder / name, dpi=DPI)


def distances(rows: Sequence[Row]) -> dict[str, list[Point]]:
    """Return the distances of reproduced values from printed or true ones, by row; values with none or zero are omitted."""
    # The reference row is that of the same case, else of the part of the case before a comma, else the only one.
    references = {row.case: row for row in rows if row.way in REFERENCES}
    found: dict[str, list[Point]] = {}
    for row in rows:
        only = next(iter(references.values())) if len(references) == 1 else None
        printed = references.get(row.case) or references.get(row.case.split(",")[0]) or only
        if row.way in REFERENCES or printed is None:
            continue
        points = []
        for name, value in row.parameters.items():
            reference = printed.parameters.get(name)
            if value is None or not reference:
                continue
            ends = row.intervals.get(name, (value, value))
            points.append(Point(name, *(100.0 * (at - reference) / abs(reference) for at in (value, *ends))))
        if points:
            found[", ".join(part for part in (row.case, row.way, row.structure) if part)] = points
    return found


def beside(rows: Sequence[Row]) -> Figure:
    """Draw a table's reproduced values as distances from the printed values, or from the truth."""
    found = distances(rows)
    names = [*dict.fromkeys(point.parameter for points in found.values() for point in points)]
    references = [row for row in rows if row.way in REFERENCES]
    height = max(max(LINE_IN, POINT_IN * len(found)) * len(names), LEGEND_IN * len(found)) + AROUND_IN
    figure = _figure(height)
    ax = figure.subplots()
    edge = _distance_axis(ax, max(abs(point.off_pct) for points in found.values() for point in points))
    for number, (label, points) in enumerate(found.items()):
        shift = SPREAD * ((number + 0.5) / len(found) - 0.5)
        middle, low, high = np.clip(np.array([point[1:] for point in points]).T, -edge, edge)
        lines = [names.index(point.parameter) + shift for point in points]
        ax.errorbar(
            middle,
            lines,
            xerr=np.maximum([middle - low, high - middle], 0.0),
            fmt=MARKS[number // len(style.COMPARED) % len(MARKS)],
            color=style.COMPARED[number % len(style.COMPARED)],
            ms=5,
            lw=1.2,
            label=label.split(":")[0],
            clip_on=False,
        )
        for point, at, line in zip(points, middle, lines, strict=True):
            if at != point.off_pct:
                near, side = (-8, "right") if at > 0.0 else (8, "left")
                how: dict[str, Any] = {"ha": side, "va": "center", "fontsize": "x-small"}
                ax.annotate(
                    f"{point.off_pct:+.0f} %", (at, line), (near, 0), textcoords="offset points", **how
                )
    ax.axvline(0.0, color=style.GREY, lw=1.0)
    ax.set_yticks(range(len(names)), [_label(name, references) for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)
    truth = references[0].way == "truth"
    ax.set_xlabel(f"distance from the {'truth' if truth else 'printed value'} [%]")
    style.dress(ax, "", legend=False)
    figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    table = rows[0].table
    numbered = table if table.startswith("eq.") or truth else f"Table {table}"
    caption = (
        f"Linear up to {EVEN_PCT:g} %, logarithmic beyond. Bars: 95 % intervals, where there are any. Values that the data "
        "do not determine are not drawn."
    )
    return _titled(figure, f"{numbered}: found beside {'the truth' if truth else 'printed'}", caption)


def _label(name: str, references: Sequence[Row]) -> str:
    """Name of a parameter, with its printed value if the table has only one."""
    printed = {value for row in references if (value := row.parameters.get(name)) is not None}
    return f"{name} = {printed.pop():.4g}" if len(printed) == 1 else name


def _distance_axis(ax: Axes, largest_pct: float) -> float:
    """Make the axis of distances linear about zero and logarithmic beyond; return its end [%]."""
    edge = min(1.5 * max(largest_pct, EVEN_PCT), MOST_PCT)
    ax.set_xscale("symlog", linthresh=EVEN_PCT, linscale=0.5)
    ax.set_xlim(-edge, edge)
    decades = [10.0**power for power in range(int(math.log10(edge)) + 1)]
    ticks = [0.0, *decades, *(-tick for tick in decades)]
    ax.set_xticks(sorted(ticks), [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in sorted(ticks)])
    ax.set_xticks([], minor=True)
    return edge


def bode(responses: Responses) -> Figure:
    """Draw the measured points of each signal's response over the models' curves; unknown phases are omitted."""
    measured, models = responses
    first = next(iter(models.values()))
    signals = [name for name in measured.response if name in first.response]
    figure = _figure(6.4)
    panels = figure.subplots(2, len(signals), sharex=True, squeeze=False)
    for signal, (amplitude, phase) in zip(signals, panels.T, strict=True):
        plot.responses(models, signal, (amplitude, phase))
        points = measured.response[signal]
        expected = np.degrees(np.unwrap(np.angle(first.response[signal])))
        angle = np.degrees(np.angle(points))
        at = np.interp(measured.frequency_hz, first.frequency_hz, expected)
        angle += 360.0 * np.round((at - angle) / 360.0)
        if signal in measured.phase_std:
            angle[measured.phase_std[signal] >= LOST_PHASE_STD] = np.nan
        amplitude.plot(measured.frequency_hz, np.abs(points), "k.", ms=6, label="measured")
        phase.plot(measured.frequency_hz, angle, "k.", ms=6)
        amplitude.set_title(style.LABELS[signal], loc="left")
        phase.tick_params("x", labelsize="x-small")
        if (legend := amplitude.get_legend()) is not None:
            legend.remove()
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels), frameon=False)
    caption = f"Points: {measured.name}. Points whose phase is not known have no phase."
    return _titled(figure, "Responses to the set point", caption)


def _figure(height_in: float) -> Figure:
    from matplotlib.figure import Figure  # takes half a second to load

    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def _titled(figure: Figure, title: str, caption: str) -> Figure:
    """Write a title above a picture and a caption below it."""
    figure.suptitle(title, x=0.01, ha="left", fontsize="large")
    figure.supxlabel(textwrap.fill(caption, CAPTION_COLUMNS), x=0.01, ha="left", fontsize="small")
    return figure
