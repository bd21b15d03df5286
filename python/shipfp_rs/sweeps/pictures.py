"""Figures of a sweep: scatter plots of the errors, errors against each factor, and errors against the trial's duration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs.plot.style import BLUE, COMPARED, GREY, RED, dress
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.files import replacing
from shipfp_rs.sweeps.analysis import DURATION, Bins

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shipfp_rs.sweeps import Sweep


MOST_POINTS = 4000
"""Largest number of draws shown; larger sweeps are thinned evenly."""
AXES = {
    "excitation.amplitude_rpm": "amplitude [rpm]",
    "excitation.duration_s": "duration [s]",
    "excitation.rate_hz": "sample rate [Hz]",
    "noise.level": "noise level [-]",
    "noise.correlation": "noise correlation [-]",
    "operating_point.n_e_rpm": "engine speed [rpm]",
}
"""Axis labels of factors; further factors are labelled by their keys, which end in the unit."""


def write_figures(sweep: Sweep, folder: Path) -> list[Path]:
    """Write all figures for which a sweep has draws as PNG; return their paths.

    Raises
    ------
    InputError
        If the folder can't be written.
    """
    names = [name for name in sweep.summary["parameters"] if f"estimate.{name}" in _free(sweep)]
    if not names:
        return []
    columns = _thinned(sweep, names)
    figures = {"scatter_matrix": scatter_matrix(columns, names)}
    if sweep.plan.factors:
        figures["errors"] = errors(sweep, columns, names)
    if sweep.summary["trial_length"]:
        figures["trial_length"] = trial_length(sweep.summary, names)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        with replacing(paths[-1]) as temporary:
            figure.savefig(temporary, format="png", dpi=110)
    return paths


def scatter_matrix(columns: Mapping[str, Array], names: Sequence[str]) -> Figure:
    """Draw the relative errors of each pair of parameters as a scatter plot, and their histograms on the diagonal."""
    figure, panels = _figure(len(names), len(names), 2.1)
    limits = {name: _reach(_error(columns, name)) for name in names}
    for row, upper in enumerate(names):
        for column, lower in enumerate(names):
            ax = panels[row, column]
            x, y = _error(columns, lower), _error(columns, upper)
            ax.set_xlim(-limits[lower], limits[lower])
            if row == column:
                ax.hist(x[np.isfinite(x)], bins=np.linspace(-limits[lower], limits[lower], 31), color=BLUE)
                ax.set_yticks([])
            else:
                ax.plot(x, y, ".", ms=2, color=BLUE, alpha=0.5, rasterized=True)
                ax.set_ylim(-limits[upper], limits[upper])
                ax.axhline(0.0, color=GREY, lw=0.8)
            ax.axvline(0.0, color=GREY, lw=0.8)
            dress(ax, f"error of {upper} [%]" if column == 0 else "", legend=False)
            if row == len(names) - 1:
                ax.set_xlabel(f"error of {lower} [%]")
            else:
                ax.tick_params(labelbottom=False)
            if column and row != column:
                ax.tick_params(labelleft=False)
    return figure


def errors(sweep: Sweep, columns: Mapping[str, Array], names: Sequence[str]) -> Figure:
    """Draw the relative error of each parameter against each factor: every draw, the median, and the middle 90 %."""
    keys = [key for key, factor in sorted(sweep.plan.factors.items()) if not factor.is_text]
    figure, panels = _figure(len(names), max(len(keys), 1), 2.9, 2.0)
    for row, name in enumerate(names):
        error = _error(columns, name)
        reach = _reach(error)
        for column, key in enumerate(keys):
            ax, values = panels[row, column], columns[f"factor.{key}"]
            logarithmic = values.min() > 0.0 and values.max() > 5.0 * values.min()
            if logarithmic:
                ax.set_xscale("log")
            ax.plot(values, error, ".", ms=2, color=GREY, alpha=0.5, rasterized=True)
            at, low, middle, high = _bands(sweep, key, values, error)
            ax.fill_between(at, low, high, color=BLUE, alpha=0.2, label="90 % of draws")
            ax.plot(at, middle, "o-", color=BLUE, ms=3, lw=1.2, label="median")
            ax.axhline(0.0, color=RED, lw=0.8)
            ax.set_ylim(-reach, reach)
            dress(ax, f"error of {name} [%]" if column == 0 else "", legend=row == 0 and column == 0)
            if logarithmic:
                _plain_ticks(ax.xaxis)
            if row == len(names) - 1:
                ax.set_xlabel(AXES.get(key, key))
            else:
                ax.tick_params(labelbottom=False)
            if column:
                ax.tick_params(labelleft=False)
    return figure


def trial_length(summary: Mapping[str, Any], names: Sequence[str]) -> Figure:
    """Draw the 95 % quantile of the errors against the trial's duration, with a line for each level of another factor."""
    others = list(dict.fromkeys(tuple(row["factors"]) for row in summary["trial_length"]))
    figure, panels = _figure(len(others), len(names), 2.9, 2.6)
    for row, other in enumerate(others):
        for column, name in enumerate(names):
            ax = panels[row, column]
            lines = [
                line
                for line in summary["trial_length"]
                if line["parameter"] == name and tuple(line["factors"]) == other
            ]
            for index, line in enumerate(lines):
                label = ", ".join(
                    value if isinstance(value, str) else f"{value:.3g}" for value in line["factors"].values()
                )
                limit = [np.nan if error is None else 100.0 * error for error in line["error_95"]]
                color = COMPARED[index % len(COMPARED)]
                ax.plot(
                    line["durations_s"], limit, "o-", ms=3, lw=1.2, color=color, label=label or "all draws"
                )
            ax.axhline(summary["accuracy_pct"], color=RED, lw=0.8, ls="--")
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_title(name, loc="left", parse_math=False)
            dress(ax, "95 % of errors within [%]" if column == 0 else "", legend=False)
            _plain_ticks(ax.xaxis)
            _plain_ticks(ax.yaxis)
            ax.set_xlabel(AXES[DURATION])
        title = ", ".join(AXES.get(key, key) for key in other)
        panels[row, -1].legend(
            title=title or None, fontsize="small", frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0)
        )
    return figure


