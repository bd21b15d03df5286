"""Bode plots of measured and fitted frequency responses, and of several models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs.assessment.comparison import compared_responses
from shipfp_rs.errors import InputError
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.plot.style import COLOURS, COMPARED, GREY, LABELS, dress, panels_of
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, ComplexArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from shipfp_rs.identification.fingerprint import Fingerprint

MARKS = "osD^v"
"""Markers of successive windows in one plot."""


@checked
def bode(
    measured: FrequencyResponse | Fingerprint,
    model: FrequencyResponse | None = None,
    axes: Sequence[Axes] | None = None,
) -> Sequence[Axes]:
    """Draw amplitude and phase of measured responses to the set point, with the fitted model's curve.

    Parameters
    ----------
    measured
        Measured response, drawn as points, with bars of two standard deviations if these are known. For a fingerprint,
        the points of the first fitted experiment and the model's curve.
    model
        The model's response at ascending frequencies; measured phases are shifted by whole turns to match its phase.
    axes
        Two axes, for amplitude and phase; None: new ones.

    Returns
    -------
    sequence of Axes
    """
    if not isinstance(measured, FrequencyResponse):
        pairs = compared_responses(measured, [measured.first()])
        if not pairs:
            raise InputError(
                "measured: the fingerprint's experiment excites no frequency well enough for a point"
            )
        measured, model = pairs[0][0], model or pairs[0][1]
    amplitude, phase = panels = panels_of(axes, 2, sharex=True)
    _points_and_curves(measured, model, panels, "o")
    _dress_bode(amplitude, phase)
    amplitude.set_title(measured.name, loc="left", parse_math=False)
    return panels


def windows(
    pairs: Sequence[tuple[FrequencyResponse, FrequencyResponse]], axes: Sequence[Axes]
) -> Sequence[Axes]:
    """Draw the measured responses of several windows in one plot, each with its own marker, and the model's curves."""
    for place, (measured, model) in enumerate(pairs):
        _points_and_curves(measured, model, axes, MARKS[place % len(MARKS)], several=len(pairs) > 1)
    _dress_bode(*axes)
    return axes


def _points_and_curves(
    measured: FrequencyResponse,
    model: FrequencyResponse | None,
    axes: Sequence[Axes],
    mark: str,
    *,
    several: bool = False,
) -> None:
    """Draw points with bars, and the model's curve of each signal, labelled only for the first window."""
    amplitude, phase = axes
    for row, (name, response) in enumerate(measured.response.items()):
        symbol = LABELS[name].split()[-1]
        line = "--" if row else "-"  # so that signals differ not only by colour
        color, size, angle = COLOURS[name], np.abs(response), _phase(response)
        if model is not None:
            curve, label = (
                model.response[name],
                f"model of {symbol}" if mark == MARKS[0] else None,
            )
            expected = np.interp(measured.frequency_hz, model.frequency_hz, _phase(curve))
            angle += 360.0 * np.round((expected - angle) / 360.0)
            amplitude.plot(model.frequency_hz, np.abs(curve), color=color, lw=1.2, ls=line, label=label)
            phase.plot(model.frequency_hz, _phase(curve), color=color, lw=1.2, ls=line)
        bars = angle_bars = None
        if name in measured.amplitude_std:
            reach = 2.0 * measured.amplitude_std[name]
            # The lower bar ends at or above a tenth of the value, since a logarithmic axis has no zero.
            bars = size * np.array([np.minimum(reach, 0.9), reach])
            # The bar of an unknown phase is half a turn in either direction.
            angle_bars = np.minimum(np.degrees(2.0 * measured.phase_std[name]), 180.0)
        style: dict[str, Any] = {"color": color, "fmt": mark, "ms": 4, "lw": 1.0, "capsize": 2}
        style["mfc"] = "none" if row else color
        label = f"{measured.name}: {symbol}" if several else LABELS[name]
        amplitude.errorbar(measured.frequency_hz, size, bars, label=label, **style)
        phase.errorbar(measured.frequency_hz, angle, angle_bars, label=label, **style)


@checked
def responses(
    curves: Mapping[str, FrequencyResponse], signal: str, axes: Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Draw amplitude and phase of one signal's response by several models, to compare them.

    Parameters
    ----------
    curves
        At most six responses by label, drawn as lines; the first is broad and grey behind the others.
    signal
        Name of the signal.
    axes
        See `bode`.
    """
    amplitude, phase = panels = panels_of(axes, 2, sharex=True)
    for index, (label, curve) in enumerate(curves.items()):
        color, width = (GREY, 3.0) if index == 0 else (COMPARED[index - 1], 1.2)
        frequency, response = curve.frequency_hz, curve.response[signal]
        amplitude.plot(frequency, np.abs(response), color=color, lw=width, label=label)
        phase.plot(frequency, _phase(response), color=color, lw=width)
    _dress_bode(amplitude, phase)
    return panels


def _phase(response: ComplexArray) -> Array:
    return np.degrees(np.unwrap(np.angle(response)))


def _dress_bode(amplitude: Axes, phase: Axes) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for ax in (amplitude, phase):
        ax.set_xscale("log")
    amplitude.set_yscale("log")
    for axis in (amplitude.yaxis, amplitude.xaxis, phase.xaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    dress(amplitude, "amplitude ratio [-]")
    dress(phase, "phase [deg]", legend=False)
    phase.set_xlabel("frequency [Hz]")
