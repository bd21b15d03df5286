"""Pictures of signals against time: as measured, and beside what a model makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.plot.style import COLOURS, GREEN, GREY, LABELS, QUANTITIES, RED, dress, envelope, panels_of
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Mask
from shipfp_rs.support.quantiles import DEVIATIONS_95

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPEEDS = ("n_e", "n_s")


@checked
def time_series(experiment: Experiment, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """Draw the signals of an experiment against time, one panel a unit, masked samples marked at the bottom.

    Parameters
    ----------
    experiment
        What to draw.
    axes
        One a unit among the signals; made where None.

    Returns
    -------
    sequence of Axes
    """
    shown = units(experiment)
    panels = panels_of(axes, len(shown), sharex=True)
    for ax, unit in zip(panels, shown, strict=True):
        masked = np.zeros(len(experiment), dtype=bool)
        for name, samples in experiment.signals.items():
            if UNITS[name] == unit:
                ax.plot(*envelope(experiment.time, samples), color=COLOURS[name], lw=1.0, label=LABELS[name])
                masked |= np.isnan(samples)
        if masked.any():
            _mark(ax, experiment, masked)
        dress(ax, QUANTITIES[unit])
    panels[0].set_title(experiment.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


def units(experiment: Experiment) -> tuple[str, ...]:
    """Return the units among an experiment's signals, the panels of `time_series`."""
    return tuple(dict.fromkeys(UNITS[name] for name in experiment.signals))


@checked
def fit(
    experiment: Experiment,
    simulated: Mapping[str, npt.ArrayLike],
    axes: Sequence[Axes] | None = None,
    *,
    stretch_s: tuple[float, float] | None = None,
) -> Sequence[Axes]:
    """Draw measured signals and the fitted model's, one panel a signal, and the set point beside a speed.

    Parameters
    ----------
    experiment
        The measured signals.
    simulated
        Signal name to the model's normalised deviation (as `Experiment.normalised`), shape (N,).
    axes
        One a signal; made where None.
    stretch_s
        From when to when to draw [s], with the band in which 95 % of the measured samples are to be expected about the
        model: 1.96 standard deviations of what it leaves over in the whole record. None: all of it, without a band.

    Returns
    -------
    sequence of Axes
    """
    panels = panels_of(axes, len(simulated), sharex=True)
    rows = (
        slice(None) if stretch_s is None else slice(*(round(end * experiment.rate_hz) for end in stretch_s))
    )
    time = experiment.time[rows]
    for ax, (name, deviation) in zip(panels, simulated.items(), strict=True):
        model = experiment.operating_point[name] * (1.0 + np.asarray(deviation, dtype=np.float64))
        measured, color = experiment.signals[name], COLOURS[name]
        if stretch_s is not None:
            half = DEVIATIONS_95 * float(np.nanstd(measured - model))
            times, low = envelope(time, model[rows] - half)
            _, high = envelope(time, model[rows] + half)
            ax.fill_between(times, low, high, color=color, alpha=0.2, lw=0.0, label="95 % of samples")
        if name in SPEEDS and "n_set" in experiment.signals:
            point = experiment.operating_point
            scale = 1.0 if UNITS[name] == UNITS["n_set"] else point[name] / point["n_set"]
            asked = scale * experiment.signals["n_set"][rows]
            ax.plot(*envelope(time, asked), color=GREEN, lw=0.8, label="set point")
        ax.plot(*envelope(time, measured[rows]), color=GREY, lw=1.0, label="measured")
        ax.plot(*envelope(time, model[rows]), color=color, lw=1.2, label="model")
        dress(ax, f"{LABELS[name]} [{UNITS[name]}]")
    if stretch_s is None:  # else the legend has its place
        panels[0].set_title(experiment.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


def _mark(ax: Axes, experiment: Experiment, masked: Mask) -> None:
    """Draw a strip along the bottom where samples are masked; its edge keeps a single sample visible."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], masked, [False]]).astype(np.int8)))
    spans = [
        (first / experiment.rate_hz, (last - first) / experiment.rate_hz)
        for first, last in change.reshape(-1, 2)
    ]
    share = 100.0 * masked.mean()
    ax.broken_barh(
        spans,
        (0.0, 0.04),
        transform=ax.get_xaxis_transform(),
        color=RED,
        lw=0.8,
        label=f"masked ({share:.2g} %)",
    )
