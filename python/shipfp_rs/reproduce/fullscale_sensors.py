"""Figures of section 6.3: what the loggers' channels look like, and their faults, on the simulated tug."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs import published
from shipfp_rs.inspection.spectrum import amplitude_spectrum
from shipfp_rs.logs.log import Log
from shipfp_rs.plot import style
from shipfp_rs.reproduce.fullscale_trial import VESSEL, excitation
from shipfp_rs.reproduce.pictures import Picture, Stretch, figure_of, line
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
"""Of the thesis's pulse periods (section 6.3.2)."""
STEADY_S = 60.0
FAST_RPM = 1684.0
"""Highest steady speed of the trial (Table 6.8)."""
SIMULATED = "Simulated tug (stan-tug-1205-full) and sensors; the logs were never published."


@lru_cache(maxsize=2)
def _log(faults: tuple[Kind, ...], what: str = "steady") -> tuple[Log, Truth]:
    vessel = Vessel.load(VESSEL)
    moves = steps([0.0], 5.0, rate_hz=100.0, name="rest") if what == "steady" else excitation(what)
    speed = FAST_RPM if what == "steady" and "B" in faults else None
    sensors = Sensors(faults_per_minute={**Sensors().faults_per_minute, "B": 20.0})
    return simulate_raw_log(
        vessel, moves, sensors=sensors, faults=faults, n_e_rpm=speed, steady_s=STEADY_S, pause_s=1.0
    )


def _volts(log: Log, channel: str) -> tuple[Array, Array]:
    volts = np.asarray(log.read(channel), dtype=np.float64)
    return np.arange(len(volts)) / Sensors().rate_hz, volts


def _simple_speed(time: Array, volts: Array, pulses: int, gear: float) -> tuple[Array, Array]:
    """Engine speed [rpm] from the periods between all rises through 2 V, as section 6.1 makes it (eq. 6.8)."""
    rises = np.flatnonzero((volts[:-1] < THRESHOLD_V) & (volts[1:] >= THRESHOLD_V))
    share = (THRESHOLD_V - volts[rises]) / (volts[rises + 1] - volts[rises])
    at = time[rises] + share * (time[1] - time[0])
    return at[1:], 60.0 * gear / pulses / np.diff(at)


def _repaired_speed(log: Log, channel: str, pulses: int, gear: float) -> tuple[Array, Array]:
    times = pulse_times(np.asarray(log.read(channel)), Sensors().rate_hz)
    angles = reflector_angles(times.times_s, pulses)
    found = speed_from_pulses(times.times_s, pulses, angles=angles if angles.ok else None)
    return found.time_s, 60.0 * gear * found.speed_rps


def _shown(
    ax: Axes, time: Array, samples: Array, stretch: Stretch, ylabel: str, color: str = style.BLUE, **how: Any
) -> None:
    """Draw a stretch of a channel or of a speed without a legend."""
    inside = (time > stretch[0]) & (time < stretch[1])
    line(ax, time[inside], samples[inside], color, **how)
    ax.set_xlabel("time [s]")
    style.dress(ax, ylabel, legend=False)


