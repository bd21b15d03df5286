"""Pictures of estimates: intervals, profile likelihoods, correlations of residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, RED, dress, panels_of
from shipfp_rs.support.arguments import checked

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from shipfp_rs.assessment.profile_likelihood import Likelihood

FAR = 1000.0
"""Distance from the estimate beyond which nobody asks for the figure [%]."""


@checked
def intervals(
    fingerprint: Fingerprint,
    truth: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the 95 % intervals of parameters and combinations relative to the truth, or else to the estimate.

    What the data leave open has no interval and is left out; an interval that misses the truth is red. Where
    most intervals are narrow, one that is not, such as that of a parameter near zero, ends in an arrow at the edge, and the
    figure beside the arrow says where.

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
    (ax,) = panels_of(None if ax is None else [ax], 1)
    shown = {
        name: estimate
        for name, estimate in {**fingerprint.parameters, **fingerprint.derived}.items()
        if estimate.ci95 is not None and estimate.value and (truth is None or truth.get(name))
    }
    rows = []
    for name, estimate in reversed(shown.items()):
        reference = truth[name] if truth is not None else estimate.value
        assert reference is not None
        assert estimate.ci95 is not None
        ends = (estimate.value or 0.0, *estimate.ci95)
        rows.append([100.0 * (value - reference) / abs(reference) for value in ends])
    edge = _edge([(low, high) for _, low, high in rows])
    for place, (middle, low, high) in enumerate(rows):
        color = BLUE if low <= 0.0 <= high else RED
        ax.plot(np.clip([low, high], -edge, edge), [place, place], color=color, lw=2.0, solid_capstyle="butt")
        for end, mark in ((low, "<"), (high, ">")):
            if (end > edge) if mark == ">" else (end < -edge):
                ax.plot(np.sign(end) * edge, place, mark, color=color, ms=7, clip_on=False)
                if np.isfinite(end):
                    _write_end(ax, end, float(np.sign(end)) * edge, place, color)
        if abs(middle) <= edge:
            ax.plot(middle, place, "o", color=color, ms=5)
    ax.axvline(0.0, color=GREY, lw=1.0)
    labels = [_row_label(name, shown[name]) for name in reversed(shown)]
    ax.set_yticks(range(len(shown)), labels)
    ax.set_ylim(-0.6, max(len(shown), 1) - 0.4)
    ax.set_xlim(-edge, edge)
    ax.set_xlabel(f"distance from the {'truth' if truth is not None else 'estimate'} [%]")
    dress(ax, "", legend=False)
    ax.grid(visible=False, axis="y")
    return ax


@checked
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

    (ax,) = panels_of(None if ax is None else [ax], 1)
    color = {"bounded": BLUE, "one-sided": ORANGE, "flat": RED}[found.kind]
    finite = np.isfinite(found.deviance)
    ax.plot(found.values[finite], found.deviance[finite], ".-", color=color, lw=1.2, ms=4, label=found.kind)
    ax.axhline(LEVEL, color=GREY, lw=1.0, ls="--", label="95 %")
    ax.axvline(found.value, color=GREY, lw=0.8)
    # A steep rise beside the interval must not flatten the curve within it.
    ax.set_ylim(-0.1, 3.0 * LEVEL)
    ax.set_xlabel(f"{found.name} [{found.unit}]")
    dress(ax, "deviance [-]")
    return ax


@checked
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
        One for each correlation: own past, of noise taken for white, and set point; made where None.

    Returns
    -------
    sequence of Axes

    Raises
    ------
    InputError
        Where the fingerprint holds no residuals of the output.
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
    # Lags of the set point grow geometrically, since the missing answer may be fast or slow.
    panels[-1].set_xscale("symlog", linthresh=step, linscale=0.5)
    panels[-1].set_xlim(-0.5 * step, 1.2 * max(lags[-1], step))
    panels[-1].xaxis.set_major_formatter("{x:g}")
    panels[-1].set_xlabel(f"lag of the residual behind the set point [{unit}]")
    return panels


def _write_end(ax: Axes, end: float, edge: float, place: int, color: str) -> None:
    """Write where an interval ends [%] above its arrow; of one about zero only that it is far."""
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


def _edge(ends: Sequence[tuple[float, float]]) -> float:
    """Return how far the axis goes [%]: past all intervals but those three times as wide as the usual one."""
    known = np.array([pair for pair in ends if np.isfinite(pair).all()]).reshape(-1, 2)
    if not len(known):
        return 1.0
    widths = known[:, 1] - known[:, 0]
    near = known[widths <= 3.0 * np.median(widths)]
    return min(max(1.15 * float(np.abs(near).max()), 0.1), 100.0)


def _row_label(name: str, estimate: Estimate) -> str:
    unit = "" if estimate.unit == "-" else f" {estimate.unit}"
    return f"{name} = {estimate.value:.4g}{unit}"
