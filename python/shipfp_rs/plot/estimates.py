"""Plots of estimates: intervals, profiles, correlations of residuals, and responses of several fingerprints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from shipfp_rs.assessment.si import response_with_deviation, step_with_deviation
from shipfp_rs.errors import InputError
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.estimate import OPEN, ROUGH, SMALL, Estimate, roughness
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.plot.style import BLUE, COMPARED, GREY, ORANGE, PURPLE, RED, dress, panels_of
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import DEVIATIONS_95
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from shipfp_rs.assessment.profile_likelihood import Likelihood


OUTPUTS = {"dn": "speed", "dM": "torque", "dE": "integrated error", "dX": "fuel rack", "dM_b": "brake torque"}
FREQUENCY_HZ = np.geomspace(0.003, 5.0, 200)


def draw(fingerprints: Mapping[str, Fingerprint], draws: Mapping[str, Draws] | None = None) -> Figure:
    """Draw a column of panels per output: step response, amplitude and phase of the frequency response.

    Parameters
    ----------
    fingerprints
        One to five fingerprints of one linear structure, by label.
    draws
        Parameter draws of some fingerprints; their scatter is the band. The other bands follow from the covariance.

    Raises
    ------
    InputError
        If there is no fingerprint or more than five, or a structure is not linear.
    """
    from matplotlib.figure import Figure

    if not 1 <= len(fingerprints) <= len(COMPARED):
        raise InputError(f"{len(fingerprints)} fingerprints, expected 1 to {len(COMPARED)}")
    outputs = next(iter(fingerprints.values())).structure["outputs"]
    figure = Figure(figsize=(1.0 + 4.5 * len(outputs), 8.0), dpi=110, layout="constrained")
    panels = figure.subplots(3, len(outputs), squeeze=False, sharex="row")
    for color, (label, fingerprint) in zip(COMPARED, fingerprints.items(), strict=False):
        drawn = (draws or {}).get(label)
        step = step_with_deviation(fingerprint, draws=drawn)
        response = response_with_deviation(fingerprint, FREQUENCY_HZ, draws=drawn)
        for column, output in enumerate(outputs):
            value, deviation = step.mean[output], step.std[output]
            _band(panels[0, column], step.time, value, deviation, color, label)
            curve = response.response[output]
            size = np.abs(curve)
            _band(panels[1, column], FREQUENCY_HZ, size, size * response.amplitude_std[output], color, label)
            phase = np.degrees(np.unwrap(np.angle(curve)))
            _band(
                panels[2, column], FREQUENCY_HZ, phase, np.degrees(response.phase_std[output]), color, label
            )
    for column, output in enumerate(outputs):
        _dress(list(panels[:, column]), OUTPUTS[output], first=column == 0)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    return figure


def _band(ax: Axes, x: np.ndarray, value: np.ndarray, deviation: np.ndarray, color: str, label: str) -> None:
    ax.fill_between(
        x, value - DEVIATIONS_95 * deviation, value + DEVIATIONS_95 * deviation, color=color, alpha=0.25, lw=0
    )
    ax.plot(x, value, color=color, lw=1.3, label=f"{label} (band: 95 %)")


def _dress(panels: Sequence[Axes], output: str, *, first: bool) -> None:
    step, amplitude, phase = panels
    step.set_title(output, loc="left")
    step.set_xlabel("time after a step of the set point [s]")
    amplitude.set_xscale("log")
    amplitude.set_yscale("log")
    amplitude.set_xlabel("frequency [Hz]")
    phase.set_xscale("log")
    phase.set_xlabel("frequency [Hz]")
    for ax, label in (
        (step, "deviation / step [-]"),
        (amplitude, "amplitude ratio [-]"),
        (phase, "phase [°]"),
    ):
        dress(ax, label if first else "", legend=False)


FAR = 1000.0
"""Distance of an interval's end from the reference [%] beyond which the end is not written as a number."""
EVEN_PCT, LEAST_PCT, MOST_PCT = 1.0, 40.0, 300.0
"""End of the axis's linear part, and least and greatest end of the whole axis [%]; between them it is logarithmic."""
TICKS_PCT = (1.0, 5.0, 25.0, 200.0)
STATES: Mapping[str, tuple[str, str]] = {
    "known well": (BLUE, "o"),
    "known roughly": (ORANGE, "s"),
    "hardly known": (PURPLE, "D"),
    "misses the truth": (RED, "X"),
}
"""Colour and mark of each accuracy class of a parameter, as in the tables of a report."""


