"""Zoomable time plots of signals, model, residuals and faults, packed into the page for zoom.js."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from shipfp_rs import plot
from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.identification import wording
from shipfp_rs.plot import style
from shipfp_rs.report.fate import Fault, faults
from shipfp_rs.report.language import Say
from shipfp_rs.report.markup import piece
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spans import runs

VALUES = 2_600_000
"""Two-byte numbers in all charts of a page: 6.9 MB as text."""
STEPS = 65_534
"""Steps from a series' smallest to its largest value; one more code is for masked samples."""
MARKS = 4000
"""Faults of one kind and channel closer than this fraction of the record are drawn as one."""
MODEL = "currentColor"
LEAST_SHARE = 0.3
"""Least fraction of a residual due to the tachometer that is mentioned; a tenth of its power."""

HELP = (
    "Drag across to zoom, double-click to see all. With the keyboard: arrows move, + and − zoom, 0 shows all, "
    "n and p go from fault to fault."
)

BUTTONS = (
    "zoom of",
    "zoom in",
    "zoom out",
    "earlier",
    "later",
    "all",
    "show all",
    "fault",
    "previous fault",
    "next fault",
    "save as CSV",
    "save as PNG",
    "show or hide",
    "zoomable plot",
    "to",
    "of",
    "at",
    "time [s]",
    "time [h:min:s]",
    "masked",
)
"""Texts of zoom.js."""


def charts(experiments: Sequence[Experiment], simulated: Sequence[Experiment], say: Say) -> list[str]:
    """Interactive figure for each experiment.

    Single samples are kept if the page has room for all, else the extremes of equal stretches, so that no peak is lost.
    """
    models = [one.outputs for one in simulated] or [{}] * len(experiments)
    total = sum(len(e) * (len(e.signals) + 2 * len(m)) for e, m in zip(experiments, models, strict=True))
    width = 1 if total <= VALUES else -(-2 * total // VALUES)
    return [_chart(e, m, width, say) for e, m in zip(experiments, models, strict=True)]


def _chart(experiment: Experiment, model: Mapping[str, Array], width: int, say: Say) -> str:
    marked = [fault for fault in faults(experiment) if not fault.kept]
    panels = []
    for unit in plot.signals.units(experiment):
        series, left = [], []
        for name, samples in experiment.signals.items():
            if UNITS[name] != unit:
                continue
            label = say.label(_label(name))
            kind = "broad" if name in model else "dashed" if name == "n_set" else ""
            series.append(_series(label, style.COLOURS[name], samples, width, kind))
            if name in model:
                fitted = model[name]
                series.append(_series(say("model of {name}", name=name), MODEL, fitted, width))
                less = say("{name} minus the model", name=name)
                rest = _series(less, style.GREY, samples - fitted, width)
                left.append(_panel(say("{name} − model [{unit}]", name=name, unit=unit), [rest]))
        marks = [_mark(fault, experiment, say) for fault in marked if UNITS.get(fault.signal) == unit]
        if not marks:
            marks = [_mark(fault, experiment, say) for fault in _masked(experiment, unit)]
        panels += [_panel(say.label(style.QUANTITIES[unit]), series, marks), *left]
    content = {"seconds": experiment.duration, "step": width / experiment.rate_hz, "panels": panels}
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
    """Sentence on the part of the speed's residual due to the resolution of pulses; empty if small or unknown."""
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
    """Yield masked stretches of signals without a localised fault."""
    for name, samples in experiment.signals.items():
        if UNITS[name] == unit and np.isnan(samples).any():
            spans = runs(np.isnan(samples))
            yield Fault(
                Sentence("masked samples"),
                name,
                Sentence("not fitted"),
                name,
                spans,
                spans / experiment.rate_hz,
            )


def _panel(
    label: str, series: Sequence[dict[str, Any]], marks: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    return {"label": label, "series": series, "marks": marks}


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
    """Minimum and maximum of every `width` samples in turn, NaN if all are NaN; all samples for width 1.

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
    spans = fault.spans_s[np.argsort(fault.spans_s[:, 0], kind="stable")]
    ends = np.maximum.accumulate(spans[:, 1])
    apart = np.append(True, spans[1:, 0] - ends[:-1] > experiment.duration / MARKS)
    begins = np.flatnonzero(apart)
    last = np.append(begins[1:], len(spans)) - 1
    places = np.round(np.column_stack([spans[begins, 0], ends[last]]), 4)
    what = say(wording.FAULTS.get(fault.kind, fault.kind))
    return {
        "label": f"{what}, {fault.channel}: {say(fault.method)}",
        "kind": fault.kind,
        "cut": fault.cut,
        "count": len(spans),
        "spans": places.tolist(),
    }


def _label(name: str) -> str:
    return style.LABELS[name].translate(str.maketrans("", "", "${}"))
