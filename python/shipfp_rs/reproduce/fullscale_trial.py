"""The tug's trial of 5 November 2019 again, on a simulated ship: its logs were never published, its plan was (Table 6.7)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from shipfp_rs import published
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.signals import Excitation, chirp, join, sine_sequence, steps
from shipfp_rs.simulation.sensors import EQUATION_6_7
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.vessel.vessel import Vessel

VESSEL = "stan-tug-1205-full"
AMPLITUDE_RPM = 76.0
"""Of sines and chirps: 0.6 V peak to peak by eq. 6.7 (the sine fits of Table E.1)."""
CHIRP_S = 500.0
"""Longest sweep of the signal generator (section 6.2.2)."""
OPERATING_V = -5.0
LEAD_S = 20.0
"""Time from the operating point to the first level of the steps, cut off the record."""
TOGETHER = {
    "sines": tuple(f"S{number}" for number in range(2, 14)),
    "short chirp": ("C11",),
    "long chirp": ("C21", "C22", "C23"),
    "steps": ("St1",),
}
"""Experiments that the thesis treats as one signal (Tables 7.1 to 7.3)."""


@cache
def plan() -> dict[str, published.FullScaleExperiment]:
    """Return the experiments of Table 6.7, name to row."""
    return {experiment.name: experiment for experiment in published.full_scale_experiments()}


def excitation(name: str, *, rate_hz: float = 100.0) -> Excitation:
    """Return the set point of an experiment of Table 6.7 about the operating point.

    Sines last for whole periods within their time of the log, chirps are logarithmic and last 500 s, steps climb from
    the level of the lowest voltage to the highest and down again, each level for the same time.

    Parameters
    ----------
    name
        "S1" to "S17", "C11", "C21" to "C23", "St1" or "St2".
    rate_hz
        Sample rate [Hz].

    Raises
    ------
    InputError
        For another name.
    """
    if name not in plan():
        raise InputError(f"experiment {name!r}, expected one of {', '.join(plan())}")
    row = plan()[name]
    lasts = row.jvs_stop_s - row.jvs_start_s
    if row.kind == "chirp":
        start, stop = float(row.frequency_hz or 0.0), float(row.stop_frequency_hz or 0.0)
        return chirp(start, stop, CHIRP_S, AMPLITUDE_RPM, rate_hz=rate_hz, name=name)
    if row.kind == "sine":
        frequency = float(row.frequency_hz or 0.0)
        share = float(row.peak_to_peak_v or 0.0) / 0.6
        periods = max(1, int(frequency * lasts))
        return sine_sequence([frequency], periods, share * AMPLITUDE_RPM, rate_hz=rate_hz, name=name)
    lowest, highest = abs(float(row.min_v or 0.0)), abs(float(row.max_v or 0.0))
    climb = np.arange(lowest, highest + 0.5, float(row.step_v or 1.0))
    volts = -np.concatenate((climb, climb[-2::-1]))
    levels = EQUATION_6_7(volts) - float(EQUATION_6_7(OPERATING_V))
    return steps(np.diff(levels, prepend=0.0), lasts / len(levels), lead_s=0.0, rate_hz=rate_hz, name=name)


LOGGED = ("n_set", "n_e", "M_g")


@cache
def simulated(name: str, *, rate_hz: float = 100.0) -> Experiment:
    """Return what the tug's whole drive train answers to an experiment of Table 6.7, as perfect sensors would log it.

    Parameters
    ----------
    name
        As for `excitation`, or "short chirp" (C11), "long chirp" (C21 to C23 one after the other), "sines" (S2 to S13)
        or "steps" (St1).
    rate_hz
        Sample rate [Hz].

    Returns
    -------
    Experiment
        n_set, n_e and M_g; steps begin at their first level.
    """
    parts = [excitation(part, rate_hz=rate_hz) for part in TOGETHER.get(name, (name,))]
    record = simulate(Vessel.load(VESSEL), join(parts, name=name) if len(parts) > 1 else parts[0])
    record = replace(record, name=name, signals={signal: record.signals[signal] for signal in LOGGED})
    if parts[0].kind != "steps":
        return record
    return record.window(min(LEAD_S, record.duration / 16.0), record.duration, name=name)
