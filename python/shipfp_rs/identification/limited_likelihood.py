"""The likelihood of a ship in a limit of torque or rate: the smooth ship's in closed form, and what limits take off.

What limits take off the outputs is the difference of two simulations, with limits and without. At one vector it is put back
into the records, so that what the closed form leaves is small everywhere near; the rest is a difference to that. Moving
water decides, too, when a limit holds: both simulations are driven by what the measured torque has beyond the load's law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Self

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.likelihood import Products
from shipfp_rs.identification.profiles import scaled_inverse
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.interpolation import interpolated
from shipfp_rs.support.threads import where_alone

LIMITS = ("M_max", "M_soft", "rate")
"""Parameters of limits."""
FINE_HZ = 100.0
"""Rate of the simulations: what lines between their samples lack counts for what limits take off alone."""
WATERS_HZ = (2.0, 0.7, 0.0)
"""Frequencies up to which what a torque has beyond the load's law may be water, the first one to begin with. Above them it
is the gauge's noise, which moves no ship; at zero there is no water."""
SAMPLING_S, PHASES, FINER = (0.01, 0.03), 3, 4
"""Ends of the interval at which a governor may sample, instants of the first sample, and steps that then make one."""
STEP = 1e-4
"""Step of a difference, of a vector's entries."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitedLikelihood(EquationLikelihood):
    """Of a ship with limits, given records.

    Parameters
    ----------
    beyond
        For each record what the measured torque has beyond the load's law, decimated (K,); None: nothing.
    law
        Parameters of the load's law, the torque's lateness and scale, by the load's side alone; none: by the vector.
    about
        Vector about which the derivatives of what limits take off are taken; None: each time anew.
    water_hz
        Frequency up to which what the torque has beyond the law is water.
    governor
        Parameters of the stepper in place of those of a vector.
    """

    beyond: tuple[Array, ...] | None = None
    law: Mapping[str, float] = field(default_factory=dict)
    about: Array | None = None
    water_hz: float = WATERS_HZ[0]
    governor: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_quick(self) -> bool:
        """Whether an evaluation is over before a thread of its own would be worth its while; simulations are not."""
        return False

    @property
    def _fine_hz(self) -> float:
        return FINE_HZ * (FINER if self.governor else 1)

    def taken(self, vector: Array, record: int) -> ComplexArray:
        """Spectra (O, F) of what limits take off the outputs of a record, beyond what was put back before."""
        data = self.records[record]
        both = {**self._limits(vector), **self.governor}, self.governor
        with_limits, without = (self.simulated(vector, record, one) for one in both)
        found = data.see(data.low_passed(with_limits - without) - data.taken)
        if not np.isfinite(found).all():
            raise SimulationError("what the limits take off is not finite")
        found[:, 0] = 0.0  # the means belong to the offsets alone
        return found

    def _limits(self, vector: Array) -> Mapping[str, float]:
        values = self.coordinates.values(vector)
        return {name: values[name] for name in LIMITS if name in values}

    @property
    def is_corrected_by_model(self) -> bool:
        """Whether the records follow from the model, too: what limits take off always does."""
        return True

    def simulated(self, vector: Array, record: int, limits: Mapping[str, float]) -> Array:
        """Outputs of a record by the stepper, driven by moving water, at the data's rate, (O, N), with limits."""
        beyond = None if self.beyond is None else self._water[record]
        return self._simulated(vector, record, limits, beyond)

    @cached_property
    def _water(self) -> list[Array]:
        """For each record what is beyond the load's law at the rate of its simulation."""
        assert self.beyond is not None
        found = []
        for data, row, (set_point, _) in zip(self.records, self.beyond, self._driving, strict=True):
            fine = interpolated(row, len(set_point) // data.measured.shape[1] * data.down)[: len(set_point)]
            found.append(np.pad(fine, (0, len(set_point) - len(fine))))
        return found

    def near(self, vector: Array) -> Self:
        """Return the likelihood with derivatives of what limits take off about a vector."""
        return replace(self, about=vector)

    def residual(self, vector: Array, record: int) -> ComplexArray:
        """Residuals (O, F) of a record."""
        return np.asarray(super().residual(vector, record) - self.taken(vector, record))

    def spectra(self, vector: Array, record: int) -> tuple[ComplexArray, ComplexArray]:
        """Residuals (O, F) of a record and the model's derivatives by the whole vector (P, O, F)."""
        residual, jacobian = super().spectra(vector, record)
        taken = self.taken(vector, record)
        moves = self._moves(vector, record, taken) if self.about is None else self._moves_about[record]
        return residual - taken, jacobian + moves

    def _moves(self, vector: Array, record: int, taken: ComplexArray) -> ComplexArray:
        """Derivatives of what limits take off a record, by differences, (P, O, F)."""
        states, (_, high) = self.coordinates.states(record), self.coordinates.bounds
        places = [*range(len(self.coordinates.names)), *range(states.start, states.stop)]

        def move(place: int) -> ComplexArray:
            step = STEP if vector[place] + STEP <= high[place] else -STEP
            moved = vector.copy()
            moved[place] += step
            return np.asarray((self.taken(moved, record) - taken) / step)

        found = np.zeros((self.coordinates.size, *taken.shape), complex)
        found[places] = where_alone([partial(move, place) for place in places])
        return found

    @cached_property
    def _moves_about(self) -> list[ComplexArray]:
        assert self.about is not None
        about = self.about
        return [self._moves(about, index, self.taken(about, index)) for index in range(len(self.records))]

    def moved_by_sampling(self, vector: Array) -> Array:
        """How far the end moves with the instants at which a governor samples, (PHASES, P).

        A smooth ship shows their mean alone. In a limit it counts when a command falls below it. Zero where the loop of a
        governor that samples runs away.
        """
        dead = self.values_of(vector, 0).get("T_d", 0.0)
        every = float(np.clip(2.0 * dead, *SAMPLING_S))
        clock = {"T_s": every, "T_d": max(dead - 0.5 * every, 0.0), "hold": 0.0}
        phases = [replace(self, governor={**clock, "T_0": every * place / PHASES}) for place in range(PHASES)]
        rows = []
        for index in range(len(self.records)):
            try:
                taken = np.array([one.taken(vector, index) for one in phases])
            except SimulationError:
                return np.zeros((PHASES, self.coordinates.size))
            rows.append(taken - taken.mean(axis=0))
        size = 1 + self.coordinates.size
        gram = self.with_columns(vector, rows)
        return np.asarray(gram[size:, 1:size] @ -scaled_inverse(gram[1:size, 1:size]))

    def products(self, vector: Array) -> Products:
        """Deviance, gradient and Gauss-Newton matrix at a vector.

        Raises
        ------
        SimulationError
            Where the loop is unstable.
        """
        none = [np.empty((0, len(one.outputs), len(one.frequency_hz)), complex) for one in self.records]
        gram = self.with_columns(vector, none)
        if not np.isfinite(gram).all():
            raise SimulationError("the deviance is not finite")
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:])

    def cost(self, vector: Array) -> float:
        """Deviance at a vector; infinite where the loop is unstable."""
        try:
            rows = [self.residual(vector, index)[None] for index in range(len(self.records))]
            return float(self._gram_of(vector, rows)[0, 0])
        except SimulationError:
            return np.inf

    def driven(self, vector: Array) -> Self:
        """Return the likelihood of the ship driven by what speed and torque show of moving water at a vector."""
        if "dM" not in self.records[0].outputs or not self.water_hz:
            return replace(self, beyond=None)
        values = {**self.coordinates.values(vector), **self.law}
        states = self.coordinates.states_at(vector)
        scales = [self.law.get("torque scale", 1.0 + one.get("torque scale", 0.0)) for one in states]
        found = [self._beyond(record, values, by) for record, by in zip(self.records, scales, strict=True)]
        return replace(self, beyond=tuple(found))

    def _beyond(self, record: Spectra, values: Mapping[str, float], scale: float) -> Array:
        """Torque of the load beyond its law (K,), faded in and out; `scale` is what the torque is read by."""
        speed, torque = (record.decimated[record.outputs.index(name)] for name in ("dn", "dM"))
        late, twist = values.get("T_M", 0.0), values.get("tau_twist", 0.0)
        through = (1.0 + record.through(torque, lambda s: np.exp(s * late), 1.0, late)) / scale - 1.0
        behind = values["tau_prop" if self.gauge or twist else "tau_n"]
        if twist:
            damped = twist * values.get("zeta_twist", 0.0)
            ahead = 0.0 if self.gauge else values["tau_n"] - behind
            through = through - ahead * record.through(speed, lambda s: s, 0.0, 1.0)
            speed = speed - record.through(through, lambda s: twist * s / (1.0 + damped * s), 0.0, twist)
        law = np.maximum(1.0 + speed, 1e-3) ** values["p"] - 1.0 + values.get("c_2", 0.0) * speed**2
        law += values.get("damping", 0.0) * speed + behind * record.through(speed, lambda s: s, 0.0, 1.0)
        if len(record.load):
            law += values.get("k_L", 1.0) * record.low_passed(record.load)
        w = 2.0 * np.pi * self.water_hz
        return record.through(
            (through - law) * record.tapers[0], lambda s: 1.0 / (1.0 + (s / w) ** 4), 1.0, 0.0
        )

    def resettled_at(self, vector: Array) -> Self:
        """Return the likelihood of the records corrected by the model at a vector, with water and noise seen there."""
        return super(LimitedLikelihood, self.driven(vector)).resettled_at(vector)

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood whose noise is that of the residuals at a vector."""
        return replace(super().with_noise(vector), about=vector)
