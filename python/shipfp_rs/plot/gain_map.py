"""Map of the share of ships consistent with the data that meet the limits, over a governor's gains."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shipfp_rs.assessment.tuning import Tuning
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, dress, panels_of
from shipfp_rs.support.arguments import checked

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@checked
def gains(advice: Tuning, ax: Axes | None = None) -> Axes:
    """Plot the share of ships that meet the limits over the factors by which today's gains are multiplied.

    Parameters
    ----------
    advice
        Result of `tune`.
    ax
        Axes; None: new ones.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.
    """
    (ax,) = panels_of(None if ax is None else [ax], 1)
    shown = ax.contourf(
        advice.factors, advice.factors, 100.0 * advice.map, levels=[0, 20, 40, 60, 80, 95, 100], cmap="Blues"
    )
    ax.figure.colorbar(shown, ax=ax, label="ships that meet the limits [%]")
    ax.contour(advice.factors, advice.factors, advice.map, levels=[0.95], colors=[BLUE])
    ax.plot(1.0, 1.0, "o", color=GREY, label="today")
    ax.plot(advice.proportional, advice.integral, "D", color=ORANGE, label="advised")
    ax.set_xlabel("proportional gain over today's [-]")
    dress(ax, "integral gain over today's [-]", legend=False)
    ax.set(xscale="log", yscale="log")
    ticks = [0.2, 0.5, 1.0, 2.0, 5.0]
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.set_ticks([], minor=True)
    ax.legend()
    return ax
