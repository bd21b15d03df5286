"""Equations of the ship model, the nonlinear normalised drive train computed by the Rust kernel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment, Hold
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.linear import LinearEquations
from shipfp_rs.structures.outputs import BRAKE
from shipfp_rs.structures.transfer import Place, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

SET_SCALE, TORQUE_SCALE, BRAKE_SCALE = "set point scale", "torque scale", "brake torque scale"
STATES = ("initial dn", "initial fuel", SET_SCALE, TORQUE_SCALE)
"""Unknowns of each experiment: initial deviations of speed and fuel torque from the operating point, and relative errors of
the set-point and torque readings, which include errors of the operating point."""

INDEX = {name: index for index, name in enumerate(_core.SHIP_PARAMETERS)}
"""Indices of the kernel's parameters."""
KERNEL = {
    "vK_p": "K_p",
    "vK_i": "K_i",
    "vK_d": "K_d",
    "rate": "rate_up",
    "k_L": "load_gain",
    "c_2": "curvature",
}
"""Parameters whose kernel names differ."""
_KERNEL = KERNEL | {
    "initial dn": "initial_N",
    "initial fuel": "initial_F",
    SET_SCALE: "s_u",
    TORQUE_SCALE: "s_M",
}
"""The same with the unknowns of an experiment."""
_DEVIATIONS = ("initial dn", SET_SCALE, TORQUE_SCALE)
"""Unknowns that are zero without effect; the kernel's are one."""


STEP = 1e-6
"""Relative step of a difference quotient."""
OF_BOTH_SIGNS = {*STATES, BRAKE_SCALE, "g", "p", "damping", "c_2"}
"""Parameters that may be negative."""


def with_brake(
    step: Callable[[Array], Array], parameters: Array, outputs: Sequence[str], late_s: float, scale: float
) -> Array:
    """Return the simulated outputs; the kernel's single torque channel is computed for gauge and brake in turn."""
    rows = step(parameters)
    if BRAKE in outputs:
        other = parameters.copy()
        other[[INDEX["T_M"], INDEX["s_M"]]] = late_s, scale
        place = list(outputs).index(BRAKE)
        rows[place] = step(other)[place]
    return rows


@dataclass(frozen=True)
class ShipEquations(Equations):
    """The ship of `Structure.ship`; a frequency response is that of its linearisation."""

    outputs: tuple[str, ...]
    gauge: bool
    propeller_speed: bool = False
    loaded: bool = False
    """Whether the experiment's load torque drives the model, too."""
    mean_sampling: bool = False
    """Whether a sampling governor is modelled by its mean delay, half a sample period."""
    envelope: tuple[tuple[float, float], ...] = ()
    """Highest torque at each speed, both over the operating point's; empty: no limit but M_max."""
    substeps: int = 0
    """Steps per sample; 0: chosen by the kernel."""
    states: tuple[str, ...] = STATES
    linear_in: tuple[str, ...] = ()
    own_offsets: bool = True
    """The states include errors of the operating point, so that `identify` adds no offsets."""

    @property
    def _kernel_outputs(self) -> list[int]:
        names = {
            "dn": "dn_prop" if self.propeller_speed else "dn",
            "dM": "dM_g" if self.gauge else "dM_b",
        }
        return [_core.SHIP_OUTPUTS.index(names.get(output, output)) for output in self.outputs]

    def vector(self, values: Values) -> Array:
        """Return the kernel's parameters, shape (34,), for values by name; elements without a value are off."""
        vector = np.array(_core.SHIP_OFF)
        vector[INDEX["v"]] = 1.0
        for name, value in values.items():
            if name in STATES or name in INDEX or name in _KERNEL:
                vector[INDEX[_KERNEL.get(name, name)]] = value + (name in _DEVIATIONS)
        if self.mean_sampling:
            vector[INDEX["T_d"]] += 0.5 * vector[INDEX["T_s"]]
            vector[INDEX["T_s"]] = 0.0
        if values.get("tau_twist") and values["tau_prop"] >= 0.99 * values["tau_n"]:
            raise SimulationError("nothing is left of the inertia on the engine's side of the twisting shaft")
        if "rate" in values:
            vector[INDEX["rate_down"]] = values.get("rate_down", values["rate"])
        return vector

    def _inputs(self, experiment: Experiment) -> tuple[Array, Array, float, int, Hold]:
        load = experiment.normalised("M_load") if self.loaded else np.empty(0)
        return 1.0 + experiment.dn_set, load, 1.0 / experiment.rate_hz, self.substeps, experiment.hold

    @property
    def _limit(self) -> Array | None:
        return np.ascontiguousarray(np.array(self.envelope).T) if self.envelope else None

    def stable(self, values: Values) -> bool:
        """Whether the loop is stable about the operating point, without lag and sampling."""
        known = {
            name: values[name]
            for name in ("tau_n", "g", "v", "K_p", "K_i", "vK_p", "vK_i", "p", "T_d")
            if name in values
        }
        return LinearEquations(self.outputs, gauge=self.gauge).stable(known)

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        inputs = self._inputs(experiment)
        return with_brake(
            lambda vector: _core.simulate_ship(vector, *inputs, self._kernel_outputs, self._limit),
            self.vector(values),
            self.outputs,
            values.get("T_B", 0.0),
            1.0 + values.get(BRAKE_SCALE, 0.0),
        )

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, by difference quotients, shape (W, O, N)."""
        found = self.simulate(values, experiment)
        slopes = np.empty((len(names), *found.shape))
        for slope, name in zip(slopes, names, strict=True):
            value = values.get(name, 0.0)
            step = STEP * max(abs(value), 1.0)
            # A parameter with lower bound zero has a one-sided difference there.
            least = value if name in OF_BOTH_SIGNS or value >= step else value + step
            ends = (self.simulate({**values, name: one}, experiment) for one in (value + step, least - step))
            slope[:] = (next(ends) - next(ends)) / (value + 2.0 * step - least)
        return found, slopes

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) of the linearisation and its derivatives by `names`, shape (W, O, F)."""
        place: Place = "propeller" if self.propeller_speed else "engine"
        linear = TransferFunctions(self.outputs, self.gauge, place)
        damping = values.get("damping", 0.0)
        known = {**values, "p": values["p"] + damping}
        asked = ["p" if name == "damping" else name for name in names]
        return linear.response(known, frequency_hz, asked)
