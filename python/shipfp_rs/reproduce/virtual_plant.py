"""The nonlinear plant of a vessel as a structure, in the linear structure's parameters (eq. 3.1 to 3.11)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.experiments.experiment import Experiment, Hold
from shipfp_rs.structures.equations import Against, Equations, Sums
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, Names, Values
from shipfp_rs.vessel.drive_train import OFF, DriveTrain, drive_train
from shipfp_rs.vessel.vessel import Vessel

"""By name; one of them may be complex, to differentiate by it."""
COMPLEX_STEP = 1e-30
"""The square of it vanishes beside 1, so derivatives of the parameters are exact to rounding."""
STEP_OF_FASTEST = 0.1
"""Longest step as part of the plant's shortest time constant; RK4 then has it to 1e-6 of itself."""


def plant_structure(vessel: Vessel) -> Structure:
    """Return the plant with the parameters of the linear structure, products of gains and exponent 2."""
    linear = Structure.linear(products=True)
    return Structure(
        name="plant",
        parameters=(*linear.parameters, Parameter("limit", "-", 1.0, 0.5, 2.0, fixed=True)),
        signals=linear.signals,
        equations=PlantEquations(vessel, linear.outputs, gauge=False),
        settings={"kind": "plant"},
    )


def about_operating_point(vessel: Vessel, values: Values) -> Mapping[str, Any]:
    """Place the linear structure's parameters: tau_n, g, v, K_p, K_i (or vK_p, vK_i), p, tau_prop, T_set.

    They mean what they mean at the vessel's operating point, which stays the plant's.
    """
    torque, speed, rack = vessel.nominal_brake_torque, vessel.nominal_engine_speed, _rack(vessel)
    shaft_torque = torque * vessel.gearbox.ratio * vessel.gearbox.efficiency
    per_time_constant = shaft_torque / (2.0 * np.pi * vessel.nominal_shaft_speed)
    v, g, p = values.get("v", vessel.operating_point.v), values["g"], values["p"]
    gains = [values[f"vK_{k}"] / v if f"vK_{k}" in values else values[f"K_{k}"] for k in ("p", "i")]
    return {
        "inertia": values["tau_n"] * per_time_constant,
        "propeller_inertia": values.get("tau_prop", 0.0) * per_time_constant,
        "A1": v * torque / rack,
        "A2": g * torque / speed,
        "A3": (1.0 - v - g) * torque,
        "torque_exponent": p,
        "torque_coefficient": shaft_torque / vessel.nominal_shaft_speed**p,
        "Kp_abs": gains[0] * rack / speed,
        "Ki_abs": gains[1] * rack / speed,
        "limit_factor": values["limit"],
        "set_dead_time": values.get("T_set", vessel.governor.set_point_dead_time_s),
    }


def _rack(vessel: Vessel) -> float:
    return vessel.operating_point.X_0_mm


_Run = tuple[Array, Array, Array, Array, Array, Array, float, int, Hold, list[int], Array]

OF_THE_PLANT = ("set_dead_time", "rack_rate", "torque_rate")
"""Elements that the plant in the linear structure's terms has, too."""


