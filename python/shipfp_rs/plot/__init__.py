"""Pictures of experiments, responses, fits and parameters; each function takes axes or makes them.

Nothing here shows or saves a figure. Colours are of middle lightness: they read on white and on black.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.support.arrays import Array, ComplexArray, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from shipfp_rs.assessment.profile_likelihood import Likelihood
    from shipfp_rs.frequency import FrequencyResponse
    from shipfp_rs.tacho import PulseTimes, ReflectorAngles


BLUE, ORANGE, GREEN, PURPLE, GREY, RED = "#3f7fbf", "#d9822b", "#4b9b6b", "#9b6fb5", "#8a8f98", "#cf4d4d"
LABELS: Mapping[str, str] = {
    "n_set": "set point $n_{set}$",
    "n_e": "engine speed $n_e$",
    "n_s": "shaft speed $n_s$",
    "M_s": "shaft torque $M_s$",
    "M_b": "brake torque $M_b$",
    "M_g": "gauge torque $M_g$",
    "X_f": "fuel rack $X_f$",
    "E_n": "speed error $E_n$",
}
"""What the signals are called in legends."""
QUANTITIES: Mapping[str, str] = {
    "rpm": "speed [rpm]",
    "rev/s": "shaft speed [rev/s]",
    "Nm": "torque [Nm]",
    "mm": "fuel rack [mm]",
    "rev": "integrated error [rev]",
}
"""Axis label of each unit; signals of one unit share a panel."""
COLOURS: Mapping[str, str] = {
    "n_set": GREY,
    "n_e": BLUE,
    "n_s": BLUE,
    "M_s": ORANGE,
    "M_b": PURPLE,
    "M_g": ORANGE,
    "X_f": GREEN,
    "E_n": GREEN,
}
REFLECTORS = (BLUE, ORANGE, GREEN, PURPLE, GREY, RED)
COMPARED = (BLUE, ORANGE, GREEN, PURPLE, RED)
ENVELOPE_BINS = 1000
"""Longer signals are drawn as the smallest and largest sample of this many stretches."""


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
    panels = _panels(axes, len(shown), sharex=True)
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


def fit(
    experiment: Experiment, simulated: Mapping[str, npt.ArrayLike], axes: Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Draw measured signals and what the fitted model makes of them, one panel a signal.

    Parameters
    ----------
    experiment
        The measured signals.
    simulated
        Signal name to the model's normalised deviation (as `Experiment.normalised`), shape (N,).
    axes
        One a signal; made where None.

    Returns
    -------
    sequence of Axes
    """
    panels = _panels(axes, len(simulated), sharex=True)
    for ax, (name, deviation) in zip(panels, simulated.items(), strict=True):
        model = experiment.operating_point[name] * (1.0 + np.asarray(deviation, dtype=np.float64))
        ax.plot(*envelope(experiment.time, experiment.signals[name]), color=GREY, lw=1.0, label="measured")
        ax.plot(*envelope(experiment.time, model), color=COLOURS[name], lw=1.0, label="model")
        dress(ax, f"{LABELS[name]} [{UNITS[name]}]")
    panels[0].set_title(experiment.name, loc="left", parse_math=False)
    panels[-1].set_xlabel("time [s]")
    return panels