def _two_trains(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    log, _ = _log(())
    gear, stretch = Vessel.load(VESSEL).gearbox.ratio, (20.0, 22.0)
    for channel, pulses, color, ls in (("PTM_1", 1, style.BLUE, "-"), ("PTM_4", 4, style.ORANGE, "--")):
        found = _simple_speed(*_volts(log, channel), pulses, gear)
        _shown(ax, *found, stretch, "", color, ls=ls, label=f"{pulses} a turn", drawstyle="steps-pre")
    found, label = _repaired_speed(log, "PTM_4", 4, gear), "4 a turn, reflectors' angles divided out"
    _shown(ax, *found, stretch, "", style.GREEN, marker=".", label=label)
    style.dress(ax, "engine speed [rpm]")
    return (
        "Misplaced reflectors make every fourth interval differ by the same share; their angles, found from steady running, "
        f"take that away. {SIMULATED}"
    )


def _steady_torque(material: Any, figure: Figure) -> str:
    time, volts = _volts(_log(())[0], "U_torque")
    _shown(figure.subplots(), time, TABLE_6_6(volts), (20.0, 21.5), "shaft torque [Nm]", style.GREEN, lw=0.8)
    return f"Constant set point. {SIMULATED}"


def _spectrum(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    time, volts = _volts(_log(())[0], "U_torque")
    frequency, amplitude = amplitude_spectrum(TABLE_6_6(volts[time < STEADY_S]), Sensors().rate_hz)
    shown = (frequency > 1.0) & (frequency < 100.0)
    ax.loglog(frequency[shown], amplitude[shown], color=style.GREEN, lw=0.8, label="simulated")
    for peak in published.torque_spectrum_peaks():
        ax.axvline(peak.frequency_hz, color=style.RED, lw=0.8, ls="--")
        ax.annotate(
            f"{peak.frequency_hz:g} Hz, {peak.source}",
            (peak.frequency_hz, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(2, -4),
            textcoords="offset points",
            rotation=90,
            va="top",
            fontsize="small",
            color=style.RED,
        )
    ax.set_xlabel("frequency [Hz]")
    style.dress(ax, "amplitude of the torque [Nm]", legend=False)
    return f"Dashed: the peaks of Table 6.9, measured on board. Heights were printed in a figure only. {SIMULATED}"


def _fault_on_pulses(figure: Figure, kind: Kind) -> None:
    upper, lower = figure.subplots(2, 1, sharex=True)
    log, truth = _log((kind,))
    gear = Vessel.load(VESSEL).gearbox.ratio
    at = float(truth.faults[kind]["PTM_4"][1, 0])
    stretch = (at - 0.25, at + 0.25)
    time, volts = _volts(log, "PTM_4")
    dots: dict[str, Any] = {"marker": "o", "ms": 3}
    simple, repaired = _simple_speed(time, volts, 4, gear), _repaired_speed(log, "PTM_4", 4, gear)
    _shown(upper, *simple, stretch, "", style.RED, label="every rise through 2 V", **dots)
    _shown(upper, *repaired, stretch, "", style.GREEN, label="hysteresis and repair", **dots)
    _shown(lower, time, volts, stretch, "pulses PTM_4 [V]", marker=".", ms=3, lw=0.8)
    lower.axhline(THRESHOLD_V, color=style.GREY, lw=0.8, ls="--")
    upper.set_yscale("log")
    upper.set_xlabel("")
    style.dress(upper, "engine speed [rpm]")


def _double_crossing(material: Any, figure: Figure) -> str:
    _fault_on_pulses(figure, "A")
    return (
        "A sample that falls back below 2 V makes a second crossing and a peak of the speed; with one threshold to arm and "
        f"another to fire there is none. {SIMULATED}"
    )


def _broken_pulses(material: Any, figure: Figure) -> str:
    _fault_on_pulses(figure, "B")
    return f"A pulse that fails doubles an interval; it is put back and flagged. {SIMULATED}"


def _radio(material: Any, figure: Figure) -> str:
    panels = figure.subplots(1, 2, width_ratios=(2, 1))
    log, truth = _log(("C",))
    time, volts = _volts(log, "U_torque")
    start, stop = truth.faults["C"]["U_torque"][1]
    for ax, first, last, ylabel in (
        (panels[0], start - 20.0, start + 20.0, "shaft torque [Nm]"),
        (panels[1], start - 0.05, stop + 0.05, ""),
    ):
        _shown(ax, time, TABLE_6_6(volts), (first, last), ylabel, style.GREEN, lw=0.8)
    return f"Radio saturates the receiver for some hundredths of a second. {SIMULATED}"


def _set_point_faults(material: Any, figure: Figure) -> str:
    upper, lower = figure.subplots(2, 1)
    log, truth = _log(("D1", "D2"), "C23")
    time, volts = _volts(log, "U_setpoint")
    start, stop = truth.faults["D1"]["U_setpoint"][0]
    begin = truth.faults["D2"]["U_setpoint"][0, 0]
    _shown(upper, time, volts, (start - 0.2, stop + 0.2), "set point [V]", lw=0.9)
    _shown(lower, time, volts, (begin - 0.1, begin + 0.2), "set point [V]", lw=0.9)
    upper.set_xlabel("")
    return (
        "Above a jump of the generator's relay (D1), below the mains' 50 Hz that begins with the sweep mode (D2): five "
        f"periods in 0.1 s. {SIMULATED}"
    )


def _even_chirp(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    log, truth = _log(("D3",), "C21")
    time, volts = _volts(log, "U_setpoint")
    start, meant = truth.windows[0].start_s, excitation("C21")
    recorded = EQUATION_6_7(volts)
    line(ax, time, recorded, style.BLUE, "recorded", lw=0.8)
    planned = float(np.median(recorded)) + meant.samples
    line(ax, start + meant.time, planned, style.GREY, "as planned", ls="--")
    ax.set_xlabel("time [s]")
    style.dress(ax, "set point [rpm]")
    return f"Planned from 0.001 to 0.02 Hz, the generator kept one frequency. {SIMULATED}"


PICTURES: tuple[Picture[Any], ...] = (
    figure_of("6.11", "one pulse and four pulses a turn", _two_trains),
    figure_of("6.13", "torque at a constant set point", _steady_torque, 4.0),
    figure_of("6.14", "its spectrum", _spectrum, 4.6),
    figure_of("6.15", "fault A, double crossings", _double_crossing),
    figure_of("6.16", "fault B, broken pulses at high speed", _broken_pulses),
    figure_of("6.17", "fault C, radio on the torque", _radio, 4.4),
    figure_of("6.18", "faults D1 and D2 on the set point", _set_point_faults),
    figure_of("6.19", "fault D3, a chirp that stays", _even_chirp, 4.0),
)
