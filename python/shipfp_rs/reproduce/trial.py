"""The tug's trial of 5 November 2019 on simulated ships; its plan was published (Table 6.7), its logs were not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from shipfp_rs import published
from shipfp_rs.assessment.si import parameters_of
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.signals import Excitation, chirp, join, sine_sequence, steps
from shipfp_rs.simulation.raw_log import (
    EQUATION_6_7,
    Kind,
    Sensors,
    TrueWindow,
    Truth,
    simulate_raw_log,
    trial_tables,
)
from shipfp_rs.simulation.simulate import Inflow, simulate
from shipfp_rs.vessel.vessel import Vessel

VESSEL = "stan-tug-1205-full"
AMPLITUDE_RPM = 76.0
"""Amplitude of sines and chirps: 0.6 V peak to peak, converted by eq. 6.7 (sine fits of Table E.1)."""
CHIRP_S = 500.0
"""Longest sweep of the signal generator (section 6.2.2)."""
OPERATING_V = -5.0
STEPS_LEAD_S = 20.0
"""Time from the operating point to the first level of the steps; the record omits it."""
SINES = tuple(f"S{number}" for number in range(2, 14))
LONG_CHIRP = ("C21", "C22", "C23")
TOGETHER = {"sines": SINES, "short chirp": ("C11",), "long chirp": LONG_CHIRP, "steps": ("St1",)}
"""Experiments that the thesis treats as a single signal (Tables 7.1 to 7.3)."""
EVERYTHING = (*SINES, "C11", *LONG_CHIRP, "St1", "St2")
LOGGED = ("n_set", "n_e", "M_g")
LAST_HZ = 0.9
"""Highest frequency at which, at the trial's amplitude, no limit acts on any drawn ship. The smoke limit acts from
0.94 Hz on the fastest ships, the torque's rate limit from 1.16 Hz on the tug. No fitted structure has these limits, so S13
(1.637 Hz) is not fitted, and chirps are cut at this frequency.
"""
RATE_HZ = 20.0
"""Sample rate at which linear interpolation of the set point is accurate."""
SIMULATED_HZ = 200.0
STEADY_S, PAUSE_S, LEAD_S = 300.0, 20.0, 2.0
"""Times: before the first experiment, between experiments, and at constant set point at the start of each record."""
SPREAD = 0.1
"""Half width, relative to the tug's values, of the ranges from which each trial's ship is drawn."""
DRAWN = (
    "shaft.inertia_kg_m2",
    "shaft.propeller_side_inertia_kg_m2",
    "governor.K_p",
    "governor.K_i",
    "governor.set_point_dead_time_s",
    "actuator.dead_time_s",
    "operating_point.v",
    "operating_point.g",
)
FAULTS: tuple[Kind, ...] = ("A", "B", "C", "D1", "D2", "gap", "dropout")
"""Faults of section 6.4, and two that any logger may have. D3 is omitted: it would turn the signal generator's chirp
into a sine.
"""


@cache
def plan() -> dict[str, published.FullScaleExperiment]:
    """Return the experiments of Table 6.7 by name."""
    return {experiment.name: experiment for experiment in published.full_scale_experiments()}


def excitation(name: str, *, rate_hz: float = 100.0) -> Excitation:
    """Return the set point of an experiment of Table 6.7, "S1" to "St2", about the operating point."""
    # Sines last for whole periods within their time in the log; chirps are logarithmic and last 500 s.
    # Steps go from the level of the lowest voltage to the highest and back, each level for the same time.
    if name not in plan():
        raise InputError(f"experiment {name!r}, expected one of {', '.join(plan())}")
    row = plan()[name]
    lasts, frequency = row.jvs_stop_s - row.jvs_start_s, float(row.frequency_hz or 0.0)
    if row.kind == "chirp":
        stop = float(row.stop_frequency_hz or 0.0)
        return chirp(frequency, stop, CHIRP_S, AMPLITUDE_RPM, rate_hz=rate_hz, name=name)
    if row.kind == "sine":
        share = float(row.peak_to_peak_v or 0.0) / 0.6
        periods = max(1, int(frequency * lasts))
        return sine_sequence([frequency], periods, share * AMPLITUDE_RPM, rate_hz=rate_hz, name=name)
    lowest, highest = abs(float(row.min_v or 0.0)), abs(float(row.max_v or 0.0))
    climb = np.arange(lowest, highest + 0.5, float(row.step_v or 1.0))
    volts = -np.concatenate((climb, climb[-2::-1]))
    levels = EQUATION_6_7(volts) - float(EQUATION_6_7(OPERATING_V))
    return steps(np.diff(levels, prepend=0.0), lasts / len(levels), lead_s=0.0, rate_hz=rate_hz, name=name)


@cache
def simulated(name: str) -> Experiment:
    """Return the tug's response, with perfect sensors, to an experiment or to a group of `TOGETHER`."""
    parts = [excitation(part) for part in TOGETHER.get(name, (name,))]
    record = simulate(Vessel.load(VESSEL), join(parts, name=name) if len(parts) > 1 else parts[0])
    record = replace(record, name=name, signals={signal: record.signals[signal] for signal in LOGGED})
    if parts[0].kind != "steps":
        return record
    return record.window(min(STEPS_LEAD_S, record.duration / 16.0), record.duration, name=name)


