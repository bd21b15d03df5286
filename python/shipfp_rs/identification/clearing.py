"""Records less what the ship model at the rate of the record leaves out: what holding does, and what a limit does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.images import between_samples
from shipfp_rs.identification.limited import afloat, beyond_limit
from shipfp_rs.identification.sampling import held
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array


@dataclass(frozen=True)
class Clearing:
    """What is taken from the outputs of an experiment, by a fit close by.

    A governor that samples holds what it gives, and reads the speed at one moment: at a frequency f its answer differs
    by up to some (2 pi f T_s)^2 / 10. That is little and changes little with the parameters, so that of a fit close by
    serves. For the set point between its samples see `between_samples`, for a limit `beyond_limit`.
    """

    governor: bool
    """Whether the governor is known to sample."""
    limits: bool
    """Whether a torque limit is looked at, too."""
    band_limited: bool
    """Whether the set point between its samples is a band-limited signal; otherwise straight lines."""

    def of(
        self,
        structure: Structure,
        values: Mapping[str, float],
        raw: Experiment,
        told: Array,
    ) -> Experiment:
        """Return an experiment less all that.

        Parameters
        ----------
        structure, values
            The ship and its parameters, the experiment's own unknowns among them.
        raw
            As it was measured; its set point is what the model is given.
        told
            Deviation of the set point as it was sampled, shape (N,).
        """
        equations = structure.equations
        names = _names(structure, raw)
        measured = {output: raw.normalised(name) for output, name in names.items()}
        beyond = np.zeros((len(names), len(raw)))
        at_limit = self.limits and "M_max" in values
        if at_limit:
            beyond += beyond_limit(equations, values, raw, measured, told, band_limited=self.band_limited)
        if self.governor:
            beyond += held(equations, values, raw)
        if self.band_limited:
            rest = {
                output: one - change for (output, one), change in zip(measured.items(), beyond, strict=True)
            }
            beyond += between_samples(equations, values, raw, told, rest, has_images=not at_limit)
        require_small(beyond)
        signals = dict(raw.signals)
        for name, change in zip(names.values(), beyond, strict=True):
            signals[name] = signals[name] - raw.operating_point[name] * change
        return replace(raw, signals=signals)

    def afloat(
        self, structure: Structure, values: Mapping[str, float], raw: Experiment, told: Array
    ) -> tuple[Structure, Experiment]:
        """Return a structure that knows the water, and the experiment that tells it, see `limited.afloat`."""
        names = _names(structure, raw)
        measured = {output: raw.normalised(name) for output, name in names.items()}
        known, found = afloat(structure, values, raw, measured, told, band_limited=self.band_limited)
        require_small(np.stack(list(found.values())))
        signals, point = dict(raw.signals), {**raw.operating_point, "M_load": 1.0}
        for output, deviation in found.items():
            name = names.get(output, output)
            signals[name] = point[name] * (1.0 + deviation)
        return known, replace(raw, signals=signals, operating_point=point)


def require_small(deviations: Array) -> None:
    """Refuse what no record has: by parameters far from those of the ship a simulation may grow without end.

    Raises
    ------
    SimulationError
        Where a deviation is more than ten times the operating point.
    """
    if np.nanmax(np.abs(deviations), initial=0.0) > 10.0:
        raise SimulationError("what the model leaves out of a record has left the range of a drive train")


def _names(structure: Structure, raw: Experiment) -> dict[str, str]:
    """Each output's signal."""
    return {output: structure.signal_for(output, raw.signals, raw.name) for output in structure.outputs}
