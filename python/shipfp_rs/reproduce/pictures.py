"""Figures of the thesis drawn again: a title above, a caption below, and what several painters need."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Material = TypeVar("Material")
"""What the painters of a chapter draw from."""
Painter = Callable[[Material, "Figure"], str]

DPI = 130
CAPTION_COLUMNS = 140
NAMES = {
    "n_set": "set point",
    "n_e": "speed",
    "M_b": "torque",
    "M_g": "gauge torque",
    "E_n": "integrated error",
}


@dataclass(frozen=True)
class Picture(Generic[Material]):
    """A figure: its file, its size, what it shows, and what paints it and returns the caption."""

    file: str
    title: str
    paint: Painter[Material]
    height: float = 5.0


@dataclass(frozen=True)
class Stretch:
    """Part of a record on a panel of its own [s]."""

    start_s: float
    stop_s: float


def save(
    pictures: Sequence[Picture[Material]],
    material: Material,
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write every picture into a folder as PNG; `progress` gets (figures done, figures in all)."""
    for done, picture in enumerate(pictures):
        painted(picture, material).savefig(folder / picture.file, dpi=DPI)
        if progress is not None:
            progress(done + 1, len(pictures))


def painted(picture: Picture[Material], material: Material) -> Figure:
    """Return a figure with its title above and its caption below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, picture.height), layout="constrained")
    caption = picture.paint(material, figure)
    figure.suptitle(picture.title, x=0.01, ha="left", fontsize="large")
    figure.supxlabel(textwrap.fill(caption, CAPTION_COLUMNS), x=0.01, ha="left", fontsize="small")
    return figure


def stretches_of(
    experiment: Experiment,
    figure: Figure,
    signals: Sequence[str],
    stretches: Sequence[Stretch],
    points: Sequence[tuple[float, float, str]] = (),
) -> None:
    """Draw stretches of a record, each on a panel of its own, with single points (time, deviation, label)."""
    panels = figure.subplots(len(stretches), 1, squeeze=False)[:, 0]
    for ax, stretch in zip(panels, stretches, strict=True):
        part = experiment.window(stretch.start_s, min(stretch.stop_s, experiment.duration))
        time = stretch.start_s + part.time
        # The larger signal first, so that it does not hide the smaller one.
        order = sorted(signals, key=lambda name: -float(np.ptp(part.normalised(name))))
        for name in order:
            color = style.COLOURS[name]
            ax.plot(*style.envelope(time, part.normalised(name)), color=color, lw=1.0, label=NAMES[name])
        for at, value, label in points:
            ax.plot(at, value, "o", color=style.RED, label=label)
        style.dress(ax, "deviation [-]", legend=ax is panels[0])
        ax.margins(x=0.01)
    panels[-1].set_xlabel("time [s]")


def legend_above(figure: Figure, ax: Axes) -> None:
    """Put one legend over all panels, beside the title."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper right", ncols=len(labels), frameon=False, fontsize="small"
    )