def drawn(seed: int) -> Vessel:
    """Return the tug with all parameters drawn at random; seed 0 gives the tug itself."""
    tug = Vessel.load(VESSEL)
    if seed == 0:
        return tug
    random = np.random.default_rng([0x7, seed])
    changes = {}
    for key in DRAWN:
        section, name = key.split(".")
        changes[key] = getattr(getattr(tug, section), name) * random.uniform(1.0 - SPREAD, 1.0 + SPREAD)
    changes["propeller.torque_exponent"] = random.uniform(2.0, 2.3)
    return tug.replace(changes)


@dataclass(frozen=True)
class Twin:
    """A simulated trial: the raw log at 2 kHz with noise, faults and disturbed inflow, and the true values."""

    vessel: Vessel
    log: Log
    recorded: Truth
    processed: dict[float, dict[str, Experiment]] = field(default_factory=dict, repr=False)
    """Processed experiments by rate and name."""

    @classmethod
    def of(cls, seed: int, names: Sequence[str] = EVERYTHING, *, still: bool = False) -> Twin:
        """Simulate the trial of a seed, which sets ship, inflow and faults; `still` omits inflow, noise and faults."""
        vessel = drawn(seed)
        silent = Sensors(set_point_noise_V=0.0, torque_noise_V=0.0, pulse_noise_V=0.0)
        log, truth = simulate_raw_log(
            vessel,
            [excitation(name, rate_hz=SIMULATED_HZ) for name in names],
            sensors=silent if still else None,
            faults=() if still else FAULTS,
            steady_s=STEADY_S,
            pause_s=PAUSE_S,
            inflow=None if still else Inflow(),
            simulated_hz=SIMULATED_HZ,
            seed=seed,
        )
        return cls(vessel, log, truth)

    @property
    def truth(self) -> dict[str, float]:
        """True parameters of the linear structure at the operating point."""
        return parameters_of(self.vessel)

    def experiments(self, names: Sequence[str], rate_hz: float = RATE_HZ) -> list[Experiment]:
        """Process experiments from the log like `shipfp process`; only the times of the windows are the true ones."""
        if rate_hz not in self.processed:
            recorded = replace(self.recorded, windows=tuple(map(_fitted, self.recorded.windows)))
            trial = Trial.model_validate(trial_tables(VESSEL, self.log.name, Sensors(), recorded))
            processing = trial.processing.model_copy(update={"rate_hz": rate_hz})
            found = process(
                self.log, trial.model_copy(update={"processing": processing}), Vessel.load(VESSEL)
            )
            self.processed[rate_hz] = {one.name: replace(one, hold="first") for one in found}
        return [self.processed[rate_hz][name] for name in names]


def _fitted(window: TrueWindow) -> TrueWindow:
    """Return the fitted time range of an experiment: from `LEAD_S` before it to its end or to `LAST_HZ`."""
    row = plan()[window.name]
    start, stop, length = row.frequency_hz, row.stop_frequency_hz, window.stop_s - window.start_s
    if start is not None and stop is not None and stop > LAST_HZ:
        length *= math.log(LAST_HZ / start) / math.log(stop / start)
    return TrueWindow(window.name, window.kind, window.start_s - LEAD_S, window.start_s + length)
