"""Plots against time: signals, measured or compared with a model, and pulse trains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, UNITS, Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.plot.style import (
    BLUE,
    COLOURS,
    LABELS,
    QUANTITIES,
    RED,
    REFLECTORS,
    SET_POINT,
    dress,
    envelope,
    panels_of,
)
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import DEVIATIONS_95, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from shipfp_rs.assessment.validation import HeldOut
    from shipfp_rs.identification.fingerprint import Fingerprint
    from shipfp_rs.tacho import PulseTimes, ReflectorAngles


@checked
def pulse_intervals(
    pulses: PulseTimes, pulses_per_rev: int, angles: ReflectorAngles | None = None, ax: Axes | None = None
) -> Axes:
    """Draw each interval between pulses relative to its turn's duration over the number of reflectors.

    At steady speed the intervals lie on one line per reflector. A missed or extra pulse is a cross at the edge; after
    it, the colours of the reflectors are shifted.

    Parameters
    ----------
    pulses
        Crossing times.
    pulses_per_rev
        Number of reflectors.
    angles
        Estimated spacings of the reflectors, drawn as lines.
    ax
        Axes; None: new ones.

    Returns
    -------
    Axes

    Raises
    ------
    InputError
        If there is less than one turn of pulses.
    """
    (ax,) = panels_of(None if ax is None else [ax], 1)
    times = pulses.times_s
    if len(times) <= pulses_per_rev:
        raise InputError(f"{len(times)} pulses, expected more than the {pulses_per_rev} of one turn")
    # SciPy is needed only for this plot.
    from scipy.ndimage import median_filter, uniform_filter1d

    # With the median over nearby turns, a wrong pulse does not change the turn's duration it is compared with.
    period = np.diff(times)
    share = median_filter(uniform_filter1d(period, pulses_per_rev), 4 * pulses_per_rev + 1)
    deviation = 100.0 * (period / share - 1.0)
    place = np.arange(len(period)) % pulses_per_rev
    # The scale fits most intervals; the few beyond it, of wrong pulses, are marked at the edge.
    reach = max(2.0 * float(np.percentile(np.abs(deviation), 98)), 0.1)
    beyond = np.abs(deviation) > reach
    for reflector in range(pulses_per_rev):
        chosen = (place == reflector) & ~beyond
        color = REFLECTORS[reflector % len(REFLECTORS)]
        label = f"interval {reflector + 1} of {pulses_per_rev}"
        ax.plot(times[1:][chosen], deviation[chosen], ".", ms=3, color=color, label=label, rasterized=True)
        if angles is not None:
            share_of_turn = 100.0 * (angles.fractions[reflector] * pulses_per_rev - 1.0)
            ax.axhline(share_of_turn, color=color, lw=0.8, ls="--")
    if beyond.any():
        edge = np.clip(deviation[beyond], -reach, reach)
        ax.plot(times[1:][beyond], edge, "x", ms=6, color=RED, label=f"beyond, {beyond.sum()}", clip_on=False)
    ax.set_ylim(-reach, reach)
    ax.set_xlabel("time [s]")
    dress(ax, "interval over even share of a turn [%]")
    return ax


SPEEDS = ("n_e", "n_s")


@checked
def signals(experiment: Experiment | Excitation, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """Draw the signals of an experiment over the log's clock, one panel per unit, with masked samples marked at the bottom.

    Parameters
    ----------
    experiment
        Experiment with the signals, or an excitation, of which the deviation of the set point is drawn.
    axes
        One per unit of the signals; None: new ones.

    Returns
    -------
    sequence of Axes
    """
    if isinstance(experiment, Excitation):
        (ax,) = panels_of(axes, 1)
        style = "steps-post" if experiment.hold == "zero" else "default"
        drawn = envelope(experiment.time, experiment.samples)
        ax.plot(*drawn, color=SET_POINT, lw=1.0, drawstyle=style)
        dress(ax, "set-point deviation [rpm]", legend=False)
        ax.set_title(experiment.name, loc="left", parse_math=False)
        ax.set_xlabel("time [s]")
        return [ax]
    shown, time = units(experiment), experiment.start_s + experiment.time
    panels = panels_of(axes, len(shown), sharex=True)
    for ax, unit in zip(panels, shown, strict=True):
        masked = np.zeros(len(experiment), dtype=bool)
        for name, samples in experiment.signals.items():
            if UNITS[name] == unit:
                # An input, or a signal whose colour another line in the panel has, is dashed.
                seen = name in DRIVES or COLOURS[name] in [line.get_color() for line in ax.lines]
                drawn, dashes = envelope(time, samples), "--" if seen else "-"
                ax.plot(*drawn, dashes, color=COLOURS[name], lw=1.0, label=LABELS[name])
                masked |= np.isnan(samples)
        if masked.any():
            _mark(ax, experiment, masked)
        dress(ax, QUANTITIES[unit])
    panels[0].set_title(experiment.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


@checked
def log(
    log: Log, channels: Sequence[str] | None = None, axes: Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Draw the channels of a log against its clock, one panel each; long channels are reduced to extremes of stretches.

    Parameters
    ----------
    log
        The recording.
    channels
        Names of channels to draw; None: all that have samples.
    axes
        One per channel; None: new ones.

    Returns
    -------
    sequence of Axes

    Raises
    ------
    InputError
        If there is no such channel, or the number of axes is wrong.

    Examples
    --------
    >>> log(Log.from_arrays({"u": [1.0, 2.0]}, rate_hz=2.0, units={"u": "V"}))  # doctest: +SKIP
    """
    held = [name for name, channel in log.channels.items() if channel.samples]
    shown = [log.channel(name) for name in (held if channels is None else channels)]
    panels = panels_of(axes, len(shown), sharex=True)
    for ax, channel in zip(panels, shown, strict=True):
        times, rows, first = [], [], 0
        for chunk in log.chunks(channel.name):
            time = channel.start_s + (first + np.arange(len(chunk))) / channel.rate_hz
            drawn = envelope(time, chunk)
            times.append(drawn[0])
            rows.append(drawn[1])
            first += len(chunk)
        ax.plot(*envelope(np.concatenate(times), np.concatenate(rows)), color=BLUE, lw=1.0)
        dress(ax, f"{channel.name} [{channel.unit}]" if channel.unit else channel.name, legend=False)
        ax.yaxis.label.set_parse_math(False)
    panels[0].set_title(log.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


def units(experiment: Experiment) -> tuple[str, ...]:
    """Units of an experiment's signals, one per panel of `signals`."""
    return tuple(dict.fromkeys(UNITS[name] for name in experiment.signals))


@checked
def fit(
    measured: Experiment | Fingerprint,
    model: Experiment | None = None,
    axes: Sequence[Axes] | None = None,
    *,
    stretch_s: tuple[float, float] | None = None,
    signals: Sequence[str] | None = None,
) -> Sequence[Axes]:
    """Draw measured and modelled signals, one panel per signal; the panel of a speed also shows the set point.

    Measured signals are broad pale lines in their own colours, the model a thin line in the text colour, the set point
    dashed.

    Parameters
    ----------
    measured
        The measured signals; for a fingerprint, the signals of the first fitted experiment.
    model
        Result of a fingerprint's `predict` or `simulate`; needed unless `measured` is a fingerprint.
    axes
        One per signal; None: new ones.
    stretch_s
        Start and end of the stretch to draw [s] on the log's clock, with a band about the model that should contain 95 %
        of the measured samples: 1.96 standard deviations of the residuals of the whole record. None: the whole record,
        without the band.
    signals
        Names of the signals to draw; None: all signals of the model.

    Returns
    -------
    sequence of Axes
    """
    if isinstance(measured, Experiment):
        experiment = measured
    else:
        experiment, model = measured.first(), model or measured.predict()
    if model is None:
        raise InputError(
            "model: found none beside an experiment, expected what a fingerprint's predict gives"
        )
    fitted = {name: row for name, row in model.outputs.items() if signals is None or name in signals}
    panels = panels_of(axes, len(fitted), sharex=True)
    rows = (
        slice(None)
        if stretch_s is None
        else slice(*(round((end - experiment.start_s) * experiment.rate_hz) for end in stretch_s))
    )
    time, ink = experiment.start_s + experiment.time[rows], panels[0].yaxis.label.get_color()
    for ax, (name, answer) in zip(panels, fitted.items(), strict=True):
        recorded, color = experiment.signals[name], COLOURS[name]
        if stretch_s is not None:
            half = DEVIATIONS_95 * float(np.nanstd(recorded - answer))
            times, low = envelope(time, answer[rows] - half)
            _, high = envelope(time, answer[rows] + half)
            ax.fill_between(times, low, high, color=color, alpha=0.2, lw=0.0, label="95 % of samples")
        if name in SPEEDS and "n_set" in experiment.signals:
            point = experiment.operating_point
            scale = 1.0 if UNITS[name] == UNITS["n_set"] else point[name] / point["n_set"]
            asked = scale * experiment.signals["n_set"][rows]
            ax.plot(*envelope(time, asked), color=SET_POINT, lw=1.0, ls="--", label="set point")
        ax.plot(*envelope(time, recorded[rows]), color=color, lw=3.2, alpha=0.55, label="measured")
        ax.plot(*envelope(time, answer[rows]), color=ink, lw=1.0, label="model")
        dress(ax, f"{LABELS[name]} [{UNITS[name]}]")
    if stretch_s is None:  # the caption of a stretch's figure names the experiment
        panels[0].set_title(experiment.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


def held_out(prediction: HeldOut, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """Draw a prediction's errors in a window that was not fitted, and their 95 % band, one panel per signal.

    Parameters
    ----------
    prediction
        Result of `shipfp_rs.assessment.validation.held_out`.
    axes
        One per signal; None: new ones.

    Returns
    -------
    sequence of Axes
    """
    experiment, panels = prediction.measured, panels_of(axes, len(prediction.band), sharex=True)
    for ax, (name, half) in zip(panels, prediction.band.items(), strict=True):
        times, low = envelope(experiment.start_s + experiment.time, -half)
        ax.fill_between(times, low, -low, color=COLOURS[name], alpha=0.25, lw=0.0, label="95 % band")
        missed = experiment.signals[name] - prediction.model.signals[name]
        ax.plot(
            *envelope(experiment.start_s + experiment.time, missed),
            color=COLOURS[name],
            lw=0.8,
            label="missed",
        )
        dress(ax, f"{LABELS[name]} [{UNITS[name]}]")
    panels[0].set_title(experiment.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


def _mark(ax: Axes, experiment: Experiment, masked: Mask) -> None:
    """Draw a strip along the bottom where samples are masked; its outline keeps single samples visible."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], masked, [False]]).astype(np.int8)))
    spans = [
        (experiment.start_s + first / experiment.rate_hz, (last - first) / experiment.rate_hz)
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
