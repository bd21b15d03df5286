"""Plan of a trial: set point, expected results, run sheet for the crew, and the signal generator's file."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.designs.pictures import figure
from shipfp_rs.designs.spectrum import Criterion
from shipfp_rs.designs.subject import Noise, Prediction
from shipfp_rs.designs.waveforms import Generator, Kind, Limits, steepest_rpm_s
from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.signals import Excitation, Segment
from shipfp_rs.support.arrays import Array, Brief, attributes
from shipfp_rs.support.files import finite, json_text, replacing_folder
from shipfp_rs.support.tables import environment, text_table

FILES = (
    "plan.json",
    "excitation.csv",
    "volts.csv",
    "volts_points.csv",
    "run_sheet.txt",
    "run_sheet.html",
    "plan.png",
)


@dataclass(frozen=True)
class Needed:
    """Duration that a trial needs for an accuracy, estimated from a plan and a plan twice as long."""

    accuracy_pct: float
    """Largest relative standard deviation of every parameter asked for [%]."""
    duration_s: float
    """Needed duration [s]; infinite if errors of the gauges alone exceed the accuracy."""
    limited_by: str
    """Parameter that needs this duration."""
    met: bool
    """Whether the plan reaches the accuracy."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Brief):
    """Result of `design`.

    Parameters
    ----------
    subject
        Ship or fingerprint of the trial.
    kind, criterion
        Arguments of `design`.
    excitation
        Deviations of the set point, as one time series.
    spectrum
        Frequency [Hz] and share of time or power of each line of the optimal design.
    efficiency
        Lower bound on the efficiency of the shares [-], from the equivalence theorem.
    designed_for
        Names of the parameters for which the lines are chosen: all that the response to small deviations determines.
    prediction
        Expected standard deviations, and undetermined parameters.
    needed
        Time needed for the accuracy asked for, if any.
    sheet
        The crew's run sheet.
    set_point_rpm
        Operating point [rpm of the engine].
    sensors
        Assumed noise, by output.
    limits, generator
        Arguments of `design`.
    notes
        Remarks for the user, in sentences.
    spread
        Median and 95 % quantile, over the drawn ships, of each quantity's relative standard deviation [%]; empty without
        draws.
    """

    subject: str
    kind: Kind
    criterion: Criterion
    excitation: Excitation
    spectrum: tuple[tuple[float, float], ...]
    efficiency: float
    designed_for: tuple[str, ...]
    prediction: Prediction
    needed: Needed | None
    sheet: tuple[Stretch, ...]
    set_point_rpm: float
    sensors: Mapping[str, Noise]
    limits: Limits
    generator: Generator | None
    notes: tuple[str, ...]
    spread: Mapping[str, tuple[float, float]]

    def volts(self) -> Array | None:
        """Return the generator's output [V], shape (N,); None without a generator."""
        return (
            None
            if self.generator is None
            else self.generator.volts(self.set_point_rpm + self.excitation.samples)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form, without the time series."""
        signal = self.excitation
        return {
            **attributes(self, "subject", "kind", "criterion", "set_point_rpm"),
            "excitation": {
                "duration_s": signal.duration,
                "rate_hz": signal.rate_hz,
                "samples": len(signal),
                "amplitude_rpm": signal.amplitude_rpm,
                "rms_rpm": signal.rms_rpm,
                "crest_factor": signal.crest_factor,
                "steepest_rpm_s": steepest_rpm_s(signal),
                "power_in_avoided_bands": sum(signal.power_in(*band) for band in self.limits.avoid_hz),
            },
            "spectrum": [{"frequency_hz": line, "share": share} for line, share in self.spectrum],
            "efficiency": self.efficiency,
            "designed_for": list(self.designed_for),
            "parameters": finite(self.prediction.parameters),
            "derived": finite(self.prediction.derived),
            "relative_std_pct": self.prediction.relative_pct,
            "relative_std_pct_of_draws": finite(dict(self.spread)),
            "identifiability": finite(self.prediction.identifiability),
            "needed": finite(self.needed),
            "run_sheet": [asdict(stretch) for stretch in self.sheet],
            "sensors": {output: asdict(noise) for output, noise in self.sensors.items()},
            "limits": asdict(self.limits),
            "generator": None
            if self.generator is None
            else {
                "rpm_per_V": self.generator.calibration.scale,
                "rpm_at_0_V": self.generator.calibration.offset,
                "lowest_V": self.generator.lowest_V,
                "highest_V": self.generator.highest_V,
            },
            "notes": list(self.notes),
        }

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Write plan.json, the time series in rpm and in volts, the run sheet and a figure, atomically.

        `volts.csv` contains time and volts, `volts_points.csv` only the volts, one per line, for generators that accept
        points and a sample rate.

        Raises
        ------
        InputError
            If the folder has other files and `force` is not given, or it can't be written.
        """
        folder, volts = Path(folder), self.volts()
        title = f"Run sheet: {self.subject}, {self.set_point_rpm:g} rpm"
        with replacing_folder(folder, marker="plan.json", others=FILES, force=force) as made:
            (made / "plan.json").write_text(json_text(self.to_dict()), encoding="utf-8")
            self.excitation.to_csv(made / "excitation.csv")
            if volts is not None:
                head = "time_s,volts\n"
                (made / "volts.csv").write_text(
                    head + _columns(self.excitation.time, volts), encoding="ascii"
                )
                (made / "volts_points.csv").write_text(_columns(volts), encoding="ascii")
            (made / "run_sheet.txt").write_text(as_text(title, self.heading(), self.sheet), encoding="utf-8")
            page = environment().get_template("run_sheet.html")
            rows = [stretch.cells() for stretch in self.sheet]
            text = page.render(title=title, notes=self.heading(), head=HEAD, rows=rows)
            (made / "run_sheet.html").write_text(text, encoding="utf-8")
            picture = figure(
                self.excitation,
                self.spectrum,
                self.limits,
                set_point_rpm=self.set_point_rpm,
                title=f"{self.subject}: {self.kind}, {self.criterion}-optimal",
            )
            picture.savefig(made / "plan.png", dpi=110)
        return folder

    def heading(self) -> tuple[str, ...]:
        """Text above the run sheet's table: length, limits, samples and volts, then the notes."""
        signal, volts = self.excitation, self.volts()
        minutes, seconds = divmod(round(signal.duration), 60)
        lines = [
            f"{minutes} min {seconds} s, at most {signal.amplitude_rpm:.4g} rpm from {self.set_point_rpm:g} rpm and "
            f"{steepest_rpm_s(signal):.4g} rpm/s; swings are half of peak to peak."
        ]
        if volts is not None:
            lines.append(
                f"Signal generator: {len(signal)} samples at {signal.rate_hz:g} Hz, {volts.min():.4f} to "
                f"{volts.max():.4f} V."
            )
        return (*lines, *self.notes)


def _columns(*columns: Array) -> str:
    text = io.StringIO()
    # A tenth of a millivolt is far below the resolution of a governor's input.
    np.savetxt(text, np.column_stack(columns), fmt="%.6f", delimiter=",")
    return text.getvalue()


def needed_for(
    accuracy_pct: float,
    now: Mapping[str, float],
    later: Mapping[str, float],
    names: tuple[str, ...],
    duration_s: float,
) -> Needed:
    """Time for an accuracy of all `names`, from their standard deviations [%] after `duration_s` and after twice that."""
    # A variance has a term inversely proportional to the duration and a constant term, from errors of gauges.
    limiting = max(names, key=lambda name: now[name])
    first, second = now[limiting] ** 2, later.get(limiting, now[limiting]) ** 2
    falling = 2.0 * max(first - second, 0.0) * duration_s
    room = accuracy_pct**2 - max(2.0 * second - first, 0.0)
    duration = falling / room if room > 0.0 else math.inf
    return Needed(accuracy_pct, duration, limiting, now[limiting] <= accuracy_pct)


HEAD = ("start", "what", "set point ± rpm", "frequency Hz", "speed ± rpm", "torque ± Nm")
TORQUES = ("M_g", "M_s", "M_b")
LEAST_REST_S = 1.0
"""Shortest hold between two parts of the waveform that the run sheet lists."""


@dataclass(frozen=True)
class Stretch:
    """Line of the run sheet. Amplitudes are half of peak to peak, None for a quantity that is not an output."""

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
    """Parts of an excitation and the holds between them, with the expected amplitudes of the ship's response."""
    segments, at = [], 0.0
    for segment in (*excitation.segments, Segment("", excitation.duration, excitation.duration)):
        if segment.start_s - at > LEAST_REST_S:
            segments.append(Segment("hold the operating point", at, segment.start_s))
        segments.append(segment)
        at = segment.stop_s
    return tuple(_stretch(segment, excitation, expected) for segment in segments[:-1])


def as_text(title: str, notes: Sequence[str], stretches: Sequence[Stretch]) -> str:
    """Format the sheet as plain text."""
    lines = text_table(HEAD, [stretch.cells() for stretch in stretches], left=2)
    rule = "-" * max(map(len, lines))
    return "\n".join([title, "", *notes, "", lines[0], rule, *lines[1:], ""])


def _stretch(segment: Segment, excitation: Excitation, expected: Experiment) -> Stretch:
    rate = excitation.rate_hz
    part = slice(
        round(segment.start_s * rate), max(round(segment.stop_s * rate), round(segment.start_s * rate) + 1)
    )
    torque = next((name for name in TORQUES if name in expected.signals), None)
    # The speed of the shaft is converted to rpm of the engine, the unit of the set point.
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
