"""Pictures of the report: static inline SVG, and time plots that zoom.js zooms."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup, escape

from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.identification import wording
from shipfp_rs.plot import style
from shipfp_rs.plot.traces import units
from shipfp_rs.report.fate import Fault, faults
from shipfp_rs.report.markup import Say, link_to, piece
from shipfp_rs.support.arrays import Array, joined, runs
from shipfp_rs.support.sentences import Sentence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import Formatter


VALUES = 2_600_000
"""Largest number of two-byte values in all charts of a page: 6.9 MB as text."""
STEPS = 65_534
"""Number of quantisation steps from a series' smallest to its largest value; one more code marks masked samples."""
MARKS = 4000
"""Faults of one kind and channel closer than this fraction of the record are drawn as one."""
MODEL = "currentColor"
LEAST_SHARE = 0.3
"""Share of the tachometer in a residual's standard deviation (0.3: a tenth of its power) from which the report tells it.
"""

HELP = (
    "Drag across to zoom, double-click to see all. With the keyboard: arrows move, + and − zoom, 0 shows all, "
    "n and p go from fault to fault."
)

SCRIPT = (resources.files("shipfp_rs.report") / "zoom.js").read_text(encoding="utf-8")
BUTTONS = tuple(
    dict.fromkeys(
        text for said in re.findall(r"\.say\(([^()]*)\)", SCRIPT) for text in re.findall(r'"(.+?)"', said)
    )
)
"""Texts of zoom.js."""


