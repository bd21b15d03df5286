"""The likelihood of a ship with limits of torque or rate: the closed form without limits, and the torque that they remove.

A limit clamps a known signal: the governor's command for the measured set point and speed. This needs no simulation and
allows for moving water, and an oscillating loop does not mislead the search. In calm water the difference of two
simulations is more exact, and is used near a minimum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.equation_likelihood import STEP, EquationLikelihood
from shipfp_rs.identification.likelihood import LEAST_REACH
from shipfp_rs.identification.spectra import LATE, Spectra
from shipfp_rs.structures.parameter import BRAKE
from shipfp_rs.structures.ship import BRAKE_SCALE
from shipfp_rs.structures.transfer import SLOWEST, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.derivatives import interpolated

LIMITS = ("M_max", "M_soft", "rate")
"""Parameters of limits."""
SIDE_HZ, LEADS = 50.0, 1.0
"""Least rate of the clamps' computation [Hz]; rate at which the measured torque corrects the governor's integral [1/s]."""
SMOOTHED = 0.1
"""Half width of the average that smooths residual spectra, as a share of the frequency."""
PEAK = 0.999
"""Quantile that counts as the peak of a torque or of its slope; noise has higher ones."""
HOLDS = 1e-4
"""Torque removed by a clamp, relative to the operating torque, above which the clamp counts as active."""


class Governed(NamedTuple):
    """The speed that a governor saw (N,), the share of its noise that moved the ship (F,), and of the time in a clamp."""

    speed: Array
    wet: Array
    held: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitedLikelihood(EquationLikelihood):
    """Likelihood of a ship with limits for given records.

    Parameters
    ----------
    simulates
        Whether the effect is the difference of two simulations, with and without limits: exact in calm water.
    smooths
        Whether the governor's speed is without the sensor's noise, which is known only near a minimum.
    governed
        For each record, the speed that the governor saw; empty: as measured.
    """

    simulates: bool = False
    smooths: bool = False
    governed: tuple[Governed, ...] = ()

    @property
    def takes(self) -> bool:
        """Whether limits act, which the closed form lacks."""
        return True

    @property
    def is_quick(self) -> bool:
        """Whether an evaluation is too short for threads to pay off; the clamps' is not."""
        return False

    def taken(self, vector: Array, record: int) -> ComplexArray:
        """Spectra (O, F) of the limits' effect on the outputs of a record."""
        answer = self._simulated_effect(vector, record) if self.simulates else self._clamped(vector, record)
        if not np.isfinite(answer).all():
            raise SimulationError("what the limits take off is not finite")
        answer[:, 0] = 0.0  # means determine only the offsets
        return answer + super().taken(vector, record)

    def _simulated_effect(self, vector: Array, record: int) -> ComplexArray:
        """Difference of the spectra (O, F) of two simulations, with and without the limits."""
        data = self.records[record]
        limited, free = (self.simulated(vector, record, acting) for acting in (self._limits(vector), {}))
        return data.see(data.low_passed(limited - free))

    def _clamped(self, vector: Array, record: int) -> ComplexArray:
        """Response (O, F) of the loop to the torque that the clamps remove."""
        data, values = self.records[record], self.values_of(vector, record)
        own = dict(zip(self.unknowns, vector[self.coordinates.states(record)], strict=True))
        removed, rack = self.removed(vector, record)
        torque = self._seen(data, removed)
        s = 1j * np.maximum(2.0 * np.pi * data.frequency_hz, SLOWEST)
        answer = TransferFunctions(data.outputs, self.gauge, self.place).answer_to_torque(loop_of(values), s)
        scales = {"dM": 1.0 + own.get("torque scale", 0.0), BRAKE: 1.0 + own.get(BRAKE_SCALE, 0.0)}
        for row, name in zip(answer, data.outputs, strict=True):
            row *= torque * scales.get(name, 1.0) * np.exp(-s * values.get(LATE.get(name, ""), 0.0))
            if name == "dX":
                row += self._seen(data, rack) / values.get("v", 1.0)
        return answer

    def removed(self, vector: Array, record: int) -> tuple[Array, Array]:
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
        every = 1.0 / (data.data_hz * _finer(data))
        return _core.taken_by_limits(parameters, *self._side[record], every)

    @staticmethod
    def _seen(data: Spectra, row: Array) -> ComplexArray:
        return data.see(data.low_passed(row[:: _finer(data)]))

    @cached_property
    def _side(self) -> list[tuple[Array, Array, Array]]:
        """Set point, speed and the torque nearest to the engine of each record, interpolated to the rate of the clamps."""
        found: list[tuple[Array, Array, Array]] = []
        for index, data in enumerate(self.records):
            named = dict(zip(data.outputs, data.whole, strict=True))
            speed = self.governed[index].speed if self.governed else named["dn"]
            rows = data.set_point, speed, named.get(BRAKE, named["dM"])
            set_point, speed, torque = (interpolated(np.ascontiguousarray(one), _finer(data)) for one in rows)
            found.append((set_point, speed, torque))
        return found

    def removed_share(self, vector: Array) -> float:
        """Standard deviation of the torque that clamps remove over that of the measured torque, in all records."""
        torque = np.concatenate([side[2] for side in self._side])
        return float(np.std(self._removed(vector)) / np.std(torque))

    def _removed(self, vector: Array) -> Array:
        """Torque that clamps remove in all records, one after the other."""
        return np.concatenate([self.removed(vector, at)[0] for at in range(len(self.records))])

    def effect(self, vector: Array) -> dict[str, float]:
        """Figures of what the clamps remove, over all records.

        "removed" is its standard deviation over that of the torque, "share" that of the time in a clamp, and "amplitude" the
        share of the excitation from which on no clamp acts.
        """
        limits, place = self._limits(vector), self.records[0].outputs.index("dM")
        try:
            limited, free = (
                max(
                    _peak(self.simulated(vector, at, acting)[place], limits)
                    for at in range(len(self.records))
                )
                for acting in (limits, {})
            )
        except SimulationError:
            limited, free = 0.0, 1.0
        return {
            "removed": self.removed_share(vector),
            "share": float(np.mean(np.abs(self._removed(vector)) > HOLDS)),
            "amplitude": min(limited / max(free, 1e-12), 1.0),
        }

    def near(self, vector: Array) -> Self:
        """Return the likelihood with the derivatives of the limits' effect frozen at a point of the search."""
        return replace(self, about=vector)

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood with the noise of the residuals, and the governor's speed, at a point of the search."""
        found = super().with_noise(vector)
        if self.simulates:
            return found
        return replace(found, governed=tuple(found._governed(vector, at) for at in range(len(self.records))))

    def _governed(self, vector: Array, record: int) -> Governed:
        """The model's speed, and of the residual what torque and speed share: sensors' noise is in one of them alone."""
        data, held = self.records[record], float(np.mean(np.abs(self.removed(vector, record)[0]) > HOLDS))
        if not self.smooths:
            return Governed(data.whole[data.outputs.index("dn")], np.ones(len(data.frequency_hz)), held)
        model = self.modelled(vector, record)
        torque = data.outputs.index(BRAKE if BRAKE in data.outputs else "dM")
        rows = [
            (data.whole[place], data.at_data_rate(model[place]))
            for place in (data.outputs.index("dn"), torque)
        ]
        speed, other = (np.fft.rfft(measured - modelled) for measured, modelled in rows)
        at = np.arange(len(speed))
        reach = np.maximum((SMOOTHED * at).astype(int), LEAST_REACH)
        first, last = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(at))
        both = np.array([np.abs(speed) ** 2, np.abs(other) ** 2, speed * other.conj()])
        sums = np.concatenate([np.zeros((3, 1)), np.cumsum(both, axis=1)], axis=1)
        own, others, shared = sums[:, last] - sums[:, first]
        coherence = np.abs(shared) ** 2 / (own * others).real.clip(1e-300)
        by_chance = 1.0 / (last - first)
        wet = np.clip((coherence - by_chance) / (1.0 - by_chance), 0.0, 1.0)
        seen = rows[0][1] + np.fft.irfft(speed * wet, len(rows[0][1]))
        wet = np.interp(data.frequency_hz, at * (data.data_hz / len(seen)), wet)
        return Governed(seen, wet, held)

    def _limits(self, vector: Array) -> Mapping[str, float]:
        values = self.coordinates.values(vector)
        return {name: values[name] for name in LIMITS if name in values}

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, jacobian: Array | None = None
    ) -> Array:
        """Rows of the priors, and a row that corrects the determinant of the noise for the time in which a clamp acts."""
        rows = super().prior_rows(vector, values, jacobian)
        if not any(one.held for one in self.governed):
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
        is open, and the determinant of the ship's disturbances is larger by the return difference.
        """
        found = 0.0
        for index, (record, one) in enumerate(zip(self.records, self.governed, strict=True)):
            s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz[1:], SLOWEST)
            loop = TransferFunctions(record.outputs, self.gauge, self.place)
            back = loop.open_loop(loop_of(self.values_of(vector, index)), s)
            found += 4.0 * one.held * float(np.sum(np.log(np.abs(1.0 + back * one.wet[1:]))))
        return float(np.sqrt(max(found, 0.0)))


def _peak(torque: Array, limits: Mapping[str, float]) -> float:
    """Peak of a torque, or of its slope where the rate is limited."""
    return float(np.quantile(np.abs(np.diff(torque)) if "rate" in limits else torque, PEAK))


def _finer(record: Spectra) -> int:
    return max(1, round(SIDE_HZ / record.data_hz))
