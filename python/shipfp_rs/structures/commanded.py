"""A drive in open loop, whose input is a command of torque, current, voltage or fuel instead of a governor's set point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.structures.elements import chosen
from shipfp_rs.structures.outputs import Torque, require_outputs, signals_of
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.ship import INDEX, TORQUE_SCALE, ShipEquations
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

KIND = "commanded"
"""Kind of such a structure in its settings."""
ELEMENTS = ("dead_time_loop", "actuator_lag", "damping", "curvature", "late_torque", "load")
"""Elements of the ship that do not need a governor."""
MOST_TWISTED = 0.98
"""Largest share of the inertia behind a shaft that twists, in a simulation."""
FEEDBACK = 1e-9
"""Gain of the kernel's governor. Its set point is scaled by the inverse, so that speed feedback vanishes."""


def stepper_parameters(values: Values, *, open_loop: bool = False) -> Array:
    """Return the stepper's parameters from a ship's by name; the governor's gains are products with the rack's torque v."""
    v = values.get("v", 1.0)
    own = {name: value / v if name in ("vK_p", "vK_i", "vK_d") else value for name, value in values.items()}
    if own.get("tau_twist"):
        own["tau_prop"] = min(own["tau_prop"], MOST_TWISTED * own["tau_n"])
    if open_loop:
        return CommandedEquations((), gauge=False).vector(own)
    return ShipEquations((), gauge=False).vector(own)


@dataclass(frozen=True)
class CommandedEquations(ShipEquations):
    """The ship's equations with a command instead of a governor."""

    states: tuple[str, ...] = ("initial dn", "initial fuel", TORQUE_SCALE)

    def vector(self, values: Values) -> Array:
        """Return the kernel's parameters for values by name; the dead time is that of the kernel's set point."""
        vector = super().vector({_KERNEL.get(name, name): value for name, value in values.items()})
        vector[[INDEX["K_p"], INDEX["K_i"]]] = FEEDBACK, 0.0
        vector[[INDEX["s_u"], INDEX["u_0"]]] = 1.0 / FEEDBACK, 1.0 - 1.0 / FEEDBACK
        return vector

    def stable(self, values: Values) -> bool:
        """Whether the drive is stable by itself: the torque balance falls with the speed."""
        return values["p"] + values.get("damping", 0.0) > values["g"]

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) to the command and its derivatives by `names`, shape (W, O, F)."""
        s = 2j * np.pi * np.asarray(frequency_hz)
        own, inertia = values["p"] + values.get("damping", 0.0), "tau_prop" if self.gauge else "tau_n"
        lag, late = values.get("tau_act", 0.0), values.get("T_d", 0.0)
        speed = 1.0 / (values["tau_n"] * s + own - values["g"])
        outputs = {"dn": values["v"] * np.exp(-s * late) / (1.0 + s * lag) * speed}
        torque = np.exp(-s * values.get("T_M", 0.0)) * outputs["dn"]
        outputs["dM"] = torque * (own + values[inertia] * s)
        by: dict[str, Any] = {
            "v": 1.0 / values["v"], "tau_n": -s * speed, "p": -speed, "damping": -speed, "g": speed,
            "T_d": -s, "tau_act": -s / (1.0 + s * lag),
        }  # fmt: skip
        of_torque: dict[str, Any] = {
            "p": torque,
            "damping": torque,
            inertia: s * torque,
            "T_M": -s * outputs["dM"],
        }
        found = np.array([outputs[output] for output in self.outputs])
        slopes = np.zeros((len(names), *found.shape), dtype=complex)
        for row, name in zip(slopes, names, strict=True):
            for place, output in enumerate(self.outputs):
                row[place] = by.get(name, 0.0) * outputs[output]
                row[place] += of_torque.get(name, 0.0) if output == "dM" else 0.0
        return found, slopes


_KERNEL = {"T_d": "T_set"}
"""Parameters whose kernel names differ."""


def commanded(
    declare: Any,
    elements: Sequence[str] = ("dead_time_loop", "actuator_lag"),
    *,
    torque: Torque = "brake",
    outputs: Sequence[str] = ("dn", "dM"),
    name: str | None = None,
) -> Any:
    """Return the structure of a drive in open loop; `declare` is the class `Structure`, which imports this module.

    With N and M the speed and torque over their operating points, and c the relative deviation of the command:

        tau_n dN/dt = M_b - N^p,                M_b = 1 + g (N - 1) + v c(t - T_d)

    Parameters
    ----------
    elements
        Of `ELEMENTS`: T_d, tau_act, damping and second-order coefficient of the load, a delayed torque channel, a measured
        load.
    torque, outputs, name
        As of `Structure.ship`; outputs are "dn" and "dM".

    Raises
    ------
    InputError
        For an element or output that needs a governor or a rack.
    """
    require_outputs(outputs)
    acting = chosen(elements)
    for what, given, known in (("element", elements, ELEMENTS), ("output", outputs, ("dn", "dM"))):
        for one in given:
            if one not in known:
                raise InputError(
                    f"{what} {one!r} of a drive in open loop, expected some of {', '.join(known)}"
                )
    gauge = torque == "gauge" and "dM" in outputs
    return declare(
        name=name or "open loop",
        parameters=(
            Parameter("tau_n", "s", 1.2, 0.003, 300.0),
            Parameter("g", "-", -0.5, -300.0, 3.0),
            Parameter("v", "-", 1.2, 0.01, 300.0),
            Parameter("p", "-", 2.0, -1.0, 5.0),
            *((Parameter("tau_prop", "s", 0.5, 1e-3, 300.0),) if gauge else ()),
            *(one for element in acting for one in element.parameters if one.name != "hold"),
        ),
        signals=signals_of(outputs, torque),
        equations=CommandedEquations(
            tuple(outputs), gauge, loaded=any(element.name == "load" for element in acting)
        ),
        settings={"kind": KIND, "elements": [element.name for element in acting], "torque": torque},
    )
