"""report.html: one self-contained page: what was found, how sure it is, what happened to the data."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs import plot, wording
from shipfp_rs.experiment import Experiment
from shipfp_rs.files import write_text_atomically
from shipfp_rs.fingerprint import Fingerprint

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#010203"
"""Colour of text and axes in a picture; the page replaces it by its own, light or dark."""
SPANS_SHOWN = 100
"""Places of one kind of repair that are listed; experiments.parquet holds all."""
DIALS = {"estimated": "good", "on its bound": "warn", "not identifiable": "bad"}


def write_report(
    path: str | Path,
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    *,
    simulated: Sequence[Mapping[str, Any]] = (),
    truth: Mapping[str, float] | None = None,
    title: str = "Fingerprint",
) -> Path:
    """Write the report of a fingerprint; the file appears whole or not at all.

    Parameters
    ----------
    path
        File to write.
    fingerprint
        The result.
    experiments
        What it was fitted to.
    simulated
        For each experiment, signal name to the fitted model's normalised deviation, shape (N,); may be empty.
    truth
        Name to true value, for simulated logs.
    title
        Headline.

    Returns
    -------
    Path
        `path`.
    """
    return write_text_atomically(
        Path(path), render(fingerprint, experiments, simulated=simulated, truth=truth, title=title)
    )


def render(
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    *,
    simulated: Sequence[Mapping[str, Any]] = (),
    truth: Mapping[str, float] | None = None,
    title: str = "Fingerprint",
) -> str:
    """Return the page of `write_report` as a string."""
    pictures = _Pictures()
    sections = [
        _verdict(fingerprint),
        _parameters(fingerprint, truth, pictures),
        _identifiability(fingerprint),
        _fits(fingerprint, experiments, simulated, pictures),
        _data_quality(experiments, pictures),
        _settings(fingerprint),
    ]
    style = resources.files("shipfp_rs").joinpath("report.css").read_text(encoding="utf-8")
    ship = f"{fingerprint.vessel or 'ship not named'}, structure “{fingerprint.structure.get('name', '')}”"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(ship)}</p>\n'
        + "\n".join(sections)
        + "\n</body>\n</html>\n"
    )


def _verdict(fingerprint: Fingerprint) -> str:
    lines = fingerprint.verdict or ("No verdict was given.",)
    return '<div class="verdict">' + _list(lines) + "</div>"


def _parameters(fingerprint: Fingerprint, truth: Mapping[str, float] | None, pictures: _Pictures) -> str:
    parts = ["<h2>Parameters</h2>", _estimates(wording.rows(fingerprint.parameters, truth), truth)]
    if fingerprint.derived:
        parts += [
            "<h3>Combinations</h3>",
            "<p>Known together, though their members are not known one by one.</p>",
            _estimates(wording.rows(fingerprint.derived, truth), truth),
        ]
    caption = "Estimates with their 95 % intervals, in per cent of the " + (
        "true values that the log was simulated with; red where the interval does not hold the truth."
        if truth
        else "estimate."
    )
    if any(e.ci95 for e in (*fingerprint.parameters.values(), *fingerprint.derived.values())):
        parts.append(pictures.draw(1, lambda axes: plot.intervals(fingerprint, truth, axes[0]), caption))
    return "\n".join(parts)


def _estimates(rows: Iterable[wording.Row], truth: Mapping[str, float] | None) -> str:
    head = [
        "parameter",
        "estimate",
        "std",
        "95 % interval",
        "unit",
        *(["truth"] if truth else []),
        "status",
        "",
    ]
    body = []
    for row in rows:
        interval = f"{row.low} … {row.high}" if row.low else ""
        dial = DIALS.get(row.status, "")
        missed = "bad" if row.holds_truth is False else ""
        body.append(
            f"<tr><td><code>{escape(row.name)}</code></td>{_figure(row.value)}{_figure(row.std)}{_figure(interval)}"
            f"<td>{escape(row.unit)}</td>"
            + (_figure(row.truth, missed) if truth else "")
            + f'<td class="{dial}">{escape(row.status)}</td>'
            f'<td class="note">{escape(row.reason or wording.MEANINGS.get(row.name, ""))}</td></tr>'
        )
    return _table(head, body, figures={1, 2, 3, *([5] if truth else [])})


def _identifiability(fingerprint: Fingerprint) -> str:
    found = fingerprint.identifiability
    parts = ["<h2>What the data can tell</h2>", f"<p>{escape(wording.rank(found))}</p>"]
    if found.null_space:
        parts.append(
            "<p>The model's outputs stay the same when these change together, in the proportion given:</p>"
        )
        parts.append(_list(str(entry["combination"]) for entry in found.null_space))
    if found.closes_gap:
        parts.append("<p>Any one of these, known from elsewhere, would settle the rest:</p>")
        parts.append(_list(found.closes_gap))
    return "\n".join(parts)


def _fits(
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    simulated: Sequence[Mapping[str, Any]],
    pictures: _Pictures,
) -> str:
    lines = [
        (str(record.get("name", "")), output, row)
        for record in fingerprint.data
        for output, row in record.get("fit", {}).items()
    ]
    lines += [("all data", output, row) for output, row in fingerprint.fit.items() if "nrmse_pct" in row]
    body = [
        f"<tr><td>{escape(name)}</td><td>{escape(wording.OUTPUTS.get(output, output))}</td>"
        f"{_figure(_per_cent(row['nrmse_pct']))}</tr>"
        for name, output, row in lines
    ]
    parts = [
        "<h2>Fit</h2>",
        "<p>100 % is a perfect fit, 0 % one no better than the mean (normalised root mean square error).</p>",
        _table(["experiment", "output", "fit [%]"], body, figures={2}),
    ]
    for experiment, model in zip(experiments, simulated, strict=bool(simulated)):
        parts.append(
            pictures.draw(
                len(model),
                partial(plot.fit, experiment, model),
                f"{experiment.name}: measured signals and what the fitted model makes of the same set point.",
            )
        )
    return "\n".join(parts)


def _data_quality(experiments: Sequence[Experiment], pictures: _Pictures) -> str:
    parts = ["<h2>Data</h2>"]
    for experiment in experiments:
        parts.append(f"<h3>{escape(experiment.name)}</h3>")
        kind = f"{experiment.kind}, " if experiment.kind else ""
        about = ", ".join(f"{name} = {value:.6g}" for name, value in experiment.operating_point.items())
        parts.append(
            f"<p>{escape(kind)}{experiment.duration:g} s at {experiment.rate_hz:g} Hz; "
            f"operating point {escape(about)}.</p>"
        )
        parts.append(_repairs(experiment))
        parts.append(_provenance(experiment.provenance))
        panels = len(plot.units(experiment))
        parts.append(
            pictures.draw(
                panels,
                partial(plot.time_series, experiment),
                "Signals after calibration and cleaning; masked samples, marked at the bottom, are not fitted.",
            )
        )
    return "\n".join(parts)


def _repairs(experiment: Experiment) -> str:
    """Say what happened to the samples: how many were masked, and every repair of a raw channel with its place."""
    masked = {
        name: float(np.isnan(samples).mean())
        for name, samples in experiment.signals.items()
        if np.isnan(samples).any()
    }
    shares = ", ".join(f"{100.0 * share:.2g} % of {name}" for name, share in masked.items()) or "none"
    parts = [f"<p>Masked samples: {escape(shares)}.</p>"]
    repairs = experiment.provenance.get("repairs", ())
    if repairs:
        body, places = [], []
        for repair in repairs:
            kind = wording.FAULTS.get(repair["kind"], repair["kind"])
            spans = repair["spans"]
            samples = sum(stop - start for start, stop in spans)
            body.append(
                f"<tr><td>{escape(kind)}</td><td><code>{escape(repair['channel'])}</code></td>"
                f"<td>{escape(repair['method'])}</td>{_figure(str(repair['count']))}{_figure(str(samples))}</tr>"
            )
            shown = ", ".join(f"{start}–{stop - 1}" for start, stop in spans[:SPANS_SHOWN])
            rest = f" and {len(spans) - SPANS_SHOWN} more" if len(spans) > SPANS_SHOWN else ""
            places.append(f"{kind}, {repair['channel']}: {shown}{rest}")
        parts += [
            _table(["fault", "channel", "what was done", "count", "samples"], body, figures={3, 4}),
            "<details><summary>Which samples, counted from each channel's first</summary>",
            _list(places),
            "</details>",
        ]
    return "\n".join(parts)


def _provenance(provenance: Mapping[str, Any]) -> str:
    body = [
        f"<tr><td>{escape(key)}</td><td>{escape(_plain(value))}</td></tr>"
        for key, value in provenance.items()
        if key != "repairs"
    ]
    return (
        f"<details><summary>How the signals were made</summary>{_table(['', ''], body)}</details>"
        if body
        else ""
    )


def _settings(fingerprint: Fingerprint) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in fingerprint.versions.items())
    content = {
        "structure": fingerprint.structure,
        "settings": fingerprint.settings,
        "seed": fingerprint.seed,
    }
    return (
        f"<h2>Settings</h2>\n<p>{escape(versions)}</p>\n"
        "<details><summary>Structure, settings and seed</summary>"
        f"<pre>{escape(_outline(content))}</pre></details>"
    )


def _outline(content: Mapping[str, Any], indent: str = "") -> str:
    """Write nested settings one a line; what is not a table of its own stays on its line."""
    lines = []
    for key, value in content.items():
        if isinstance(value, Mapping) and any(isinstance(entry, Mapping) for entry in value.values()):
            lines += [f"{indent}{key}:", _outline(value, indent + "  ")]
        elif not indent and isinstance(value, Mapping):
            lines += [f"{key}:", _outline(value, "  ")]
        else:
            lines.append(f"{indent}{key}: {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines)


class _Pictures:
    """Draws pictures as inline SVG, each with identifiers of its own."""

    def __init__(self) -> None:
        self._count = 0

    def draw(self, panels: int, paint: Callable[[Sequence[Axes]], object], caption: str) -> str:
        """Return a figure element with `panels` axes above each other, painted by `paint`."""
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        style: dict[Any, Any] = {"svg.hashsalt": "shipfp", "figure.facecolor": "none"}
        for part in ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"):
            style[part] = INK
        self._count += 1
        with rc_context(style):
            figure = Figure(figsize=(9.0, 1.0 + 2.0 * panels), layout="constrained")
            axes = figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
            for ax in axes:
                ax.patch.set_alpha(0.0)
            paint([*axes])
            buffer = io.StringIO()
            figure.savefig(buffer, format="svg", metadata={"Date": None})
        svg = self._inline(buffer.getvalue(), caption)
        return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"

    def _inline(self, svg: str, caption: str) -> str:
        """Strip what only a file of its own needs, take on the page's colour, and make identifiers unique."""
        svg = svg[svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, count=1, flags=re.DOTALL)
        svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg)
        svg = svg.replace(INK, "currentColor")
        svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>picture{self._count}-", svg)
        return svg.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', 1)


def _per_cent(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        told = {key: entry for key, entry in value.items() if entry is not None and entry != ""}
        return "; ".join(f"{key}: {_plain(entry)}" for key, entry in told.items())
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Iterable):
        return ", ".join(_plain(entry) for entry in value)
    return str(value)


def _list(lines: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _figure(text: str, dial: str = "") -> str:
    return f'<td class="figure {dial}">{escape(text)}</td>'


def _table(head: Sequence[str], body: Iterable[str], figures: Iterable[int] = ()) -> str:
    right = set(figures)
    cells = "".join(
        f'<th class="{"figure" * (index in right)}">{escape(name)}</th>' for index, name in enumerate(head)
    )
    top = f"<thead><tr>{cells}</tr></thead>" if any(head) else ""
    return f'<div class="scroll"><table>{top}<tbody>{"".join(body)}</tbody></table></div>'