@checked
def intervals(
    fingerprint: Fingerprint,
    truth: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the 95 % intervals of parameters and combinations relative to the truth, or else to the estimate.

    Distances are in per cent of the reference, or of 0.05 s (0.5 for a parameter without unit) if that is larger: a
    delay near zero with an error of a millisecond counts as known well. The axis is linear up to 1 % and logarithmic
    above. Colour and mark show whether half the interval is within 25 %, within 200 %, or larger, and whether the
    interval misses the truth. Undetermined parameters have no interval and are omitted. An end of an interval beyond
    300 % is drawn as an arrow at the edge of the axes, with the value of the end above it.

    Parameters
    ----------
    fingerprint
        The estimates.
    truth
        True values by name, for simulated logs; parameters without a true value are omitted.
    ax
        Axes; None: new ones.

    Returns
    -------
    Axes
    """
    (ax,) = panels_of(None if ax is None else [ax], 1)
    shown = {
        name: estimate
        for name, estimate in {**fingerprint.parameters, **fingerprint.derived}.items()
        if estimate.ci95 is not None and estimate.value and (truth is None or truth.get(name))
    }
    rows = [
        _row(one, truth[name] if truth is not None else one.value) for name, one in reversed(shown.items())
    ]
    reach = max((abs(end) for *ends, _ in rows for end in ends), default=0.0)
    edge = min(max(1.15 * reach, LEAST_PCT), MOST_PCT)
    ax.axvspan(-100.0 * ROUGH, 100.0 * ROUGH, color=GREY, alpha=0.15, lw=0.0)
    ax.axvline(0.0, color=GREY, lw=1.0)
    for place, (middle, low, high, state) in enumerate(rows):
        color, mark = STATES[state]
        ax.plot(np.clip([low, high], -edge, edge), [place, place], color=color, lw=2.0, solid_capstyle="butt")
        for end in (low, high):
            if abs(end) > edge:
                side = float(np.sign(end))
                ax.plot(side * edge, place, "<" if side < 0.0 else ">", color=color, ms=7, clip_on=False)
                if np.isfinite(end):
                    _write_end(ax, end, side * edge, place, color)
        if abs(middle) <= edge:
            ax.plot(middle, place, mark, color=color, ms=6)
    for state in dict.fromkeys(state for *_, state in rows):
        ax.plot([], [], color=STATES[state][0], marker=STATES[state][1], ms=6, lw=2.0, label=state)
    labels = [
        f"{name} = {shown[name].value:.4g} {unit_shown(shown[name].unit)}".rstrip()
        for name in reversed(shown)
    ]
    ax.set_yticks(range(len(shown)), labels)
    ax.set_ylim(-0.6, max(len(shown), 1) - 0.4)
    ax.set_xscale("symlog", linthresh=EVEN_PCT, linscale=0.5)
    ax.set_xlim(-edge, edge)
    ticks = [0.0, *(sign * tick for tick in TICKS_PCT if tick < edge for sign in (-1.0, 1.0))]
    ax.set_xticks(sorted(ticks), [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in sorted(ticks)])
    ax.set_xticks([], minor=True)
    ax.set_xlabel(f"distance from the {'truth' if truth is not None else 'estimate'} [%]")
    dress(ax, "", legend=bool(rows))
    ax.grid(visible=False, axis="y")
    return ax


def _row(estimate: Estimate, reference: float | None) -> tuple[float, float, float, str]:
    """Estimate and both ends of its interval, as distances from a reference [%], and the accuracy class."""
    assert reference is not None
    assert estimate.value is not None
    assert estimate.ci95 is not None
    size = max(abs(reference), SMALL.get(estimate.unit, 0.0))
    middle, low, high = (100.0 * (one - reference) / size for one in (estimate.value, *estimate.ci95))
    rough = roughness(estimate)
    state = "known well" if rough <= ROUGH else "known roughly" if rough <= OPEN else "hardly known"
    return middle, low, high, state if low <= 0.0 <= high else "misses the truth"


@checked
def likelihood(found: Likelihood, ax: Axes | None = None) -> Axes:
    """Draw a profile likelihood with the level at which the 95 % interval ends.

    Parameters
    ----------
    found
        Result of `profile_likelihood`.
    ax
        Axes; None: new ones.

    Returns
    -------
    Axes
    """
    # Imported here, since the module loads SciPy, which other plots do not need.
    from shipfp_rs.assessment.profile_likelihood import LEVEL

    (ax,) = panels_of(None if ax is None else [ax], 1)
    color = {"bounded": BLUE, "one-sided": ORANGE, "flat": RED}[found.kind]
    finite = np.isfinite(found.deviance)
    ax.plot(found.values[finite], found.deviance[finite], ".-", color=color, lw=1.2, ms=4, label=found.kind)
    ax.axhline(LEVEL, color=GREY, lw=1.0, ls="--", label="95 %")
    ax.axvline(found.value, color=GREY, lw=0.8)
    # The limit keeps the curve legible within the interval, even if it rises steeply outside.
    ax.set_ylim(-0.1, 3.0 * LEVEL)
    ax.set_xlabel(f"{found.name} [{found.unit}]")
    dress(ax, "deviance [-]")
    return ax


@checked
def correlogram(fingerprint: Fingerprint, output: str, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """Draw an output's whitened residuals' autocorrelation and their correlation with the set point over the lag.

    The residuals of a correct model are white and independent of the set point. The band contains 95 % of the
    correlations of such noise (Ljung 1999, section 16.6).

    Parameters
    ----------
    fingerprint
        The result, with `residuals`.
    output
        Output, such as "dn".
    axes
        Axes of the autocorrelation (if the noise is assumed white) and of the correlation with the set point; None: new
        ones.

    Returns
    -------
    sequence of Axes

    Raises
    ------
    InputError
        If the fingerprint has no residuals of the output.
    """
    if output not in fingerprint.residuals:
        known = ", ".join(fingerprint.residuals) or "none; fit a given structure to an experiment"
        raise InputError(f"residuals of {output!r} are not in the fingerprint, found {known}")
    tests = fingerprint.residuals[output]
    panels = panels_of(axes, len(tests))
    rates = {record["rate_hz"] for record in fingerprint.data if "rate_hz" in record}
    step, unit = (1.0 / rates.pop(), "s") if len(rates) == 1 else (1.0, "samples")
    labels = {"autocorrelation": "autocorrelation [-]", "set_point": "with the set point [-]"}
    for ax, kind in zip(panels, tests, strict=True):
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
        dress(ax, labels[kind], legend=ax is panels[0])
        ax.set_xlabel(f"lag [{unit}]")
    # Lags to the set point are geometrically spaced, and their axis is logarithmic,
    # since an unmodelled response may be fast or slow.
    panels[-1].set_xscale("symlog", linthresh=step, linscale=0.5)
    panels[-1].set_xlim(-0.5 * step, 1.2 * max(lags[-1], step))
    panels[-1].xaxis.set_major_formatter("{x:g}")
    panels[-1].set_xlabel(f"lag of the residual behind the set point [{unit}]")
    return panels


def _write_end(ax: Axes, end: float, edge: float, place: int, color: str) -> None:
    """Write an interval's end [%] above its arrow; beyond `FAR`, write `FAR` with ">" or "<"."""
    shown = f"{end:+.3g} %" if abs(end) < FAR else f"{'>' if end > 0.0 else '<'} {np.sign(end) * FAR:+.0f} %"
    side: Literal["left", "right"] = "right" if edge > 0.0 else "left"
    inwards = -8.0 if edge > 0.0 else 8.0
    ax.annotate(
        shown.replace("-", "\N{MINUS SIGN}"),
        (edge, place),
        (inwards, 3.0),
        textcoords="offset points",
        ha=side,
        fontsize="x-small",
        color=color,
    )
