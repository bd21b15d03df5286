"""Figures of section 6.3: the loggers' channels and their faults, on the simulated tug."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs import published
from shipfp_rs.inspection.spectrum import amplitude_spectrum
from shipfp_rs.logs.log import Log
from shipfp_rs.plot import style
from shipfp_rs.reproduce.pictures import Picture, Stretch, dress, figure_of, line
from shipfp_rs.reproduce.trial import VESSEL, excitation
from shipfp_rs.signals import steps
from shipfp_rs.simulation.raw_log import Truth, simulate_raw_log
from shipfp_rs.simulation.sensors import EQUATION_6_7, TABLE_6_6, Kind, Sensors
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho import pulse_times, reflector_angles, speed_from_pulses
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


THRESHOLD_V = 2.0
"""Threshold of the thesis's pulse periods (section 6.3.2)."""
STEADY_S = 60.0
FAST_RPM = 1684.0
"""Highest steady speed of the trial (Table 6.8)."""
_DOUBLE = (
    "A sample that falls back below 2 V makes a second crossing and a peak of the speed; with one threshold to arm and "
    "another to fire there is none."
)
_BROKEN = "A pulse that fails doubles an interval; it is put back and flagged."
SENSED = "Simulated tug (stan-tug-1205-full) and sensors; the logs were never published."


@lru_cache(maxsize=2)
def _log(faults: tuple[Kind, ...], what: str = "steady") -> tuple[Log, Truth]:
    vessel = Vessel.load(VESSEL)
    moves = steps([0.0], 5.0, rate_hz=100.0, name="rest") if what == "steady" else excitation(what)
    speed = FAST_RPM if what == "steady" and "B" in faults else None
    sensors = Sensors(faults_per_minute={**Sensors().faults_per_minute, "B": 20.0})
    return simulate_raw_log(
        vessel, moves, sensors=sensors, faults=faults, n_e_rpm=speed, steady_s=STEADY_S, pause_s=1.0
    )


def _volts(log: Log, channel: str, scale: Callable[[Array], Array] = np.asarray) -> tuple[Array, Array]:
    volts = np.asarray(log.read(channel), dtype=np.float64)
    return np.arange(len(volts)) / Sensors().rate_hz, scale(volts)


def _simple_speed(log: Log, channel: str, pulses: int) -> tuple[Array, Array]:
    """Engine speed [rpm] from the periods between all rises through 2 V, as in section 6.1 (eq. 6.8)."""
    time, volts = _volts(log, channel)
    rises = np.flatnonzero((volts[:-1] < THRESHOLD_V) & (volts[1:] >= THRESHOLD_V))
    share = (THRESHOLD_V - volts[rises]) / (volts[rises + 1] - volts[rises])
    at = time[rises] + share * (time[1] - time[0])
    return at[1:], 60.0 * Vessel.load(VESSEL).gearbox.ratio / pulses / np.diff(at)


def _repaired_speed(log: Log) -> tuple[Array, Array]:
    times = pulse_times(np.asarray(log.read("PTM_4")), Sensors().rate_hz)
    angles = reflector_angles(times.times_s, 4)
    found = speed_from_pulses(times.times_s, 4, angles=angles if angles.ok else None)
    return found.time_s, 60.0 * Vessel.load(VESSEL).gearbox.ratio * found.speed_rps


def _shown(
    ax: Axes, samples: tuple[Array, Array], stretch: Stretch, ylabel: str, color: str = style.BLUE, **how: Any
) -> None:
    """Draw a stretch of a channel or of a speed without a legend."""
    time, values = samples
    inside = (time > stretch[0]) & (time < stretch[1])
    line(ax, time[inside], values[inside], color, **how)
    dress(ax, ylabel, "time [s]", legend=False)


def _two_trains(material: Any, figure: Figure) -> str:
    ax, (log, _), stretch = figure.subplots(), _log(()), (20.0, 22.0)
    for channel, pulses, color, ls in (("PTM_1", 1, style.BLUE, "-"), ("PTM_4", 4, style.ORANGE, "--")):
        how: dict[str, Any] = {"ls": ls, "label": f"{pulses} a turn", "drawstyle": "steps-pre"}
        _shown(ax, _simple_speed(log, channel, pulses), stretch, "", color, **how)
    label = "4 a turn, reflectors' angles divided out"
    _shown(ax, _repaired_speed(log), stretch, "", style.GREEN, marker=".", label=label)
    style.dress(ax, "engine speed [rpm]")
    return (
        "Misplaced reflectors make every fourth interval differ by the same share; their angles, found from steady running, "
        f"take that away. {SENSED}"
    )


def _steady_torque(material: Any, figure: Figure) -> str:
    torque = _volts(_log(())[0], "U_torque", TABLE_6_6)
    _shown(figure.subplots(), torque, (20.0, 21.5), "shaft torque [Nm]", style.GREEN, lw=0.8)
    return f"Constant set point. {SENSED}"


