"""The likelihood of a ship with limits of torque or rate: the closed form without limits, and the limits' effect.

The limits' effect is computed in one of two ways, chosen by the data. On the engine's side alone, a limit clamps a known
signal: the governor's command for the measured set point and speed. This way needs no simulation, allows for the torque
disturbance by moving water, and does not let an oscillating loop mislead the search; but noise of the speed blurs the
limit's corners. The other way is the difference of two simulations of the whole ship, with and without limits, driven by the
torque that the load's law does not explain. The effect at one point of the search is subtracted from the records, so that
what remains of the effect is small near that point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.equation_likelihood import LATE, STEP, EquationLikelihood
from shipfp_rs.identification.profiles import scaled_inverse
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.parameter import BRAKE
from shipfp_rs.structures.ship import BRAKE_SCALE
from shipfp_rs.structures.transfer import SLOWEST, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.derivatives import interpolated

LIMITS = ("M_max", "M_soft", "rate")
"""Parameters of limits."""
FINE_HZ = 100.0
"""Rate of the simulations [Hz]; linear interpolation between their samples affects only the limits' effect."""
WATERS_HZ = (2.0, 0.7, 0.0)
"""Tried upper frequencies [Hz] of the torque disturbance by moving water. Below such a frequency the torque that the load's
law does not explain is this disturbance; above, noise of the gauge, which does not act on the ship. Zero: no disturbance."""
SIDE_HZ, LEADS = 50.0, 1.0
"""Least rate of the engine side's computation [Hz]; rate at which the measured torque corrects the governor's integral
[1/s]."""
HOLDS = 1e-4
"""Torque removed by a clamp, relative to the operating torque, above which the clamp counts as active."""
SAMPLING_S, PHASES, FINER = (0.01, 0.03), 3, 4
"""Range of a governor's sample period [s], number of tested first instants, and simulation steps per period."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitedLikelihood(EquationLikelihood):
    """Likelihood of a ship with limits for given records.

    Parameters
    ----------
    beyond
        For each record, the torque that the load's law does not explain, decimated (K,); None: none.
    law
        Parameters of the load's law, delay and scale of the torque, by `load_side`; empty: those of the point of the search.
    water_hz
        Highest frequency [Hz] of `beyond` that simulations attribute to the torque disturbance by moving water; None: the
        limits' effect is computed on the engine's side alone.
    governor
        Stepper parameters that replace those of a point of the search.
    held
        For each record, the share of time in which a clamp is active, by the engine's side alone.
    """

    beyond: tuple[Array, ...] | None = None
    law: Mapping[str, float] = field(default_factory=dict)
    water_hz: float | None = None
    governor: Mapping[str, float] = field(default_factory=dict)
    held: tuple[float, ...] = ()

    @property
    def is_quick(self) -> bool:
        """Whether an evaluation is too short for threads to pay off; simulations are not."""
        return False

    @property
    def _fine_hz(self) -> float:
        return FINE_HZ * (FINER if self.governor else 1)

    def taken(self, vector: Array, record: int) -> ComplexArray:
        """Spectra (O, F) of the limits' effect on the outputs of a record, minus what was already put back."""
        data = self.records[record]
        if self.water_hz is None:
            found = self._taken_off_engine(vector, record)
        else:
            both = {**self._limits(vector), **self.governor}, self.governor
            with_limits, without = (self.simulated(vector, record, one) for one in both)
            found = data.see(data.low_passed(with_limits - without) - data.taken)
        if not np.isfinite(found).all():
            raise SimulationError("what the limits take off is not finite")
        found[:, 0] = 0.0  # means determine only the offsets
        return found + super().taken(vector, record)

    @property
    def takes(self) -> bool:
        """Whether limits act, which the closed form lacks."""
        return True

    def _clamped(self, vector: Array, record: int) -> tuple[Array, Array]:
        """Torque that clamps remove from the engine, and the rack's share of it, (N,) each, for measured signals."""
        data, values = self.records[record], self.values_of(vector, record)
        own = dict(zip(self.unknowns, vector[self.coordinates.states(record)], strict=True))
        beside = BRAKE in data.outputs
        scale = 1.0 + own.get(BRAKE_SCALE if beside else "torque scale", 0.0)
        ahead = values["tau_n"] - values.get("tau_prop", 0.0) if self.gauge and not beside else 0.0
        known = {
            "rate": np.inf,
            "rate_down": values.get("rate", np.inf),
            "M_max": np.inf,
            **values,
            "u_0": own.get("set point offset", 0.0),
            "s_M": scale,
        }
        known |= {"ahead": ahead, "leads": LEADS, "T_M": values.get("T_B" if beside else "T_M", 0.0)}
        parameters = np.array([known.get(name, 0.0) for name in _core.ENGINE_SIDE_PARAMETERS])
        every = 1.0 / (data.data_hz * self._side_finer(data))
        return _core.taken_by_limits(parameters, *self._side[record], every)

    def _taken_off_engine(self, vector: Array, record: int) -> ComplexArray:
        """Spectra of the limits' effect by the engine's side alone: the loop's response to the clamped torque."""
        data, values = self.records[record], self.values_of(vector, record)
        own = dict(zip(self.unknowns, vector[self.coordinates.states(record)], strict=True))
        finer = self._side_finer(data)
        torque, rack = (data.see(data.low_passed(one[::finer])) for one in self._clamped(vector, record))
        s = 1j * np.maximum(2.0 * np.pi * data.frequency_hz, SLOWEST)
        answer = TransferFunctions(data.outputs, self.gauge, self.place).answer_to_torque(loop_of(values), s)
        scales = {"dM": 1.0 + own.get("torque scale", 0.0), BRAKE: 1.0 + own.get(BRAKE_SCALE, 0.0)}
        for row, name in zip(answer, data.outputs, strict=True):
            row *= torque * scales.get(name, 1.0) * np.exp(-s * values.get(LATE.get(name, ""), 0.0))
            if name == "dX":
                row += rack / values.get("v", 1.0)
        return answer

    def _side_finer(self, record: Spectra) -> int:
        return max(1, round(SIDE_HZ / record.data_hz))

    @cached_property
    def _side(self) -> list[tuple[Array, Array, Array]]:
        """Set point, speed and the torque nearest to the engine of each record, interpolated to the rate of the clamps."""
        found: list[tuple[Array, Array, Array]] = []
        for data in self.records:
            named, finer = dict(zip(data.outputs, data.whole, strict=True)), self._side_finer(data)
            rows = data.set_point, named["dn"], named.get(BRAKE, named["dM"])
            set_point, speed, torque = (interpolated(np.ascontiguousarray(one), finer) for one in rows)
            found.append((set_point, speed, torque))
        return found

    def _models(self, vector: Array, record: int) -> tuple[Array | None, Array | None]:
        """Modelled outputs for a record with gaps, and the limits' effect where simulations compute it."""
        if self.water_hz is not None:
            return super()._models(vector, record)
        if not self.records[record].masked.any():
            return None, None
        return self._whole(vector, record, self._limits(vector)), None

    def _limits(self, vector: Array) -> Mapping[str, float]:
        values = self.coordinates.values(vector)
        return {name: values[name] for name in LIMITS if name in values}

    @property
    def is_corrected_by_model(self) -> bool:
        """Whether the model corrects the records; simulated effects of limits are put back."""
        return self.water_hz is not None or super().is_corrected_by_model

    def simulated(self, vector: Array, record: int, limits: Mapping[str, float]) -> Array:
        """Outputs of a record (O, N), simulated with limits and disturbance by moving water, at the data's rate."""
        beyond = None if self.beyond is None else self._water[record]
        return self._simulated(vector, record, limits, beyond)

    @cached_property
    def _water(self) -> list[Array]:
        """Torque that the load's law does not explain, at the rate of each record's simulation."""
        assert self.beyond is not None
        found = []
        for data, row, (set_point, _) in zip(self.records, self.beyond, self._driving, strict=True):
            fine = interpolated(row, len(set_point) // data.measured.shape[1] * data.down)[: len(set_point)]
            found.append(np.pad(fine, (0, len(set_point) - len(fine))))
        return found

    def near(self, vector: Array) -> Self:
        """Return the likelihood with the derivatives of simulated effects frozen at a point of the search."""
        return self if self.water_hz is None else replace(self, about=vector)

    def moved_by_sampling(self, vector: Array) -> Array:
        """Change of the minimum with the governor's sampling instants, (PHASES, P).

        Without limits, only the mean delay that the sampling causes affects a ship. With a limit, the instant at which a
        command leaves the limit matters. The change is zero where the loop with a sampling governor diverges, and on the
        engine's side, whose measured signals already contain the effect of the sampling instants.
        """
        if self.water_hz is None:
            return np.zeros((PHASES, self.coordinates.size))
        dead = self.values_of(vector, 0).get("T_d", 0.0)
        every = float(np.clip(2.0 * dead, *SAMPLING_S))
        clock = {"T_s": every, "T_d": max(dead - 0.5 * every, 0.0)}
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

    def driven(self, vector: Array) -> Self:
        """Return the likelihood with the torque disturbance that speed and torque show at a point of the search."""
        if "dM" not in self.records[0].outputs or not self.water_hz:
            return replace(self, beyond=None)
        values = {**self.coordinates.values(vector), **self.law}
        states = self.coordinates.states_at(vector)
        scales = [self.law.get("torque scale", 1.0 + one.get("torque scale", 0.0)) for one in states]
        found = [self._beyond(record, values, by) for record, by in zip(self.records, scales, strict=True)]
        return replace(self, beyond=tuple(found))

    def _beyond(self, record: Spectra, values: Mapping[str, float], scale: float) -> Array:
        """Load torque that the load's law does not explain (K,), faded in and out; `scale` is that of the torque gauge."""
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
        w = 2.0 * np.pi * (self.water_hz or 0.0)
        return record.through(
            (through - law) * record.tapers[0], lambda s: 1.0 / (1.0 + (s / w) ** 4), 1.0, 0.0
        )

    def resettled_at(self, vector: Array) -> Self:
        """Return the likelihood with torque disturbance, corrections and noise estimated at a point of the search."""
        return super(LimitedLikelihood, self.driven(vector)).resettled_at(vector)

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood with the noise of the residuals at a point of the search."""
        if self.water_hz is not None:
            return replace(super().with_noise(vector), about=vector)
        held = [
            np.mean(np.abs(self._clamped(vector, index)[0]) > HOLDS) for index in range(len(self.records))
        ]
        return replace(super().with_noise(vector), held=tuple(float(one) for one in held))

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, jacobian: Array | None = None
    ) -> Array:
        """Rows of the priors, and a row that corrects the noise's determinant for the time in which a clamp is active."""
        rows = super().prior_rows(vector, values, jacobian)
        if self.water_hz is not None or not any(self.held):
            return rows
        size, found = self._opened(vector), np.zeros((1, rows.shape[1]))
        found[0, 0] = -size
        for place in range(len(self.coordinates.names)):
            moved = vector.copy()
            moved[place] += STEP
            found[0, 1 + place] = (self._opened(moved) - size) / STEP
        return np.concatenate([rows, found])

    def _opened(self, vector: Array) -> float:
        """Root of the deviance that is added because the loop is open while a clamp is active.

        The inverse of the closed loop maps noise of the equations to noise of the outputs. While a clamp is active the loop
        is open, and the determinant of the noise is larger by the return difference.
        """
        found = 0.0
        for index, (record, share) in enumerate(zip(self.records, self.held, strict=True)):
            s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz[1:], SLOWEST)
            loop = TransferFunctions(record.outputs, self.gauge, self.place)
            turned = loop.return_difference(loop_of(self.values_of(vector, index)), s)
            found += 4.0 * share * float(np.sum(np.log(np.abs(turned))))
        return float(np.sqrt(max(found, 0.0)))
