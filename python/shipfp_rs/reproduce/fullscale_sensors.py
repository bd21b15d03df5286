"""Painters of the figures of section 6.3: what the loggers' channels look like, and their faults, on the simulated tug."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs import published
from shipfp_rs.inspection.spectrum import amplitude_spectrum
from shipfp_rs.logs.log import Log
from shipfp_rs.plot import style
from shipfp_rs.reproduce.fullscale_trial import VESSEL, excitation
from shipfp_rs.signals import steps
from shipfp_rs.simulation.raw_log import Truth, simulate_raw_log
from shipfp_rs.simulation.sensors import EQUATION_6_7, TABLE_6_6, Kind, Sensors
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho import pulse_times, reflector_angles, speed_from_pulses
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
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


def two_trains(material: Any, figure: Figure) -> str:
    """Figure 6.11."""
    ax = figure.subplots()
    log, _ = _log(())
    gear = Vessel.load(VESSEL).gearbox.ratio
    for channel, pulses, color, line in (("PTM_1", 1, style.BLUE, "-"), ("PTM_4", 4, style.ORANGE, "--")):
        at, speed = _simple_speed(*_volts(log, channel), pulses, gear)
        shown = (at > 20.0) & (at < 22.0)
        ax.step(at[shown], speed[shown], where="pre", color=color, ls=line, label=f"{pulses} a turn")
    at, speed = _repaired_speed(log, "PTM_4", 4, gear)
    shown = (at > 20.0) & (at < 22.0)
    ax.plot(
        at[shown],
        speed[shown],
        ".-",
        color=style.GREEN,
        lw=1.0,
        label="4 a turn, reflectors' angles divided out",
    )
    ax.set_xlabel("time [s]")
    style.dress(ax, "engine speed [rpm]")
    return (
        "Misplaced reflectors make every fourth interval differ by the same share; their angles, found from steady running, "
        f"take that away. {SIMULATED}"
    )


def steady_torque(material: Any, figure: Figure) -> str:
    """Figure 6.13."""
    ax = figure.subplots()
    time, volts = _volts(_log(())[0], "U_torque")
    shown = (time > 20.0) & (time < 21.5)
    ax.plot(time[shown], TABLE_6_6(volts[shown]), color=style.GREEN, lw=0.8)
    ax.set_xlabel("time [s]")
    style.dress(ax, "shaft torque [Nm]", legend=False)
    return f"Constant set point. {SIMULATED}"


def spectrum(material: Any, figure: Figure) -> str:
    """Figure 6.14."""
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


def _fault_on_pulses(figure: Figure, kind: Kind, around_s: float) -> None:
    upper, lower = figure.subplots(2, 1, sharex=True)
    log, truth = _log((kind,))
    gear = Vessel.load(VESSEL).gearbox.ratio
    at = float(truth.faults[kind]["PTM_4"][1, 0])
    start, stop = at - around_s, at + around_s
    time, volts = _volts(log, "PTM_4")
    for ax, (when, speed), color, label in (
        (upper, _simple_speed(time, volts, 4, gear), style.RED, "every rise through 2 V"),
        (upper, _repaired_speed(log, "PTM_4", 4, gear), style.GREEN, "hysteresis and repair"),
    ):
        shown = (when > start) & (when < stop)
        ax.plot(when[shown], speed[shown], "o-", ms=3, lw=1.0, color=color, label=label)
    shown = (time > start) & (time < stop)
    lower.plot(time[shown], volts[shown], ".-", ms=3, lw=0.8, color=style.BLUE)
    lower.axhline(THRESHOLD_V, color=style.GREY, lw=0.8, ls="--")
    lower.set_xlabel("time [s]")
    upper.set_yscale("log")
    style.dress(upper, "engine speed [rpm]")
    style.dress(lower, "pulses PTM_4 [V]", legend=False)


def double_crossing(material: Any, figure: Figure) -> str:
    """Figure 6.15."""
    _fault_on_pulses(figure, "A", 0.25)
    return (
        "A sample that falls back below 2 V makes a second crossing and a peak of the speed; with one threshold to arm and "
        f"another to fire there is none. {SIMULATED}"
    )


def broken_pulses(material: Any, figure: Figure) -> str:
    """Figure 6.16."""
    _fault_on_pulses(figure, "B", 0.25)
    return f"A pulse that fails doubles an interval; it is put back and flagged. {SIMULATED}"


def radio(material: Any, figure: Figure) -> str:
    """Figure 6.17."""
    panels = figure.subplots(1, 2, width_ratios=(2, 1))
    log, truth = _log(("C",))
    time, volts = _volts(log, "U_torque")
    start, stop = truth.faults["C"]["U_torque"][1]
    for ax, first, last in zip(
        panels, (start - 20.0, start - 0.05), (start + 20.0, stop + 0.05), strict=True
    ):
        shown = (time > first) & (time < last)
        ax.plot(*style.envelope(time[shown], TABLE_6_6(volts[shown])), color=style.GREEN, lw=0.8)
        ax.set_xlabel("time [s]")
        style.dress(ax, "shaft torque [Nm]" if ax is panels[0] else "", legend=False)
    return f"Radio saturates the receiver for some hundredths of a second. {SIMULATED}"


def set_point_faults(material: Any, figure: Figure) -> str:
    """Figure 6.18."""
    upper, lower = figure.subplots(2, 1)
    log, truth = _log(("D1", "D2"), "C23")
    time, volts = _volts(log, "U_setpoint")
    start, stop = truth.faults["D1"]["U_setpoint"][0]
    shown = (time > start - 0.2) & (time < stop + 0.2)
    upper.plot(time[shown], volts[shown], color=style.BLUE, lw=0.9)
    style.dress(upper, "set point [V]", legend=False)
    begin = truth.faults["D2"]["U_setpoint"][0, 0]
    shown = (time > begin - 0.1) & (time < begin + 0.2)
    lower.plot(time[shown], volts[shown], color=style.BLUE, lw=0.9)
    lower.set_xlabel("time [s]")
    style.dress(lower, "set point [V]", legend=False)
    return (
        "Above a jump of the generator's relay (D1), below the mains' 50 Hz that begins with the sweep mode (D2): five "
        f"periods in 0.1 s. {SIMULATED}"
    )


def even_chirp(material: Any, figure: Figure) -> str:
    """Figure 6.19."""
    ax = figure.subplots()
    log, truth = _log(("D3",), "C21")
    time, volts = _volts(log, "U_setpoint")
    window = truth.windows[0]
    meant = excitation("C21")
    ax.plot(*style.envelope(time, EQUATION_6_7(volts)), color=style.BLUE, lw=0.8, label="recorded")
    centre = float(np.median(EQUATION_6_7(volts)))
    ax.plot(
        window.start_s + meant.time,
        centre + meant.samples,
        color=style.GREY,
        lw=1.0,
        ls="--",
        label="as planned",
    )
    ax.set_xlabel("time [s]")
    style.dress(ax, "set point [rpm]")
    return f"Planned from 0.001 to 0.02 Hz, the generator kept one frequency. {SIMULATED}"
