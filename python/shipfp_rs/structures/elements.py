"""Elements of the ship model: names, parameters and requirements."""

from __future__ import annotations

from dataclasses import dataclass

from shipfp_rs.errors import InputError
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Names


@dataclass(frozen=True)
class Element:
    """An optional element of a drive train.

    Parameters
    ----------
    name
        Name in `Structure.ship`, TRIAL.toml and fingerprints.
    words
        Name in a report.
    parameters
        Parameters that it adds to a structure.
    needs
        Requirement: "load" (a measured load torque), the name of another element, or "" (none).
    """

    name: str
    words: str
    parameters: tuple[Parameter, ...]
    needs: str = ""


ELEMENTS: dict[str, Element] = {
    element.name: element
    for element in (
        Element(
            "dead_time_loop",
            "dead time in the loop",
            (Parameter("T_d", "s", 0.05, 0.0, 0.5), Parameter("hold", "-", 0.0, 0.0, 1.0, fixed=True)),
        ),
        Element(
            "dead_time_set_point", "dead time of the set point", (Parameter("T_set", "s", 0.05, 0.0, 2.0),)
        ),
        Element("actuator_lag", "lag of the fuel actuator", (Parameter("tau_act", "s", 0.05, 0.0, 1.0),)),
        Element("derivative", "derivative gain", (Parameter("vK_d", "s", 0.05, 0.0, 10.0),)),
        Element(
            "sampling",
            "sampling of the governor",
            (Parameter("T_s", "s", 0.02, 1e-3, 0.5), Parameter("T_0", "s", 0.0, 0.0, 0.5, fixed=True)),
        ),
        Element(
            "torque_limit",
            "upper torque limit",
            (
                Parameter("M_max", "-", 1.1, 0.5, 5.0),
                Parameter("M_soft", "-", 0.0, 0.0, 0.1, fixed=True),
            ),
        ),
        Element("rack_rate", "rate limit of the fuel rack", (Parameter("rate", "1/s", 1.0, 1e-3, 100.0),)),
        Element(
            "rack_rate_down",
            "other rate limit of the fuel rack on its way down",
            (Parameter("rate_down", "1/s", 1.0, 1e-3, 100.0),),
            "rack_rate",
        ),
        Element(
            "twist",
            "torsionally flexible shaft",
            (Parameter("tau_twist", "s", 1e-3, 3e-4, 0.1), Parameter("zeta_twist", "-", 0.5, 0.0, 6.0)),
        ),
        Element("damping", "load damping", (Parameter("damping", "-", 0.1, -5.0, 10.0),)),
        Element(
            "curvature", "second-order coefficient of the load", (Parameter("c_2", "-", 0.0, -2.0, 2.0),)
        ),
        Element("late_torque", "delay of the torque channel", (Parameter("T_M", "s", 2e-3, 0.0, 0.05),)),
        Element(
            "late_brake",
            "delay of the brake's torque channel",
            (Parameter("T_B", "s", 2e-3, 0.0, 0.05),),
        ),
        Element("late_speed", "delay of the speed channel", (Parameter("T_n", "s", 2e-3, 0.0, 0.05),)),
        Element("load", "measured load torque", (Parameter("k_L", "-", 1.0, 0.01, 10.0),), "load"),
    )
}
"""All elements by name, in the order in which structures list their parameters."""


LATE_CHANNELS = ("T_n", "T_M", "T_B")
"""Elements for delays of the sensors, which are outside the control loop."""


def chosen(names: Names) -> tuple[Element, ...]:
    """Return the named elements in the table's order.

    Raises
    ------
    InputError
        For an unknown or repeated name, or a missing requirement.
    """
    for name in names:
        if name not in ELEMENTS:
            raise InputError(
                f"the ship model has no element {name!r}, {hints.suggestion(name, list(ELEMENTS))}"
            )
        if list(names).count(name) > 1:
            raise InputError(f"element {name!r} is named twice, expected each once")
        if (needs := ELEMENTS[name].needs) in ELEMENTS and needs not in names:
            raise InputError(f"element {name!r} needs {needs!r}, expected both")
    return tuple(element for element in ELEMENTS.values() if element.name in names)
