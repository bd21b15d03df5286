"""Plots of an inspection: windows, spectra with named lines, torque over speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from shipfp_rs.inspection import Inspection
from shipfp_rs.logs.log import Log
from shipfp_rs.plot.style import envelope, plain_numbers

COLOURS = {"steady": "#b8c4ce", "chirp": "#2a9d6f", "steps": "#c9762b", "other": "#a23b72"}
COLOURS |= dict.fromkeys(("sine", "sines", "multisine"), "#2f6db3") | dict.fromkeys(
    ("squares", "prbs"), "#7a6f2b"
)
WIDTH, HEIGHT = 10.0, 4.0


def draw(inspection: Inspection, log: Log, folder: Path) -> list[Path]:
    """Write all plots that are not empty to a folder; return their paths."""
    written = []
    if inspection.windows:
        written.append(_saved(_windows(inspection, log), folder / "windows.png"))
    written += [
        _saved(_spectrum(inspection, channel), folder / f"spectrum-{number}.png")
        for number, channel in enumerate(inspection.spectra, 1)
    ]
    if "static_torque" in inspection.checks:
        written.append(_saved(_static_torque(inspection), folder / "static-torque.png"))
    return written


def _saved(figure: Figure, path: Path) -> Path:
    figure.savefig(path, format="png")
    return path


def _figure() -> Figure:
    return Figure(figsize=(WIDTH, HEIGHT), dpi=110, layout="constrained")


def _windows(inspection: Inspection, log: Log) -> Figure:
    figure = _figure()
    axes = figure.add_subplot()
    name = str(inspection.checks.get("set_point_channel"))
    channel = log.channel(name)
    stride = max(channel.samples // 200_000, 1)
    samples = np.concatenate([np.asarray(chunk[::stride], dtype=np.float64) for chunk in log.chunks(name)])
    index = np.arange(len(samples), dtype=np.float64)
    time = channel.start_s + index * (channel.samples / len(samples)) / channel.rate_hz
    axes.plot(*envelope(time, samples), color="#1d3557", linewidth=0.7)
    for window in inspection.windows:
        axes.axvspan(
            window.start_s,
            window.stop_s,
            color=COLOURS.get(window.kind, COLOURS["other"]),
            alpha=0.3,
            linewidth=0,
        )
        if window.kind != "steady":
            axes.text(
                0.5 * (window.start_s + window.stop_s),
                1.01,
                window.name,
                transform=axes.get_xaxis_transform(),
                ha="center",
                fontsize=7,
                rotation=90 if len(inspection.windows) > 12 else 0,
            )
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{name} [{channel.unit}]" if channel.unit else name)
    axes.margins(x=0.0)
    return figure


def _spectrum(inspection: Inspection, channel: str) -> Figure:
    frequency, amplitude = inspection.spectra[channel]
    figure = _figure()
    axes = figure.add_subplot()
    shown = frequency > 0.2
    # Zeros can't be drawn on a logarithmic axis.
    plot = axes.loglog if (amplitude[shown] > 0.0).any() else axes.semilogx
    plot(frequency[shown], amplitude[shown], color="#1d3557", linewidth=0.7)
    for peak in inspection.peaks[channel]:
        label = f"{peak.name or ''} {peak.frequency_hz:.2f} Hz".strip()
        axes.annotate(
            label,
            (peak.frequency_hz, peak.amplitude),
            textcoords="offset points",
            xytext=(0, 6),
            ha="left",
            fontsize=8 if peak.name else 6,
            rotation=40,
            color="#c0392b" if peak.name else "#666666",
        )
    axes.margins(x=0.02, y=0.25)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude of {channel} [{inspection.checks['spectra'][channel]['unit']}]")
    return figure


def _static_torque(inspection: Inspection) -> Figure:
    check = inspection.checks["static_torque"]
    figure = _figure()
    axes = figure.add_subplot()
    axes.plot(check["n_e_rpm"], check["measured_Nm"], "o", color="#c0392b", label="measured")
    axes.plot(check["n_e_rpm"], check["calculated_Nm"], "-", color="#1d3557", label="eq. 6.3")
    exponent = check["exponent"]
    axes.set_title("" if exponent is None else f"measured torque goes with n^{exponent:.2f}", fontsize=10)
    axes.set_xlabel("engine speed [rpm]")
    axes.set_ylabel("shaft torque [Nm]")
    plain_numbers(axes)
    axes.legend()
    return figure
