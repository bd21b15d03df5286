"""The nonlinear plant as a structure: the ship's own limits and curvature stay in the model that is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.experiment import Experiment
from shipfp_rs.vessel import Vessel

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_INDEX = {name: index for index, name in enumerate(_core.PLANT_PARAMETERS)}
STEP = 1e-5
"""Relative step of the central differences: truncation and rounding are then both near 1e-10."""
STEP_OF_FASTEST = 0.05
"""Longest step as part of the plant's shortest time constant; RK4 then errs below 1e-8."""


@dataclass(frozen=True)
class PlantEquations:
    """Plant of eq. 3.1 to 3.11 with the torque envelope of a vessel, in the linear structure's parameters.

    tau_n, g, v (or the products vK_p, vK_i), K_p, K_i, p and tau_prop mean what they mean at the vessel's operating
    point; `limit` multiplies the envelope. All derivatives come from one batch of runs.
    """

    vessel: Vessel
    outputs: tuple[str, ...]
    gauge: bool
    states: tuple[str, ...] = ("initial dn", "initial dE")

    def simulate(self, values: Mapping[str, float], experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self._runs([values], experiment)[0]

    def sensitivities(
        self, values: Mapping[str, float], experiment: Experiment, names: Sequence[str]
    ) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        steps = [STEP * (abs(values.get(name, 0.0)) or 1.0) for name in names]
        members = [values]
        for name, step in zip(names, steps, strict=True):
            members += [{**values, name: values.get(name, 0.0) + way * step} for way in (1.0, -1.0)]
        runs = self._runs(members, experiment)
        slopes = [(runs[1 + 2 * i] - runs[2 + 2 * i]) / (2.0 * step) for i, step in enumerate(steps)]
        return runs[0], np.array(slopes).reshape(len(names), *runs[0].shape)

    def response(
        self, values: Mapping[str, float], frequency_hz: Array, names: Sequence[str]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Raise: a nonlinear plant has no frequency response."""
        raise InputError(
            "the plant structure has no frequency response; fit it to an Experiment, or use Structure.linear"
        )

    def _parameters(self, values: Mapping[str, float]) -> Array:
        vessel, parameters = self.vessel, self.vessel.plant_parameters()
        torque, speed = vessel.nominal_brake_torque, vessel.nominal_engine_speed
        shaft_torque = torque * vessel.gearbox.ratio * vessel.gearbox.efficiency
        rack = vessel.operating_point.X_0_mm
        v = values.get("v", vessel.operating_point.v)
        gains = [values[f"vK_{k}"] / v if f"vK_{k}" in values else values[f"K_{k}"] for k in ("p", "i")]
        p = values["p"]
        parameters[_INDEX["inertia"]] = (
            values["tau_n"] * shaft_torque / (2.0 * np.pi * vessel.nominal_shaft_speed)
        )
        parameters[_INDEX["A1"]] = v * torque / rack
        parameters[_INDEX["A2"]] = values["g"] * torque / speed
        parameters[_INDEX["A3"]] = (1.0 - v - values["g"]) * torque
        parameters[_INDEX["torque_exponent"]] = p
        parameters[_INDEX["torque_coefficient"]] = shaft_torque / vessel.nominal_shaft_speed**p
        parameters[_INDEX["Kp_abs"]] = gains[0] * rack / speed
        parameters[_INDEX["Ki_abs"]] = gains[1] * rack / speed
        return parameters

    def _runs(self, members: Sequence[Mapping[str, float]], experiment: Experiment) -> list[Array]:
        vessel, dt = self.vessel, 1.0 / experiment.rate_hz
        speed, limit = vessel.envelope()
        initial = np.array(
            [
                [
                    vessel.nominal_shaft_speed * (1.0 + values.get("initial dn", 0.0)),
                    vessel.nominal_engine_speed * values.get("initial dE", 0.0),
                ]
                for values in members
            ]
        )
        # One envelope serves a batch, so members with another limit run in a batch of their own.
        limits = np.array([values.get("limit", 1.0) for values in members])
        trajectories = np.empty((len(members), 4, len(experiment)))
        for factor in np.unique(limits):
            chosen = limits == factor
            trajectories[chosen] = _core.simulate_plant_batch(
                np.array([self._parameters(v) for v, take in zip(members, chosen, strict=True) if take]),
                speed,
                limit * factor,
                experiment.signals["n_set"][None, :] / 60.0,
                dt,
                self._substeps(dt),
                "rk4",
                experiment.hold,
                initial[chosen],
                0,
            )
        return [self._normalised(v, run, experiment) for v, run in zip(members, trajectories, strict=True)]

    def _substeps(self, dt: float) -> int:
        point, governor = self.vessel.operating_point, self.vessel.governor
        torque = self.vessel.nominal_brake_torque * self.vessel.gearbox.ratio * self.vessel.gearbox.efficiency
        tau_n = 2.0 * np.pi * self.vessel.inertia * self.vessel.nominal_shaft_speed / torque
        rate = (self.vessel.propeller.torque_exponent - point.g + point.v * governor.K_p) / tau_n
        return max(1, int(np.ceil(dt * rate / STEP_OF_FASTEST)))

    def _normalised(self, values: Mapping[str, float], run: Array, experiment: Experiment) -> Array:
        vessel, point = self.vessel, experiment.operating_point
        n_s, E_n, X_f, M_b = run
        shaft = vessel.gearbox.ratio * vessel.gearbox.efficiency
        rows = []
        for output in self.outputs:
            if output == "dn":
                rows.append(n_s / (point.get("n_e", point["n_set"]) / 60.0 / vessel.gearbox.ratio) - 1.0)
            elif output == "dE":
                rows.append(E_n / vessel.nominal_engine_speed)
            elif output == "dX":
                rows.append(X_f / point.get("X_f", vessel.operating_point.X_0_mm) - 1.0)
            elif self.gauge:
                propeller_torque = (
                    vessel.nominal_brake_torque * shaft * (n_s / vessel.nominal_shaft_speed) ** values["p"]
                )
                part = values["tau_prop"] / values["tau_n"]
                gauge_torque = propeller_torque + part * (M_b * shaft - propeller_torque)
                rows.append(gauge_torque / point.get("M_g", vessel.nominal_brake_torque * shaft) - 1.0)
            else:
                rows.append(M_b / self._brake_torque_at(point) - 1.0)
        return np.array(rows)

    def _brake_torque_at(self, point: Mapping[str, float]) -> float:
        shaft = self.vessel.gearbox.ratio * self.vessel.gearbox.efficiency
        if "M_b" in point:
            return point["M_b"]
        return point["M_s"] / shaft if "M_s" in point else self.vessel.nominal_brake_torque
