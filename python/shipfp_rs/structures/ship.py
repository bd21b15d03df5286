"""The one ship model's equations: the nonlinear drive train in normalised terms, computed by the Rust kernel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment, Hold
from shipfp_rs.structures.equations import Against, Equations
from shipfp_rs.structures.linear import LinearEquations
from shipfp_rs.structures.linear_extended import ExtendedLinear, Place
from shipfp_rs.support.arrays import Array, ComplexArray

SET_SCALE, TORQUE_SCALE = "set point scale", "torque scale"
STATES = ("initial dn", "initial fuel", SET_SCALE, TORQUE_SCALE)
"""An experiment's own unknowns: how far the speed and the fuel's torque are from the operating point at its first
sample, and by which part the set point and the torque are read wrong, their operating points' errors included."""

_INDEX = {name: index for index, name in enumerate(_core.SHIP_PARAMETERS)}
_KERNEL = {
    "vK_p": "K_p",
    "vK_i": "K_i",
    "vK_d": "K_d",
    "rate": "rate_up",
    "k_L": "load_gain",
    "initial dn": "initial_N",
    "initial fuel": "initial_F",
    SET_SCALE: "s_u",
    TORQUE_SCALE: "s_M",
}
"""Names that differ from the kernel's."""
_DEVIATIONS = ("initial dn", SET_SCALE, TORQUE_SCALE)
"""What counts from zero here and from one in the kernel."""


@dataclass(frozen=True)
class ShipEquations(Equations):
    """The ship of `Structure.ship`; a frequency response is that of its linearisation."""

    outputs: tuple[str, ...]
    gauge: bool
    propeller_speed: bool = False
    loaded: bool = False
    """Whether the experiment's load torque drives the model, too."""
    states: tuple[str, ...] = STATES
    linear_in: tuple[str, ...] = ()
    own_offsets: bool = True
    has_products: bool = True
    """The errors of the operating points stand among the states, so `identify` adds no constants."""

    @property
    def _kernel_outputs(self) -> list[int]:
        names = {
            "dn": "dn_prop" if self.propeller_speed else "dn",
            "dM": "dM_g" if self.gauge else "dM_b",
        }
        return [_core.SHIP_OUTPUTS.index(names.get(output, output)) for output in self.outputs]

    @staticmethod
    def vector(values: Mapping[str, float]) -> Array:
        """Return the kernel's parameters (32,) for values by name; what has none is off."""
        vector = np.array(_core.SHIP_OFF)
        vector[_INDEX["v"]] = 1.0
        for name, value in values.items():
            if name in STATES or name in _INDEX or name in _KERNEL:
                vector[_INDEX[_KERNEL.get(name, name)]] = value + (name in _DEVIATIONS)
        if values.get("tau_twist") and values["tau_prop"] >= 0.99 * values["tau_n"]:
            raise SimulationError("nothing is left of the inertia on the engine's side of the twisting shaft")
        if "rate" in values:
            vector[_INDEX["rate_down"]] = values["rate"]
        return vector

    def _columns(self, names: Sequence[str]) -> list[int]:
        return [_INDEX[_KERNEL.get(name, name)] for name in names]

    def _inputs(self, experiment: Experiment) -> tuple[Array, Array, float, int, Hold]:
        load = experiment.normalised("M_load") if self.loaded else np.empty(0)
        return 1.0 + experiment.dn_set, load, 1.0 / experiment.rate_hz, 0, experiment.hold

    def stable(self, values: Mapping[str, float]) -> bool:
        """Whether the loop is stable about the operating point, judged without lag and sampling."""
        known = {
            name: values[name]
            for name in ("tau_n", "g", "v", "K_p", "K_i", "vK_p", "vK_i", "p", "T_d")
            if name in values
        }
        return LinearEquations(self.outputs, gauge=self.gauge).stable(known)

    def simulate(self, values: Mapping[str, float], experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return _core.simulate_ship(self.vector(values), *self._inputs(experiment), self._kernel_outputs)

    def sensitivities(
        self, values: Mapping[str, float], experiment: Experiment, names: Sequence[str]
    ) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        return _core.ship_sensitivities(
            self.vector(values), *self._inputs(experiment), self._kernel_outputs, self._columns(names)
        )

    def products(
        self, values: Mapping[str, float], experiment: Experiment, names: Sequence[str], against: Against
    ) -> tuple[Array, int]:
        """Return sums of products of residuals and sensitivities and the number of samples; see `Equations`."""
        return _core.ship_products(
            self.vector(values),
            *self._inputs(experiment),
            self._kernel_outputs,
            *against,
            self._columns(names),
        )

    def response(
        self, values: Mapping[str, float], frequency_hz: Array, names: Sequence[str]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) of the linearisation and its derivatives with respect to `names`, shape (W, O, F)."""
        place: Place = "propeller" if self.propeller_speed else "engine"
        linear = ExtendedLinear(self.outputs, self.gauge, place).equations()
        damping = values.get("damping", 0.0)
        known = {**values, "p": values["p"] + damping}
        asked = ["p" if name == "damping" else name for name in names]
        return linear.response(known, frequency_hz, asked)
