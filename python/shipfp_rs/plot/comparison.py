"""Step and frequency responses of several fingerprints with 95 % bands, which show the effect of a change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.assessment.propagation import response_with_deviation, step_with_deviation
from shipfp_rs.errors import InputError
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.plot.style import COMPARED, dress
from shipfp_rs.support.quantiles import DEVIATIONS_95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OUTPUTS = {"dn": "speed", "dM": "torque", "dE": "integrated error", "dX": "fuel rack", "dM_b": "brake torque"}
FREQUENCY_HZ = np.geomspace(0.003, 5.0, 200)


def draw(fingerprints: Mapping[str, Fingerprint]) -> Figure:
    """Draw a column of panels per output: step response, amplitude and phase of the frequency response.

    Parameters
    ----------
    fingerprints
        Up to five fingerprints of one linear structure, by label.

    Raises
    ------
    InputError
        For none or more than five, or if a structure is not linear.
    """
    from matplotlib.figure import Figure

    if not 1 <= len(fingerprints) <= len(COMPARED):
        raise InputError(f"{len(fingerprints)} fingerprints, expected 1 to {len(COMPARED)}")
    outputs = next(iter(fingerprints.values())).structure["outputs"]
    figure = Figure(figsize=(1.0 + 4.5 * len(outputs), 8.0), dpi=110, layout="constrained")
    panels = figure.subplots(3, len(outputs), squeeze=False, sharex="row")
    for color, (label, fingerprint) in zip(COMPARED, fingerprints.items(), strict=False):
        step = step_with_deviation(fingerprint)
        response = response_with_deviation(fingerprint, FREQUENCY_HZ)
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
