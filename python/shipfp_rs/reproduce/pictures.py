"""Redrawn figures of the thesis: title, caption, and common drawing functions."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from shipfp_rs import plot
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.plot import style
from shipfp_rs.reproduce import Progress, counted
from shipfp_rs.support.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Material = TypeVar("Material")
"""Type of the data for a chapter's figures."""
Painter = Callable[..., str]
"""Function of (material, figure, options) that draws on the figure and returns the caption."""
Stretch = tuple[float, float]
"""Time range of a record in a panel [s]."""

DPI = 130
CAPTION_COLUMNS = 140
NAMES = {
    "n_set": "set point",
    "n_e": "speed",
    "M_b": "torque",
    "M_g": "gauge torque",
    "E_n": "integrated error",
}
DEVIATIONS = {
    "n_e": r"$\delta n^*$ [-]",
    "M_b": r"$\delta M_s^*$ [-]",
    "E_n": r"$\delta E_n^*$ [s]",
    "M_g": r"$\delta M^*$ [-]",
}


@dataclass(frozen=True)
class Picture(Generic[Material]):
    """A figure: file, title, drawing function, and height."""

    file: str
    title: str
    paint: Painter
    height: float = 5.0


def figure_of(number: str, shows: str, paint: Painter, height: float = 5.0, **what: Any) -> Picture[Any]:
    """Return a numbered figure of the thesis; its painter gets the options `what`."""
    chapter, place = number.split(".")
    file = f"fig_{chapter}_{int(place):02}.png"
    return Picture(file, f"Figure {number}: {shows}", partial(paint, **what), height)


def save(
    pictures: Sequence[Picture[Any]], folder: Path, material: Any, progress: Progress | None = None
) -> None:
    """Write all figures to a folder as PNG; `progress` is called with (figures done, number of figures)."""
    for picture in counted(pictures, progress):
        painted(picture, material).savefig(folder / picture.file, dpi=DPI)


def painted(picture: Picture[Any], material: Any) -> Figure:
    """Return a figure with its title above and its caption below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, picture.height), layout="constrained")
    caption = picture.paint(material, figure)
    figure.suptitle(picture.title, x=0.01, ha="left", fontsize="large")
    figure.supxlabel(textwrap.fill(caption, CAPTION_COLUMNS), x=0.01, ha="left", fontsize="small")
    return figure


def dress(ax: Axes, ylabel: str, xlabel: str = "", *, legend: bool = True) -> None:
    """Label both axes, add a grid and optionally a legend."""
    ax.set_xlabel(xlabel)
    style.dress(ax, ylabel, legend=legend)


def record(
    material: Any,
    figure: Figure,
    *,
    of: str,
    signals: Sequence[str],
    stretches: Sequence[Stretch],
    caption: str,
    points: Sequence[tuple[float, float]] = (),
) -> str:
    """Draw time ranges of a record, each in a panel, with marked points (time, deviation)."""
    experiment = material.experiment(of)
    panels = figure.subplots(len(stretches), 1, squeeze=False)[:, 0]
    for ax, (start, stop) in zip(panels, stretches, strict=True):
        part = experiment.window(start, min(stop, experiment.duration))
        # The larger signal first, so that it does not hide the smaller ones.
        for name in sorted(signals, key=lambda name: -float(np.ptp(part.normalised(name)))):
            line(ax, start + part.time, part.normalised(name), style.COLOURS[name], NAMES[name])
        for at, value in points:
            ax.plot(at, value, "o", color=style.RED, label="section 5.1.2")
        dress(ax, "deviation [-]", "time [s]" if ax is panels[-1] else "", legend=ax is panels[0])
        ax.margins(x=0.01)
    return caption


def line(ax: Axes, time: Array, samples: Array, color: str, label: str | None = None, **how: Any) -> None:
    """Draw samples against time, thinned to the resolution of a figure."""
    ax.plot(*style.envelope(time, samples), color=color, label=label, **{"lw": 1.0, **how})


def against(
    figure: Figure,
    data: Experiment,
    models: Mapping[str, Mapping[str, Array]],
    panels: Mapping[str, str],
    stretch: Stretch,
    ship: str = "plant",
) -> None:
    """Draw a time range of signals and models' responses; panels are axis label to signal, or to the models' errors."""
    inside = (data.time >= stretch[0]) & (data.time < stretch[1])
    axes = figure.subplots(len(panels), 1, sharex=True)
    for ax, (ylabel, signal) in zip(axes, panels.items(), strict=True):
        time, measured = data.time[inside], data.normalised(signal)[inside]
        base = measured if ylabel == LESS else 0.0
        line(ax, time, measured - base, style.GREY, ship, lw=3.0)
        for (label, answers), color in zip(models.items(), style.COMPARED, strict=False):
            line(ax, time, answers[signal][inside] - base, color, label)
        dress(ax, ylabel, "time [s]" if ax is axes[-1] else "", legend=False)
    legend_above(figure, axes[0])


LESS = "linear less plant [-]"


def bode_of_sets(
    figure: Figure,
    panels: Sequence[Axes],
    curves: Mapping[str, FrequencyResponse],
    signal: str,
    points: FrequencyResponse,
) -> None:
    """Draw responses of several parameter sets, and measured points; unknown phases are omitted."""
    plot.responses(curves, signal, panels)
    expected = next(iter(curves.values()))
    phase = np.degrees(np.unwrap(np.angle(expected.response[signal])))
    angle = np.degrees(np.angle(points.response[signal]))
    turns = np.round((np.interp(points.frequency_hz, expected.frequency_hz, phase) - angle) / 360.0)
    angle = np.where(points.phase_std[signal] < 1.0, angle + 360.0 * turns, np.nan)
    panels[0].plot(points.frequency_hz, np.abs(points.response[signal]), "k.", ms=6, label="sine fits")
    panels[1].plot(points.frequency_hz, angle, "k.", ms=6)
    if (legend := panels[0].get_legend()) is not None:
        legend.remove()
    legend_above(figure, panels[0])


def legend_above(figure: Figure, ax: Axes) -> None:
    """Put a common legend above all panels, beside the title."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper right", ncols=len(labels), frameon=False, fontsize="small"
    )