@dataclass(frozen=True)
class PlantEquations(Equations):
    """Plant of eq. 3.1 to 3.11 with a vessel's torque envelope, rate limits and dead time of the set point.

    All that is no parameter is the vessel's; the elements that a linear structure has no terms for are off. The
    derivatives are those of the integration itself, carried along through its steps; at a limit they are those of the
    side it is on.
    """

    vessel: Vessel
    outputs: tuple[str, ...]
    gauge: bool
    states: tuple[str, ...] = ("initial dn", "initial dE")

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        scale, shift = self._normal(experiment)
        rows, slopes = _core.drive_train_sensitivities(*self._run(values, experiment, names))
        return rows * scale[:, None] + shift[:, None], slopes * scale[:, None]

    @property
    def has_products(self) -> bool:
        """One pass of the Rust kernel."""
        return True

    def products(self, values: Values, experiment: Experiment, names: Names, against: Against) -> Sums:
        """Return sums of products of residuals and sensitivities and the number of samples; see `Equations`."""
        scale, shift = self._normal(experiment)
        run = self._run(values, experiment, names)
        return _core.drive_train_products(
            *run, scale, against.measured, against.offsets + shift, against.filters
        )

    def _train(self) -> DriveTrain:
        train = drive_train(self.vessel)
        off = {name: value for name, value in OFF.items() if name not in OF_THE_PLANT}
        return DriveTrain({**train.values, **off}, train.strength, np.empty((3, 0)))

    def _parameters(self, train: DriveTrain, values: Mapping[str, Any], before: float) -> npt.NDArray[Any]:
        vessel = self.vessel
        known: Mapping[str, Any] = {
            **train.values,
            "initial_ship_speed": 0.0,
            "crank_angle": 0.0,
            "set_point_before": before,
            "initial_speed": vessel.nominal_shaft_speed * (1.0 + values.get("initial dn", 0.0)),
            "initial_error": vessel.nominal_engine_speed * values.get("initial dE", 0.0),
            **about_operating_point(vessel, values),
        }
        return np.array([known[name] for name in _core.DRIVE_TRAIN_PARAMETERS])

    def _run(self, values: Values, experiment: Experiment, names: Names) -> _Run:
        """Return what both kernels ask for."""
        dt, train = 1.0 / experiment.rate_hz, self._train()
        set_point = experiment.signals["n_set"] / 60.0
        before = float(set_point[0])
        directions = np.zeros((len(names), len(_core.DRIVE_TRAIN_PARAMETERS)))
        for row, name in zip(directions, names, strict=True):
            shifted = {**values, name: values.get(name, 0.0) + 1j * COMPLEX_STEP}
            moved = self._parameters(train, shifted, before)
            row[:] = moved.imag / COMPLEX_STEP
        torque = "M_g" if self.gauge else "M_b"
        outputs = [{"dn": "n_e", "dM": torque, "dE": "E_n", "dX": "X_f"}[output] for output in self.outputs]
        return (
            self._parameters(train, values, before).astype(np.float64),
            *self.vessel.envelope(),
            train.strength,
            train.quadrants,
            set_point,
            dt,
            self._substeps(dt, train),
            experiment.hold,
            [_core.GREY_BOX_OUTPUTS.index(output) for output in outputs],
            directions,
        )

    def _substeps(self, dt: float, train: DriveTrain) -> int:
        vessel, point = self.vessel, self.vessel.operating_point
        torque = vessel.nominal_brake_torque * vessel.gearbox.ratio * vessel.gearbox.efficiency
        tau_n = 2.0 * np.pi * vessel.inertia * vessel.nominal_shaft_speed / torque
        rate = (vessel.propeller.torque_exponent - point.g + point.v * vessel.governor.K_p) / tau_n
        longest = min(STEP_OF_FASTEST / rate, train.step_s(vessel.nominal_shaft_speed))
        return max(1, int(np.ceil(dt / longest)))

    def _normal(self, experiment: Experiment) -> tuple[Array, Array]:
        """Return factor and shift (O,) that turn the kernel's outputs into normalised ones."""
        vessel, point = self.vessel, experiment.operating_point
        shaft_torque = vessel.nominal_brake_torque * vessel.gearbox.ratio * vessel.gearbox.efficiency
        base = {
            "dn": point.get("n_e", point["n_set"]) / 60.0,
            "dM": point.get("M_g", shaft_torque) if self.gauge else self._brake_torque_at(point),
            "dE": vessel.nominal_engine_speed,
            "dX": point.get("X_f", _rack(vessel)),
        }
        scale = np.array([1.0 / base[output] for output in self.outputs])
        return scale, np.array([0.0 if output == "dE" else -1.0 for output in self.outputs])

    def _brake_torque_at(self, point: Mapping[str, float]) -> float:
        shaft = self.vessel.gearbox.ratio * self.vessel.gearbox.efficiency
        if "M_b" in point:
            return point["M_b"]
        return point["M_s"] / shaft if "M_s" in point else self.vessel.nominal_brake_torque