def _figure(rows: int, columns: int, width: float, height: float | None = None) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.4 + width * columns, 0.9 + (height or width) * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def _plain_ticks(axis: Any) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _free(sweep: Sweep) -> set[str]:
    return {f"estimate.{parameter.name}" for parameter in sweep.plan.structure.free}


def _thinned(sweep: Sweep, names: Sequence[str]) -> dict[str, Array]:
    """Read the columns that the plots show, of at most `MOST_POINTS` evenly spaced draws of the sweep."""
    wanted = [f"factor.{key}" for key, factor in sweep.plan.factors.items() if not factor.is_text]
    wanted += [f"{figure}.{name}" for figure in ("truth", "estimate") for name in names]
    step = -(-sweep.plan.draws // MOST_POINTS)
    pieces: dict[str, list[Array]] = {column: [] for column in wanted}
    offset = 0
    for batch in sweep.batches(wanted):
        kept = np.arange(-offset % step, len(batch), step)
        offset += len(batch)
        for column in wanted:
            pieces[column].append(
                batch.column(column).to_numpy(zero_copy_only=False).astype(np.float64)[kept]
            )
    return {column: np.concatenate(parts) for column, parts in pieces.items()}


def _error(columns: Mapping[str, Array], name: str) -> Array:
    """Relative error [%], NaN where a draw has no estimate."""
    truth = columns[f"truth.{name}"]
    return np.asarray(100.0 * (columns[f"estimate.{name}"] - truth) / np.abs(truth))


def _reach(error: Array) -> float:
    """Half-width of an axis that holds all but the largest 2 % of the errors."""
    known = np.abs(error[np.isfinite(error)])
    return max(1.2 * float(np.percentile(known, 98)), 0.01) if known.size else 1.0


def _bands(sweep: Sweep, key: str, values: Array, error: Array) -> tuple[Array, Array, Array, Array]:
    """Centre of each non-empty bin of a factor, and the 5, 50 and 95 % quantiles of its errors."""
    bins = Bins.of(key, sweep.plan.factors[key])
    places = bins.places(values)
    rows = []
    for place, label in enumerate(bins.labels):
        known = error[(places == place) & np.isfinite(error)]
        if known.size:
            rows.append((float(label), *np.percentile(known, (5.0, 50.0, 95.0))))
    at, low, middle, high = np.array(sorted(rows)).reshape(-1, 4).T
    return at, low, middle, high