def charts(experiments: Sequence[Experiment], simulated: Sequence[Experiment], say: Say) -> list[str]:
    """Interactive figure for each experiment, with all samples if they fit on the page, else extremes of equal stretches."""
    models = [one.outputs for one in simulated] or [{}] * len(experiments)
    total = sum(len(e) * (len(e.signals) + 2 * len(m)) for e, m in zip(experiments, models, strict=True))
    width = 1 if total <= VALUES else -(-2 * total // VALUES)
    return [_chart(e, m, width, say) for e, m in zip(experiments, models, strict=True)]


def _chart(experiment: Experiment, model: Mapping[str, Array], width: int, say: Say) -> str:
    marked = [fault for fault in faults(experiment) if not fault.kept]
    panels = []
    for unit in units(experiment):
        series, left = [], []
        for name, samples in experiment.signals.items():
            if UNITS[name] != unit:
                continue
            label = say.label(style.LABELS[name].translate(str.maketrans("", "", "${}")))
            kind = "broad" if name in model else "dashed" if name == "n_set" else ""
            series.append(_series(label, style.COLOURS[name], samples, width, kind))
            if name in model:
                fitted = model[name]
                series.append(_series(say("model of {name}", name=name), MODEL, fitted, width))
                less = say("{name} minus the model", name=name)
                rest = _series(less, style.GREY, samples - fitted, width)
                about = say("{name} − model [{unit}]", name=name, unit=unit)
                left.append({"label": about, "series": [rest], "marks": []})
        marks = [_mark(fault, experiment, say) for fault in marked if UNITS.get(fault.signal) == unit]
        if not marks:
            marks = [_mark(fault, experiment, say) for fault in _masked(experiment, unit)]
        panels += [{"label": say.label(style.QUANTITIES[unit]), "series": series, "marks": marks}, *left]
    content = {
        "start": experiment.start_s,
        "seconds": experiment.duration,
        "step": width / experiment.rate_hz,
        "panels": panels,
    }
    content["words"] = {text: said for text in BUTTONS if (said := say(text)) != text}
    about = say("{name}: signals, model and residuals over time", name=experiment.name)
    detail = say("every sample is in the page")
    if width > 1:
        detail = say(
            "smallest and largest of every {width} samples ({time} ms) are in the page",
            width=width,
            time=f"{1e3 * width / experiment.rate_hz:.3g}",
        )
    return piece("chart", about, content, detail, say(HELP))


def of_the_tachometer(experiment: Experiment, model: Mapping[str, Array], say: Say) -> str:
    """Sentence on how much of the speed's residual comes from the tachometer's resolution; empty if small or unknown."""
    speed = experiment.provenance.get("speed", {})
    size, name = speed.get("resolution_rpm"), next((one for one in ("n_e", "n_s") if one in model), "")
    if size is None or not name:
        return ""
    left = float(np.nanstd(experiment.signals[name] - model[name]))
    if size < LEAST_SHARE * left:
        return ""
    return say(
        "{name} minus the model: standard deviation {left} rpm. The tachometer resolves about {size} rpm, since the log's "
        "sample rate tells the time of an edge no better (pulses a turn: {pulses}).",
        name=name,
        left=f"{left:.2g}",
        size=f"{size:.2g}",
        pulses=speed.get("pulses_per_rev", ""),
    )


def _masked(experiment: Experiment, unit: str) -> Iterator[Fault]:
    """Yield the masked stretches of all signals with this unit as faults, for a figure whose faults have no places."""
    for name, samples in experiment.signals.items():
        if UNITS[name] == unit and np.isnan(samples).any():
            spans, what = runs(np.isnan(samples)), Sentence("masked samples")
            yield Fault(what, name, Sentence("not fitted"), name, spans, spans / experiment.rate_hz)


def _series(label: str, colour: str, samples: Array, width: int, kind: str = "") -> dict[str, Any]:
    """Samples to draw; `kind` is "broad", "dashed" or empty."""
    thinned = thin(samples, width)
    finite = thinned[np.isfinite(thinned)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    steps = np.where(
        np.isfinite(thinned), np.rint((thinned - low) * (STEPS / ((high - low) or 1.0))), STEPS + 1
    )
    data = base64.b64encode(steps.astype("<u2").tobytes()).decode("ascii")
    drawn = {"label": label, "colour": colour, "kind": kind}
    return {**drawn, "pairs": width > 1, "low": low, "high": high, "data": data}


def thin(samples: Array, width: int) -> Array:
    """Minimum and maximum of each `width` samples, NaN if all are NaN; for width 1, all samples.

    Examples
    --------
    >>> thin(np.array([1.0, 5.0, np.nan, 2.0, 3.0]), 2)
    array([1., 5., 2., 2., 3., 3.])
    """
    if width == 1:
        return samples
    first = np.arange(0, len(samples), width)
    ends = np.fmin.reduceat(samples, first), np.fmax.reduceat(samples, first)
    return np.column_stack(ends).ravel()


def _mark(fault: Fault, experiment: Experiment, say: Say) -> dict[str, Any]:
    """Spans of a fault [s], merged where a screen can't separate them."""
    places = np.round(joined([fault.spans_s], experiment.duration / MARKS), 4)
    what = say(wording.FAULTS.get(fault.kind, fault.kind))
    return {
        "label": f"{what}, {fault.channel}: {say(fault.method)}",
        "kind": fault.kind,
        "cut": fault.cut,
        "count": len(fault.spans_s),
        "spans": places.tolist(),
    }


WIDE = 8.0
"""Width [in] from which a picture scrolls sideways on a phone, so that its text stays legible."""
NARROW = 6.4
"""Width of a picture that a phone shows whole, with larger text [in]."""
LETTER = 0.62
"""Width of a letter relative to the font size."""
MATH = re.compile(r"\\\w+|[${}^_]")
"""Markup of formulas in a label, which is not displayed."""
FINER = re.compile(r"(?<=\.\d)\d+")
"""Digits after the first decimal, which are removed from coordinates."""
INK = "#010203"
"""Placeholder colour of text and axes; the page replaces it by its own, light or dark."""


Point = tuple[str, str, str, float, float, float | str, float | str]


class Pictures:
    """Draws pictures as inline SVG with unique identifiers."""

    def __init__(self, say: Say) -> None:
        self._count = 0
        self._say = say

    def draw(
        self,
        panels: int,
        paint: Callable[[Sequence[Axes]], object],
        caption: str,
        *,
        height: float = 2.0,
        width: float = 9.0,
        sharex: bool = True,
        saved: bool = True,
        table: str = "",
    ) -> str:
        """Figure of stacked `panels`, each `height` inches high, with links to `table` as CSV and, if `saved`, to a PNG."""
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        style: dict[Any, Any] = {"svg.hashsalt": "shipfp", "figure.facecolor": "none"}
        if width < WIDE:
            style["font.size"] = 12.0
        for part in ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"):
            style[part] = INK
        self._count += 1
        with rc_context(style):
            figure = Figure(figsize=(width, 1.0 + height * panels))
            axes = figure.subplots(panels, 1, sharex=sharex, squeeze=False)[:, 0]
            for ax in axes:
                ax.patch.set_alpha(0.0)
            paint([*axes])
            self._translate([*axes])
            _arrange(figure, [*axes])
            buffer = io.StringIO()
            figure.savefig(buffer, format="svg", metadata={"Date": None})
            shown = link_to("text/csv", (table or curves_csv([*axes])).encode()) if saved else ""
        svg = Markup(self._inline(buffer.getvalue(), caption))
        return piece("figure", svg, caption, width < WIDE, shown, f"picture-{self._count}")

    def _translate(self, axes: Sequence[Axes]) -> None:
        """Translate labels and legends; titles are the user's names."""
        for ax in axes:
            for axis in (ax.xaxis, ax.yaxis) if self._say.number("1.5") != "1.5" else ():
                axis.set_major_formatter(_spoken(axis.get_major_formatter(), self._say))
            for text in ax.texts:
                text.set_text(self._say.number(text.get_text()))
            legend = ax.get_legend()
            texts = [ax.xaxis.label, ax.yaxis.label, *(legend.get_texts() if legend is not None else ())]
            for text in texts:
                text.set_text(self._say.label(text.get_text()))

    def _inline(self, svg: str, caption: str) -> str:
        """Adapt SVG to the page: no file header, the page's colours, unique identifiers."""
        svg = svg[svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, count=1, flags=re.DOTALL)
        svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg)
        svg = svg.replace(INK, "currentColor")
        svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>picture{self._count}-", svg)
        # Coordinates to a tenth of a point are finer than any screen and halve the size.
        svg = re.sub(r'\bd="[^"]*"', lambda path: FINER.sub("", path.group()), svg)
        return svg.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', 1)


def _spoken(inner: Formatter, say: Say) -> Formatter:
    """Formatter of tick labels like `inner`, with the language's decimal sign."""
    from matplotlib.ticker import Formatter

    class Spoken(Formatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return say.number(inner(x, pos))

        def format_ticks(self, values: list[float]) -> list[str]:
            return [say.number(text) for text in inner.format_ticks(values)]

        def get_offset(self) -> str:
            return say.number(inner.get_offset())

    return Spoken()


def _arrange(figure: Figure, axes: Sequence[Axes]) -> None:
    """Make room for labels; their size is estimated from the number of letters, since drawing them takes far longer."""
    size = float(axes[0].xaxis.label.get_fontsize()) / 72.0
    width, height = figure.get_size_inches()
    left = max(_beside(ax, size) for ax in axes)
    tops = [_above(ax, size) for ax in axes]
    bottoms = [_below(ax, size) for ax in axes]
    right = 1.2 * size
    panel = (height - sum(tops) - sum(bottoms)) / len(axes)
    edge = height
    for ax, top, bottom in zip(axes, tops, bottoms, strict=True):
        edge -= top + panel
        ax.set_position((left / width, edge / height, (width - left - right) / width, panel / height))
        edge -= bottom


def _beside(ax: Axes, size: float) -> float:
    """Room for the labels of the vertical axis and its ticks [in]."""
    low, high = sorted(ax.get_ylim())
    places = [place for place in ax.yaxis.get_majorticklocs() if low <= place <= high]
    texts = [MATH.sub("", text) for text in ax.yaxis.get_major_formatter().format_ticks(places)]
    label = 1.7 * size if ax.get_ylabel() else 0.0
    return LETTER * size * max(map(len, texts), default=0) + label + 1.2 * size


def _above(ax: Axes, size: float) -> float:
    """Room for a legend, or a title [in]."""
    legend = ax.get_legend()
    rows = 0 if legend is None else -(-len(legend.get_texts()) // legend._ncols)  # type: ignore[attr-defined]
    if not rows and ax.get_title(loc="left"):
        rows = 1
    return (0.8 + 1.4 * rows) * size


def _below(ax: Axes, size: float) -> float:
    """Room for the labels of the horizontal axis and its ticks [in]."""
    ticked = any(tick.label1.get_visible() for tick in ax.xaxis.get_major_ticks()[:1])
    return size * ((1.6 if ticked else 0.4) + (1.7 if ax.get_xlabel() else 0.0))


def columns_csv(columns: Mapping[str, Array], digits: int = 9) -> str:
    """CSV of numeric columns, with a header of their names."""
    lines = [",".join(f"{value:.{digits}g}" for value in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([",".join(columns), *lines]) + "\n"


def curves_csv(axes: Sequence[Axes]) -> str:
    """CSV of all points of the panels' lines: both axis labels, series, coordinates, ends of the error bar."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["value_of", "against", "series", "place", "value", "low", "high"])
    for ax in axes:
        for row in _rows(ax, ax.get_xlabel() or axes[-1].get_xlabel()):
            writer.writerow(
                [f"{cell:.9g}" if isinstance(cell, float | np.floating) else cell for cell in row]
            )
    return text.getvalue()


def _rows(ax: Axes, against: str) -> Iterator[Point]:
    """Yield the points of a panel's lines, except lines across the whole panel, such as limits."""
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
        x, y = (np.asarray(values, dtype=np.float64).tolist() for values in line.get_data())
        for place, (across, value) in enumerate(zip(x, y, strict=True)):
            low, high = (ends[place][0][1], ends[place][1][1]) if place < len(ends) else ("", "")
            yield panel, against, series, across, value, low, high
