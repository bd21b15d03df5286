"""Figure of a plan: the set point over time, and its spectrum with the excluded bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.designs.waveforms import Limits
from shipfp_rs.plot.style import BLUE, ORANGE, RED, SET_POINT, dress, envelope
from shipfp_rs.signals import Excitation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(
    signal: Excitation,
    spectrum: Sequence[tuple[float, float]],
    limits: Limits,
    *,
    set_point_rpm: float,
    title: str,
) -> Figure:
    """Draw the set point [rpm] over time [s], and the amplitudes of its Fourier lines [rpm] with the optimal shares."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(9.0, 6.0), layout="constrained")
    time, amplitudes = made.subplots(2, 1)
    at, samples = envelope(signal.time, signal.samples, 4000)
    time.plot(at, set_point_rpm + samples, color=SET_POINT, lw=0.7, label="set point")
    for side in (-1.0, 1.0):
        time.axhline(
            set_point_rpm + side * limits.amplitude_rpm,
            color=RED,
            lw=0.8,
            ls="--",
            label="limit of amplitude" if side > 0.0 else None,
        )
    time.set_xlabel("time [s]")
    time.set_title(title, loc="left", fontsize="medium")
    dress(time, "set point [rpm]")

    frequency, amplitude = signal.spectrum()
    low = min(line for line, _ in spectrum)
    high = max(line for line, _ in spectrum)
    shown = (frequency >= 0.3 * low) & (frequency <= min(10.0 * high, 0.5 * signal.rate_hz))
    amplitudes.loglog(frequency[shown], amplitude[shown], color=BLUE, lw=0.7, label="Fourier lines")
    top = amplitude[shown].max()
    amplitudes.set_ylim(1e-4 * top, 2.0 * top)
    for index, (lower, upper) in enumerate(limits.avoid_hz):
        amplitudes.axvspan(
            max(lower, 0.3 * low),
            upper,
            color=RED,
            alpha=0.2,
            lw=0.0,
            label="to stay out of" if not index else None,
        )
    shares = amplitudes.twinx()
    lines, parts = np.array(spectrum).T
    shares.vlines(lines, 0.0, 100.0 * parts, color=ORANGE, lw=1.5)
    shares.plot(lines, 100.0 * parts, "o", color=ORANGE, ms=4, label="optimal share")
    shares.set_ylim(bottom=0.0)
    shares.set_ylabel("optimal share [%]", color=ORANGE)
    shares.spines[["top"]].set_visible(False)
    amplitudes.plot([], [], "o", color=ORANGE, ms=4, label="optimal share")
    amplitudes.set_xlabel("frequency [Hz]")
    dress(amplitudes, "amplitude [rpm]")
    return made
