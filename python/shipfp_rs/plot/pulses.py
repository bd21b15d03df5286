"""Plots of pulse trains: reflectors, missed and extra pulses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.plot.style import RED, REFLECTORS, dress, panels_of
from shipfp_rs.support.arguments import checked

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from shipfp_rs.tacho import PulseTimes, ReflectorAngles


@checked
def pulse_intervals(
    pulses: PulseTimes, pulses_per_rev: int, angles: ReflectorAngles | None = None, ax: Axes | None = None
) -> Axes:
    """Draw each interval between pulses relative to an equal division of its turn.

    At steady speed the intervals lie on one line per reflector. A missed or extra pulse is a cross at the edge, after
    which the colours are exchanged.

    Parameters
    ----------
    pulses
        Crossing times.
    pulses_per_rev
        Number of reflectors.
    angles
        Estimated spacings, drawn as lines.
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

    # Median over nearby turns, so that a wrong pulse does not change the turn it is compared with.
    period = np.diff(times)
    share = median_filter(uniform_filter1d(period, pulses_per_rev), 4 * pulses_per_rev + 1)
    deviation = 100.0 * (period / share - 1.0)
    place = np.arange(len(period)) % pulses_per_rev
    # A few wrong pulses are marked at the edge, so that they do not compress the scale of the others.
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