def bode(
    measured: FrequencyResponse,
    model: FrequencyResponse | None = None,
    axes: Sequence[Axes] | None = None,
) -> Sequence[Axes]:
    """Draw amplitude and phase of measured responses to the set point, with the fitted model's curve.

    Parameters
    ----------
    measured
        Points; where it knows their standard deviations they get bars of two of these.
    model
        The model's response at frequencies of its own, ascending; measured phases are drawn on its turn.
    axes
        Two, amplitude and phase; made where None.

    Returns
    -------
    sequence of Axes
    """
    amplitude, phase = panels = _panels(axes, 2, sharex=True)
    for index, (name, response) in enumerate(measured.response.items()):
        color, size, angle = COLOURS[name], np.abs(response), _phase(response)
        if model is not None:
            curve, label = model.response[name], None if index else "model"
            expected = np.interp(measured.frequency_hz, model.frequency_hz, _phase(curve))
            angle += 360.0 * np.round((expected - angle) / 360.0)
            amplitude.plot(model.frequency_hz, np.abs(curve), color=color, lw=1.2, label=label)
            phase.plot(model.frequency_hz, _phase(curve), color=color, lw=1.2)
        bars = angle_bars = None
        if name in measured.amplitude_std:
            reach = 2.0 * measured.amplitude_std[name]
            # Down to a tenth at most: on its way to zero a bar would stretch a logarithmic axis without end.
            bars = size * np.array([np.minimum(reach, 0.9), reach])
            # A phase that is lost could be anything: no more than half a turn either way.
            angle_bars = np.minimum(np.degrees(2.0 * measured.phase_std[name]), 180.0)
        style: dict[str, Any] = {"color": color, "fmt": "o", "ms": 4, "lw": 1.0, "capsize": 2}
        amplitude.errorbar(measured.frequency_hz, size, bars, label=LABELS[name], **style)
        phase.errorbar(measured.frequency_hz, angle, angle_bars, label=LABELS[name], **style)
    _dress_bode(amplitude, phase)
    amplitude.set_title(measured.name, loc="left", parse_math=False)
    return panels


