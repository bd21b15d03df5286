"""The model of a ship with limits of torque or rate: the closed form without limits, and the torque that limits remove.

A limit clamps a known signal: the governor's command, computed from the measured set point and speed. This needs no
simulation and allows for moving water, and an oscillating loop does not mislead the search. In calm water the difference
of two simulations is more exact, and is used near a minimum.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.noise import LEAST_REACH
from shipfp_rs.identification.ship_model import ShipModel
from shipfp_rs.identification.spectra import LATE, Spectra
from shipfp_rs.structures.parameter import BRAKE
from shipfp_rs.structures.ship import BRAKE_SCALE
from shipfp_rs.structures.transfer import SLOWEST
from shipfp_rs.support.arrays import Array, ComplexArray, Numbers
from shipfp_rs.support.derivatives import interpolated

LIMITS = ("M_max", "M_soft", "rate")
"""Parameters of limits."""
SIDE_HZ, LEADS = 50.0, 1.0
"""Least rate of the clamps' computation [Hz]; rate at which the measured torque corrects the governor's integral [1/s]."""
SMOOTHED = 0.1
"""Half width of the average that smooths residual spectra, as a share of the frequency."""
PEAK = 0.999
"""Quantile that counts as the peak of a torque or of its slope; noise has higher peaks."""
HOLDS = 1e-4
"""Torque removed by a clamp, relative to the operating torque, above which the clamp counts as active."""


class Governed(NamedTuple):
    """Speed that a governor measured (N,), share of its residual that is motion (F,), and share of the time in a clamp."""

    speed: Array
    wet: Array
    held: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitedShip(ShipModel):
    """The model of a record of a ship with limits."""

    simulates: bool = (
        False  # the effect is the difference of two simulations, with and without limits: exact in calm water
    )
    smooths: bool = False  # the governor's speed is without sensor noise, which is known only near a minimum
    governed: Governed | None = None  # None: the governor's speed is the measured one
    limited = True

    @property
    def has_effect(self) -> bool:
        """Return True: limits have no closed form."""
        return True

    def effect(self, values: Mapping[str, float], own: Array) -> ComplexArray:
        """Spectra (O, F) of the limits' effect on the outputs."""
        data, limits = self.record, self._limits(values)
        if self.simulates:
            limited, free = (self.simulated(values, own, acting) for acting in (limits, {}))
            answer = data.see(data.low_passed(limited - free))
        else:
            answer = self._clamped(values, own)
        if not np.isfinite(answer).all():
            raise SimulationError("the torque that the limits remove is not finite")
        answer[:, 0] = 0.0  # the mean determines only the offsets
        return answer + super().effect(values, own)

    def _clamped(self, values: Mapping[str, float], own: Array) -> ComplexArray:
        """Response (O, F) of the loop to the torque that the clamps remove."""
        data, states = self.record, dict(zip(self.unknowns, own, strict=True))
        removed, rack = self.removed(values, own)
        torque = self._seen(removed)
        s = 1j * np.maximum(2.0 * np.pi * data.frequency_hz, SLOWEST)
        answer = self.loop.answer_to_torque(loop_of(values), s)
        scales = {"dM": 1.0 + states.get("torque scale", 0.0), BRAKE: 1.0 + states.get(BRAKE_SCALE, 0.0)}
        for row, name in zip(answer, data.outputs, strict=True):
            row *= torque * scales.get(name, 1.0) * np.exp(-s * values.get(LATE.get(name, ""), 0.0))
            if name == "dX":
                row += self._seen(rack) / values.get("v", 1.0)
        return answer

    def removed(self, values: Mapping[str, float], own: Array) -> tuple[Array, Array]:
        """Torque that clamps remove from the engine, and the part removed at the rack, (N,) each, from measured signals."""
        states, beside = dict(zip(self.unknowns, own, strict=True)), BRAKE in self.record.outputs
        ahead = values["tau_n"] - values.get("tau_prop", 0.0) if self.gauge and not beside else 0.0
        known = {
            "rate": np.inf,
            "rate_down": values.get("rate", np.inf),
            "M_max": np.inf,
            **values,
            "u_0": states.get("set point offset", 0.0),
            "s_M": 1.0 + states.get(BRAKE_SCALE if beside else "torque scale", 0.0),
        }
        known |= {"ahead": ahead, "leads": LEADS, "T_M": values.get("T_B" if beside else "T_M", 0.0)}
        parameters = np.array([known.get(name, 0.0) for name in _core.ENGINE_SIDE_PARAMETERS])
        return _core.taken_by_limits(
            parameters, *self._side, 1.0 / (self.record.data_hz * _finer(self.record))
        )

    def _seen(self, row: Array) -> ComplexArray:
        return self.record.see(self.record.low_passed(row[:: _finer(self.record)]))

    @cached_property
    def _side(self) -> tuple[Array, Array, Array]:
        """Set point, speed and the torque nearest to the engine, interpolated to the rate of the clamps."""
        data = self.record
        named = dict(zip(data.outputs, data.whole, strict=True))
        speed = named["dn"] if self.governed is None else self.governed.speed
        rows = data.set_point, speed, named.get(BRAKE, named["dM"])
        set_point, speed, torque = (interpolated(np.ascontiguousarray(one), _finer(data)) for one in rows)
        return set_point, speed, torque

    def informed(
        self, left: Numbers, values: Mapping[str, float], own: Array, accuracy: Array, free: Container[str]
    ) -> Self:
        """Return the model with moving water and the governor's speed estimated from the residuals."""
        found = super().informed(left, values, own, accuracy, free)
        return found if self.simulates else replace(found, governed=found._governed(values, own))

    def _governed(self, values: Mapping[str, float], own: Array) -> Governed:
        """Return the modelled speed plus the residual that is coherent with torque: sensor noise is in one channel alone."""
        data, held = self.record, float(np.mean(np.abs(self.removed(values, own)[0]) > HOLDS))
        if not self.smooths:
            return Governed(data.whole[data.outputs.index("dn")], np.ones(len(data.frequency_hz)), held)
        model = self.modelled(self.rows(values, own, ())[0] - self.effect(values, own))
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
        alone, others, shared = sums[:, last] - sums[:, first]
        coherence = np.abs(shared) ** 2 / (alone * others).real.clip(1e-300)
        by_chance = 1.0 / (last - first)
        wet = np.clip((coherence - by_chance) / (1.0 - by_chance), 0.0, 1.0)
        seen = rows[0][1] + np.fft.irfft(speed * wet, len(rows[0][1]))
        wet = np.interp(data.frequency_hz, at * (data.data_hz / len(seen)), wet)
        return Governed(seen, wet, held)

    def _limits(self, values: Mapping[str, float]) -> Mapping[str, float]:
        return {name: values[name] for name in LIMITS if name in values}

    @property
    def held(self) -> float:
        """Share of the time in which a clamp is active."""
        return 0.0 if self.governed is None else self.governed.held

    def opened(self, values: Mapping[str, float]) -> float:
        """Deviance that is added because the loop is open while a clamp is active."""
        # The inverse of the closed loop maps noise of the equations to noise of the outputs. While a clamp is active the
        # loop is open, and the determinant of the ship's disturbances is larger by the return difference.
        if self.governed is None:
            return 0.0
        s = 1j * np.maximum(2.0 * np.pi * self.record.frequency_hz[1:], SLOWEST)
        back = self.loop.open_loop(loop_of(values), s)
        return 4.0 * self.governed.held * float(np.sum(np.log(np.abs(1.0 + back * self.governed.wet[1:]))))


