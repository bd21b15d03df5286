"""The tug's whole trial in one raw log, of ships whose parameters are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from shipfp_rs.assessment.ship_parameters import parameters_of
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.reproduce.fullscale_trial import VESSEL, excitation, plan
from shipfp_rs.simulation.inflow import Inflow
from shipfp_rs.simulation.raw_log import Truth, simulate_raw_log, trial_tables
from shipfp_rs.simulation.sensors import Kind, Sensors, TrueWindow
from shipfp_rs.vessel.vessel import Vessel

LAST_HZ = 0.9
"""Up to here no limit acts at the trial's amplitude on any ship drawn: of the most lively ones the smoke limit acts from
0.94 Hz on, of the tug itself the torque's limit of rate from 1.16 Hz. No structure that is fitted has
them. S13 (1.637 Hz) is not fitted therefore, and the chirps are cut where they pass this frequency."""
RATE_HZ = 20.0
"""So fast that the set point's course between its samples is as good as straight."""
SIMULATED_HZ = 200.0
STEADY_S = 300.0
"""At the operating point, before the first experiment."""
PAUSE_S = 20.0
LEAD_S = 2.0
"""Kept of the pause before each experiment, so that it begins at rest."""
SPREAD = 0.1
"""Half width of the ranges, over the tug's own values, in which each trial's ship is drawn."""
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
"""Those of section 6.4 and two of any logger's; D3 makes a sine of the signal generator's chirp."""
EVERYTHING = (*(f"S{number}" for number in range(2, 14)), "C11", "C21", "C22", "C23", "St1", "St2")


def drawn(seed: int) -> Vessel:
    """Return the tug with every parameter drawn anew; the seed 0 gives the tug itself."""
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
    """A ship's trial as a raw log, and the truth."""

    vessel: Vessel
    """The ship."""
    log: Log
    """Set point, torque and three pulse trains at 2 kHz, with noise and faults, in moving water."""
    recorded: Truth
    """Where the experiments lie in it."""
    processed: dict[float, dict[str, Experiment]] = field(default_factory=dict, repr=False)
    """Experiments by rate and name, once they have been asked for."""

    @classmethod
    def of(cls, seed: int, names: Sequence[str] = EVERYTHING, *, still: bool = False) -> Twin:
        """Make the trial of a seed: its ship, its sea, its faults; `still` leaves out water, noise and faults."""
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
        """Parameters of the linear structure at the operating point."""
        return parameters_of(self.vessel)

    def experiments(self, names: Sequence[str], rate_hz: float = RATE_HZ) -> list[Experiment]:
        """Cut experiments out of the log as `shipfp process` does; nothing of the truth but their times is used."""
        if rate_hz not in self.processed:
            self.processed[rate_hz] = self._process(rate_hz)
        return [self.processed[rate_hz][name] for name in names]

    def _process(self, rate_hz: float) -> dict[str, Experiment]:
        windows = tuple(_fitted(window) for window in self.recorded.windows)
        recorded = dataclasses.replace(self.recorded, windows=windows)
        trial = Trial.model_validate(trial_tables(VESSEL, self.log.name, Sensors(), recorded))
        processing = trial.processing.model_copy(update={"rate_hz": rate_hz})
        found = process(self.log, trial.model_copy(update={"processing": processing}), Vessel.load(VESSEL))
        return {experiment.name: dataclasses.replace(experiment, hold="first") for experiment in found}


def _fitted(window: TrueWindow) -> TrueWindow:
    """Return which part of an experiment is fitted: from the rest before it to its end or to `LAST_HZ`."""
    row = plan()[window.name]
    start, stop, length = row.frequency_hz, row.stop_frequency_hz, window.stop_s - window.start_s
    if start is not None and stop is not None and stop > LAST_HZ:
        length *= math.log(LAST_HZ / start) / math.log(stop / start)
    return TrueWindow(window.name, window.kind, window.start_s - LEAD_S, window.start_s + length)