def responses(
    curves: Mapping[str, FrequencyResponse], signal: str, axes: Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Draw amplitude and phase of one signal's response by several models, to compare them.

    Parameters
    ----------
    curves
        Label to response; at most six, drawn as lines, the first one broad and grey behind the others.
    signal
        Name of the signal.
    axes
        Two, amplitude and phase; made where None.

    Returns
    -------
    sequence of Axes
    """
    amplitude, phase = panels = _panels(axes, 2, sharex=True)
    for index, (label, curve) in enumerate(curves.items()):
        color, width = (GREY, 3.0) if index == 0 else (COMPARED[index - 1], 1.2)
        frequency, response = curve.frequency_hz, curve.response[signal]
        amplitude.plot(frequency, np.abs(response), color=color, lw=width, label=label)
        phase.plot(frequency, _phase(response), color=color, lw=width)
    _dress_bode(amplitude, phase)
    return panels


def intervals(
    fingerprint: Fingerprint, truth: Mapping[str, float] | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the 95 % intervals of parameters and combinations relative to the truth, or else to the estimate.

    What the data leave open has no interval and is left out; an interval that misses the truth is red.

    Parameters
    ----------
    fingerprint
        The estimates.
    truth
        Name to true value, for simulated logs; names it lacks are left out.
    ax
        Axes; made where None.

    Returns
    -------
    Axes
    """
    (ax,) = _panels(None if ax is None else [ax], 1)
    shown = {
        name: estimate
        for name, estimate in {**fingerprint.parameters, **fingerprint.derived}.items()
        if estimate.ci95 is not None and estimate.value and (truth is None or truth.get(name))
    }
    reach = 0.0
    for row, (name, estimate) in enumerate(reversed(shown.items())):
        reference = truth[name] if truth is not None else estimate.value
        assert reference is not None
        assert estimate.ci95 is not None
        middle, low, high = (
            100.0 * (value - reference) / abs(reference) for value in (estimate.value or 0.0, *estimate.ci95)
        )
        color = BLUE if low <= 0.0 <= high else RED
        ax.plot([low, high], [row, row], color=color, lw=2.0, solid_capstyle="butt")
        ax.plot(middle, row, "o", color=color, ms=5)
        reach = max(reach, abs(low), abs(high))
    ax.axvline(0.0, color=GREY, lw=1.0)
    ax.set_yticks(range(len(shown)), [_row_label(name, shown[name]) for name in reversed(shown)])
    ax.set_ylim(-0.6, max(len(shown), 1) - 0.4)
    # A hopeless interval must not squeeze the good ones into dots; it runs out of the picture.
    edge = min(max(1.1 * reach, 0.1), 100.0)
    ax.set_xlim(-edge, edge)
    ax.set_xlabel(
        "estimate and 95 % interval, from " + ("the truth" if truth is not None else "the estimate") + " [%]"
    )
    dress(ax, "", legend=False)
    ax.grid(visible=False, axis="y")
    return ax


def likelihood(found: Likelihood, ax: Axes | None = None) -> Axes:
    """Draw a profile likelihood with the level at which the 95 % interval ends.

    Parameters
    ----------
    found
        One of `profile_likelihood`.
    ax
        Axes; made where None.

    Returns
    -------
    Axes
    """
    # It loads SciPy, which no other picture needs.
    from shipfp_rs.assessment.profile_likelihood import LEVEL

    (ax,) = _panels(None if ax is None else [ax], 1)
    color = {"bounded": BLUE, "one-sided": ORANGE, "flat": RED}[found.kind]
    finite = np.isfinite(found.deviance)
    ax.plot(found.values[finite], found.deviance[finite], ".-", color=color, lw=1.2, ms=4, label=found.kind)
    ax.axhline(LEVEL, color=GREY, lw=1.0, ls="--", label="95 %")
    ax.axvline(found.value, color=GREY, lw=0.8)
    # A wall beside the interval must not flatten what is within.
    ax.set_ylim(-0.1, 3.0 * LEVEL)
    ax.set_xlabel(f"{found.name} [{found.unit}]")
    dress(ax, "deviance [-]")
    return ax


def correlogram(fingerprint: Fingerprint, output: str, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """Draw the correlations of an output's whitened residuals with their own past and with the set point, by lag.

    What a right model leaves over stays within the band, which holds 95 % of the correlations of white noise, and of
    noise that knows nothing of the set point (Ljung 1999, section 16.6).

    Parameters
    ----------
    fingerprint
        The result; its `residuals` hold what is drawn.
    output
        One of its outputs, such as "dn".
    axes
        Two, own past and set point; made where None.

    Returns
    -------
    sequence of Axes

    Raises
    ------
    InputError
        Where the fingerprint holds no residuals of the output.
    """
    if output not in fingerprint.residuals:
        known = ", ".join(fingerprint.residuals) or "none: what was fitted has no order in time"
        raise InputError(f"residuals of {output!r} are not in the fingerprint, found {known}")
    panels = _panels(axes, 2)
    rates = {record["rate_hz"] for record in fingerprint.data if "rate_hz" in record}
    step, unit = (1.0 / rates.pop(), "s") if len(rates) == 1 else (1.0, "samples")
    tests = fingerprint.residuals[output]
    labels = ("autocorrelation [-]", "with the set point [-]")
    for ax, kind, label in zip(panels, ("autocorrelation", "set_point"), labels, strict=True):
        lags, correlation, band = (
            np.asarray(tests[kind][name], dtype=np.float64) for name in ("lags", "correlation", "band")
        )
        lags = lags * step
        outside = np.abs(correlation) > band
        ax.fill_between(lags, -band, band, color=GREY, alpha=0.3, lw=0.0, step="mid", label="95 % by chance")
        ax.vlines(lags, 0.0, correlation, colors=BLUE, lw=1.0)
        ax.plot(lags[~outside], correlation[~outside], "o", color=BLUE, ms=4, label="within")
        ax.plot(lags[outside], correlation[outside], "D", color=RED, ms=5, label="outside")
        ax.axhline(0.0, color=GREY, lw=0.8)
        dress(ax, label, legend=ax is panels[0])
        ax.set_xlabel(f"lag [{unit}]")
    # Lags of the set point grow by a factor: its answer may be missing at any time scale.
    panels[1].set_xscale("symlog", linthresh=step, linscale=0.5)
    panels[1].set_xlim(-0.5 * step, 1.2 * max(lags[-1], step))
    panels[1].xaxis.set_major_formatter("{x:g}")
    panels[1].set_xlabel(f"residual after the set point [{unit}]")
    return panels


def pulse_intervals(
    pulses: PulseTimes, pulses_per_rev: int, angles: ReflectorAngles | None = None, ax: Axes | None = None
) -> Axes:
    """Draw each interval between pulses relative to an even share of its turn: reflectors, extra and missed pulses.

    The intervals of a train at steady speed lie on one line for each reflector. A missed or an extra pulse is a
    cross at the edge, and from there on the colours change places.

    Parameters
    ----------
    pulses
        Crossing times.
    pulses_per_rev
        Number of reflectors.
    angles
        Spacings found, drawn as lines.
    ax
        Axes; made where None.

    Returns
    -------
    Axes
    """
    (ax,) = _panels(None if ax is None else [ax], 1)
    times = pulses.times_s
    if len(times) <= pulses_per_rev:
        raise InputError(f"{len(times)} pulses, expected more than the {pulses_per_rev} of one turn")
    from scipy.ndimage import median_filter, uniform_filter1d

    # Median over turns nearby: one wrong pulse must not pull the turn it is measured with.
    period = np.diff(times)
    share = median_filter(uniform_filter1d(period, pulses_per_rev), 4 * pulses_per_rev + 1)
    deviation = 100.0 * (period / share - 1.0)
    place = np.arange(len(period)) % pulses_per_rev
    # A few wrong pulses must not squeeze the reflectors into one line; they are marked at the edge.
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


def envelope(time: Array, samples: npt.ArrayLike, bins: int = ENVELOPE_BINS) -> tuple[Array, Array]:
    """Thin a signal for drawing to the smallest and largest sample of each of `bins` stretches, in order.

    Parameters
    ----------
    time, samples
        Shape (N,); NaN samples are passed over, and a stretch of nothing else stays NaN.
    bins
        Number of stretches.

    Returns
    -------
    tuple of ndarray
        Time and samples, as given where N is at most 4 `bins`, else of shape (2 `bins`,).
    """
    values = np.asarray(samples, dtype=np.float64)
    if len(values) <= 4 * bins:
        return time, values
    edges = np.linspace(0, len(values), bins + 1).astype(np.intp)
    lowest = np.where(np.isnan(values), np.inf, values)
    highest = np.where(np.isnan(values), -np.inf, values)
    picked = np.empty((bins, 2), dtype=np.intp)
    for index, (first, last) in enumerate(pairwise(edges)):
        picked[index] = first + np.argmin(lowest[first:last]), first + np.argmax(highest[first:last])
    order = np.sort(picked, axis=1).ravel()
    return time[order], values[order]


def _row_label(name: str, estimate: Estimate) -> str:
    unit = "" if estimate.unit == "-" else f" {estimate.unit}"
    return f"{name} = {estimate.value:.4g}{unit}"


def _phase(response: ComplexArray) -> Array:
    return np.degrees(np.unwrap(np.angle(response)))


def _dress_bode(amplitude: Axes, phase: Axes) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for ax in (amplitude, phase):
        ax.set_xscale("log")
    amplitude.set_yscale("log")
    amplitude.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    amplitude.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    amplitude.yaxis.set_minor_formatter(NullFormatter())
    dress(amplitude, "amplitude ratio [-]")
    dress(phase, "phase [deg]", legend=False)
    phase.set_xlabel("frequency [Hz]")


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


def _panels(axes: Sequence[Axes] | None, count: int, *, sharex: bool = False) -> Sequence[Axes]:
    if axes is None:
        from matplotlib import pyplot

        _, made = pyplot.subplots(
            count, 1, sharex=sharex, squeeze=False, layout="constrained", figsize=(8.0, 1.0 + 2.2 * count)
        )
        return [*made[:, 0]]
    if len(axes) != count:
        raise InputError(f"{len(axes)} axes given, expected {count}")
    return axes


def dress(ax: Axes, ylabel: str, *, legend: bool = True) -> None:
    """Give axes a label, a faint grid and a legend above them."""
    ax.set_ylabel(ylabel)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(visible=True, color=GREY, alpha=0.25, lw=0.6)
    ax.set_axisbelow(True)
    if legend:
        # Above the panel: beside the title, and never over a signal.
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=5,
            frameon=False,
            fontsize="small",
            borderaxespad=0.2,
        )