def _spectrum(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    time, torque = _volts(_log(())[0], "U_torque", TABLE_6_6)
    frequency, amplitude = amplitude_spectrum(torque[time < STEADY_S], Sensors().rate_hz)
    shown = (frequency > 1.0) & (frequency < 100.0)
    ax.loglog(frequency[shown], amplitude[shown], color=style.GREEN, lw=0.8, label="simulated")
    for peak in published.torque_spectrum_peaks():
        ax.axvline(peak.frequency_hz, color=style.RED, lw=0.8, ls="--")
        at = (peak.frequency_hz, 1.0)
        how: dict[str, Any] = {"color": style.RED, "fontsize": "small", "rotation": 90, "va": "top"}
        place: dict[str, Any] = {
            "xycoords": ("data", "axes fraction"),
            "xytext": (2, -4),
            "textcoords": "offset points",
        }
        ax.annotate(f"{peak.frequency_hz:g} Hz, {peak.source}", at, **place, **how)
    dress(ax, "amplitude of the torque [Nm]", "frequency [Hz]", legend=False)
    return (
        f"Dashed: the peaks of Table 6.9, measured on board. Heights were printed in a figure only. {SENSED}"
    )


def _fault_on_pulses(material: Any, figure: Figure, *, kind: Kind, caption: str) -> str:
    upper, lower = figure.subplots(2, 1, sharex=True)
    log, truth = _log((kind,))
    at = float(truth.faults[kind]["PTM_4"][1, 0])
    stretch = (at - 0.25, at + 0.25)
    for speed, color, label in (
        (_simple_speed(log, "PTM_4", 4), style.RED, "every rise through 2 V"),
        (_repaired_speed(log), style.GREEN, "hysteresis and repair"),
    ):
        _shown(upper, speed, stretch, "", color, label=label, marker="o", ms=3)
    _shown(lower, _volts(log, "PTM_4"), stretch, "pulses PTM_4 [V]", marker=".", ms=3, lw=0.8)
    lower.axhline(THRESHOLD_V, color=style.GREY, lw=0.8, ls="--")
    upper.set_yscale("log")
    dress(upper, "engine speed [rpm]")
    return f"{caption} {SENSED}"


def _radio(material: Any, figure: Figure) -> str:
    panels = figure.subplots(1, 2, width_ratios=(2, 1))
    log, truth = _log(("C",))
    start, stop = truth.faults["C"]["U_torque"][1]
    for ax, first, last, ylabel in (
        (panels[0], start - 20.0, start + 20.0, "shaft torque [Nm]"),
        (panels[1], start - 0.05, stop + 0.05, ""),
    ):
        _shown(ax, _volts(log, "U_torque", TABLE_6_6), (first, last), ylabel, style.GREEN, lw=0.8)
    return f"Radio saturates the receiver for some hundredths of a second. {SENSED}"


def _set_point_faults(material: Any, figure: Figure) -> str:
    upper, lower = figure.subplots(2, 1)
    log, truth = _log(("D1", "D2"), "C23")
    volts = _volts(log, "U_setpoint")
    start, stop = truth.faults["D1"]["U_setpoint"][0]
    begin = truth.faults["D2"]["U_setpoint"][0, 0]
    _shown(upper, volts, (start - 0.2, stop + 0.2), "set point [V]", lw=0.9)
    _shown(lower, volts, (begin - 0.1, begin + 0.2), "set point [V]", lw=0.9)
    upper.set_xlabel("")
    return (
        "Above a jump of the generator's relay (D1), below the mains' 50 Hz that begins with the sweep mode (D2): five "
        f"periods in 0.1 s. {SENSED}"
    )


def _even_chirp(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    log, truth = _log(("D3",), "C21")
    time, recorded = _volts(log, "U_setpoint", EQUATION_6_7)
    start, meant = truth.windows[0].start_s, excitation("C21")
    line(ax, time, recorded, style.BLUE, "recorded", lw=0.8)
    planned = float(np.median(recorded)) + meant.samples
    line(ax, start + meant.time, planned, style.GREY, "as planned", ls="--")
    dress(ax, "set point [rpm]", "time [s]")
    return f"Planned from 0.001 to 0.02 Hz, the generator kept one frequency. {SENSED}"


PICTURES: tuple[Picture[Any], ...] = (
    figure_of("6.11", "one pulse and four pulses a turn", _two_trains),
    figure_of("6.13", "torque at a constant set point", _steady_torque, 4.0),
    figure_of("6.14", "its spectrum", _spectrum, 4.6),
    figure_of("6.15", "fault A, double crossings", _fault_on_pulses, kind="A", caption=_DOUBLE),
    figure_of("6.16", "fault B, broken pulses at high speed", _fault_on_pulses, kind="B", caption=_BROKEN),
    figure_of("6.17", "fault C, radio on the torque", _radio, 4.4),
    figure_of("6.18", "faults D1 and D2 on the set point", _set_point_faults),
    figure_of("6.19", "fault D3, a chirp that stays", _even_chirp, 4.0),
)