def ways_of(likelihood: Likelihood) -> list[Likelihood]:
    """Return the likelihood with each method for a limit's effect: clamps, clamps without sensor noise, simulations."""
    # Clamps on noisy signals find the limit; in calm water simulations are more exact.
    return [
        likelihood,
        likelihood.with_models(smooths=True),
        likelihood.with_models(simulates=True, governed=None),
    ]


def removed_share(likelihood: Likelihood, vector: Array) -> float:
    """Return the standard deviation of the torque that clamps remove over that of the measured torque, in all records."""
    torque = np.concatenate([model._side[2] for model, _, _ in _limited(likelihood, vector)])
    return float(np.std(_removed(likelihood, vector)) / np.std(torque))


def limit_figures(likelihood: Likelihood, vector: Array) -> dict[str, float]:
    """Return "removed", "share" and "amplitude" of `Fingerprint.adequate["limit"]`, over all records."""
    points = _limited(likelihood, vector)
    place, limits = points[0][0].record.outputs.index("dM"), points[0][0]._limits(points[0][1])
    try:
        limited, free = (
            max(_peak(model.simulated(values, own, acting)[place], limits) for model, values, own in points)
            for acting in (limits, {})
        )
    except SimulationError:
        limited, free = 0.0, 1.0
    return {
        "removed": removed_share(likelihood, vector),
        "share": float(np.mean(np.abs(_removed(likelihood, vector)) > HOLDS)),
        "amplitude": min(limited / max(free, 1e-12), 1.0),
    }


def _limited(likelihood: Likelihood, vector: Array) -> list[tuple[LimitedShip, dict[str, float], Array]]:
    return [
        (model, values, own)
        for model, values, own in likelihood.points(vector)
        if isinstance(model, LimitedShip)
    ]


def _removed(likelihood: Likelihood, vector: Array) -> Array:
    """Torque that clamps remove, of all records concatenated."""
    return np.concatenate(
        [model.removed(values, own)[0] for model, values, own in _limited(likelihood, vector)]
    )


def _peak(torque: Array, limits: Mapping[str, float]) -> float:
    """Peak of a torque, or of its slope where the rate is limited."""
    return float(np.quantile(np.abs(np.diff(torque)) if "rate" in limits else torque, PEAK))


def _finer(record: Spectra) -> int:
    return max(1, round(SIDE_HZ / record.data_hz))
