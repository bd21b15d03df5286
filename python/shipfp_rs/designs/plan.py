"""Plan of a trial: set point, expected results, and the files for crew and signal generator."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.designs.limits import Generator, Limits, steepest_rpm_s
from shipfp_rs.designs.noise import Noise
from shipfp_rs.designs.pictures import figure
from shipfp_rs.designs.prediction import Prediction
from shipfp_rs.designs.run_sheet import Stretch, as_html, as_text
from shipfp_rs.designs.spectrum import Criterion
from shipfp_rs.designs.waveforms import Kind
from shipfp_rs.signals import Excitation
from shipfp_rs.support.arrays import Array, Brief, attributes
from shipfp_rs.support.files import replacing_folder
from shipfp_rs.support.json_files import json_text

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
    """Time needed for all named standard deviations to be within `accuracy_pct` of their values.

    `duration_s` is estimated from the plan and one twice as long; infinite if errors of the gauges alone are larger.
    """

    accuracy_pct: float
    duration_s: float
    limited_by: str
    met: bool


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
        Lower bound on the efficiency of the shares [-], by the equivalence theorem.
    designed_for
        Names of the parameters for which the lines are chosen: all that small motions determine.
    prediction
        Standard deviations, and undetermined parameters.
    needed
        Time needed for the target accuracy, if one was given.
    sheet
        The crew's run sheet.
    set_point_rpm
        Operating point [rpm of the engine].
    sensors
        Assumed noise, by output.
    limits, generator
        Arguments of `design`.
    notes
        Information for the user, in sentences.
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
            "parameters": {name: row.to_dict() for name, row in self.prediction.parameters.items()},
            "derived": {name: row.to_dict() for name, row in self.prediction.derived.items()},
            "relative_std_pct": self.prediction.relative_pct,
            "identifiability": self.prediction.identifiability.to_dict(),
            "needed": None if self.needed is None else _finite(asdict(self.needed)),
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
            (made / "run_sheet.html").write_text(as_html(title, self.heading(), self.sheet), encoding="utf-8")
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


def _finite(table: dict[str, Any]) -> dict[str, Any]:
    """Replace infinite values by null, since JSON has no infinity."""
    return {key: None if value == math.inf else value for key, value in table.items()}


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
    """Time for an accuracy of all `names`, from the standard deviations [%] after a duration and after twice that.

    A variance is the sum of a part that decreases with time and a constant part, from errors of gauges and calibration.
    """
    limiting = max(names, key=lambda name: now[name])
    first, second = now[limiting] ** 2, later.get(limiting, now[limiting]) ** 2
    falling = 2.0 * max(first - second, 0.0) * duration_s
    room = accuracy_pct**2 - max(2.0 * second - first, 0.0)
    duration = falling / room if room > 0.0 else math.inf
    return Needed(accuracy_pct, duration, limiting, now[limiting] <= accuracy_pct)
