"""Run sheet for the crew, with times and sizes of motions; plain text and HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.signals import Excitation, Segment
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.html import environment

HEAD = ("start", "what", "set point ± rpm", "frequency Hz", "speed ± rpm", "torque ± Nm")
TORQUES = ("M_g", "M_s", "M_b")
LEAST_REST_S = 1.0
"""Shortest listed stretch between two parts."""


@dataclass(frozen=True)
class Stretch:
    """One line of the run sheet; swings are half of peak to peak, None if the quantity is not an output."""

    start_s: float
    stop_s: float
    what: str
    amplitude_rpm: float
    frequency_hz: float | None
    speed_rpm: float | None
    torque_Nm: float | None

    def cells(self) -> tuple[str, ...]:
        """The line as text, one entry per column of `HEAD`."""
        minutes, seconds = divmod(self.start_s, 60.0)
        return (
            f"{int(minutes):02d}:{seconds:04.1f}",
            self.what,
            f"{self.amplitude_rpm:.1f}",
            "" if self.frequency_hz is None else f"{self.frequency_hz:.4g}",
            "" if self.speed_rpm is None else f"{self.speed_rpm:.1f}",
            "" if self.torque_Nm is None else f"{self.torque_Nm:.0f}",
        )


def run_sheet(excitation: Excitation, expected: Experiment) -> tuple[Stretch, ...]:
    """Parts of an excitation and rests between them, with the swings of the expected ship."""
    segments, at = [], 0.0
    for segment in (*excitation.segments, Segment("", excitation.duration, excitation.duration)):
        if segment.start_s - at > LEAST_REST_S:
            segments.append(Segment("hold the operating point", at, segment.start_s))
        segments.append(segment)
        at = segment.stop_s
    return tuple(_stretch(segment, excitation, expected) for segment in segments[:-1])


def as_text(title: str, notes: Sequence[str], stretches: Sequence[Stretch]) -> str:
    """Format the sheet as plain text."""
    rows = [HEAD, *(stretch.cells() for stretch in stretches)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
    lines = [
        "  ".join(
            cell.ljust(width) if column == 1 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    rule = "-" * max(map(len, lines))
    return "\n".join([title, "", *notes, "", lines[0], rule, *lines[1:], ""])


def as_html(title: str, notes: Sequence[str], stretches: Sequence[Stretch]) -> str:
    """Format the sheet as a printable page."""
    rows = [stretch.cells() for stretch in stretches]
    return environment().get_template("run_sheet.html").render(title=title, notes=notes, head=HEAD, rows=rows)


def _stretch(segment: Segment, excitation: Excitation, expected: Experiment) -> Stretch:
    rate = excitation.rate_hz
    part = slice(
        round(segment.start_s * rate), max(round(segment.stop_s * rate), round(segment.start_s * rate) + 1)
    )
    torque = next((name for name in TORQUES if name in expected.signals), None)
    # A shaft's speed is converted to rpm of the engine, as for the set point.
    speed = next((name for name in expected.signals if name in ("n_e", "n_s")), None)
    in_rpm = 1.0
    if speed is not None and UNITS[speed] != "rpm":
        in_rpm = expected.operating_point["n_set"] / expected.operating_point[speed]
    return Stretch(
        segment.start_s,
        segment.stop_s,
        segment.label,
        float(np.abs(excitation.samples[part]).max()),
        segment.frequency_hz,
        None if speed is None else in_rpm * _swing(expected.signals[speed][part]),
        None if torque is None else _swing(expected.signals[torque][part]),
    )


def _swing(samples: Array) -> float:
    return float(np.ptp(samples)) / 2.0
