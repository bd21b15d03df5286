"""Elements of the ship model: names, parameters and requirements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from shipfp_rs.errors import InputError
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Names


@dataclass(frozen=True)
class Quantity:
    """A parameter before any data: unit, start and bounds in every structure; prior and scale in the search of a ship.

    Parameters
    ----------
    start, lower, upper
        Declared start and bounds, which are wide: bounds are no knowledge.
    prior
        Mean and standard deviation; no ship is farther than a few standard deviations from the mean. None: bounds alone.
    scale
        Whether the value or the logarithm of the value is searched.
    loose
        Whether the prior is too wide to matter for most data.
    nuisance
        Whether the parameter is estimated together with the ship's parameters, but reported without an interval.
    """

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    prior: tuple[float, float] | None = None
    scale: Literal["linear", "log"] = "linear"
    loose: bool = False
    nuisance: bool = False

    def parameter(self, **changes: Any) -> Parameter:
        """Return the parameter that structures declare."""
        return replace(Parameter(self.name, self.unit, self.start, self.lower, self.upper), **changes)


QUANTITIES: dict[str, Quantity] = {
    one.name: one
    for one in (
        Quantity("tau_n", "s", 1.2, 3e-3, 300.0, scale="log"),
        # The slope of an engine's torque is a few times the operating point's ratio of torque to speed.
        Quantity("g", "-", -0.5, -30.0, 10.0, prior=(-1.0, 4.0), loose=True),
        Quantity("v", "-", 1.2, 0.01, 300.0, scale="log"),
        Quantity("K_p", "-", 5.0, 1e-4, 1e3),
        Quantity("K_i", "1/s", 5.0, 1e-4, 1e3),
        Quantity("vK_p", "-", 5.0, 1e-4, 1e3),
        Quantity("vK_i", "1/s", 5.0, 1e-4, 1e3),
        Quantity("p", "-", 2.0, -1.0, 5.0),
        Quantity("tau_prop", "s", 0.4, 1e-3, 300.0),
        Quantity("T_d", "s", 0.05, 0.0, 2.0),
        Quantity("T_set", "s", 0.05, 0.0, 3.0),
        Quantity("tau_act", "s", 0.05, 0.0, 2.0),
        # Electric drives filter the measured speed by 5 to 50 ms.
        Quantity("T_f", "s", 0.01, 0.0, 0.5, prior=(0.0, 0.015)),
        # Turbochargers lag by 0.1 s to 0.3 s and more, fuel films of gas engines by less.
        Quantity("tau_eng", "s", 0.0, 0.0, 2.0, prior=(0.0, 0.1)),
        Quantity("vK_d", "s", 0.01, 0.0, 100.0),
        # Governors of ships droop by 3 to 5 % from no load to full load, those of generating sets alike.
        Quantity("droop", "-", 0.03, 0.0, 1.0),
        # Governors sample every 5 to 50 ms.
        Quantity("T_s", "s", 0.02, 0.0, 0.5, prior=(0.0, 0.03), nuisance=True),
        Quantity("T_0", "s", 0.0, 0.0, 0.5, nuisance=True),
        Quantity("M_max", "-", 1.2, 0.5, 10.0),
        # No gauge resolves a sharper corner of a limit than 2e-4, and sharper ones stop descents.
        Quantity("M_soft", "-", 5e-3, 2e-4, 0.1, scale="log", nuisance=True),
        Quantity("rate", "1/s", 1.0, 1e-3, 100.0, scale="log"),
        Quantity("set_rate", "1/s", 1.0, 1e-5, 100.0, scale="log"),
        # Shafts swing at 4 Hz or more, those of ships with little inertia included.
        Quantity("tau_twist", "s", 0.0, 0.0, 0.2, prior=(0.0, 5e-3), loose=True),
        Quantity("zeta_twist", "-", 0.5, 0.0, 10.0, prior=(0.0, 1.0), nuisance=True),
        Quantity("damping", "-", 0.0, -5.0, 10.0),
        # A fifth of the second-order coefficient of N^2.2, by about which open-water curves differ from a power.
        Quantity("c_2", "-", 0.0, -5.0, 5.0, prior=(0.0, 0.25)),
        # Filters and hold of a fast telemetry delay a torque channel by 1 to 5 ms, slow ones by some 20 ms.
        Quantity("T_M", "s", 1e-3, -0.5, 0.5, prior=(3e-3, 1e-2)),
        Quantity("T_B", "s", 1e-3, -0.5, 0.5, prior=(3e-3, 1e-2)),
        Quantity("T_n", "s", 1e-3, -0.5, 0.5, prior=(0.0, 3e-3)),
        Quantity("k_L", "-", 1.0, 1e-3, 100.0),
    )
}
"""All parameters of a ship: the one table that structures, search and reports read."""


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
    always
        Whether the full ship always has it, since it has a value without effect.
    """

    name: str
    words: str
    parameters: tuple[Parameter, ...]
    needs: str = ""
    always: bool = False


def _element(
    name: str, words: str, *names: str, needs: str = "", always: bool = False, **fixed: float
) -> Element:
    """Return an element; `fixed` are parameters that structures hold at a value unless they are freed."""
    free = tuple(QUANTITIES[one].parameter() for one in names)
    held = tuple(
        QUANTITIES[one].parameter(start=value, lower=min(value, QUANTITIES[one].lower), fixed=True)
        for one, value in fixed.items()
    )
    return Element(name, words, free + held, needs, always)


ELEMENTS: dict[str, Element] = {
    element.name: element
    for element in (
        _element("dead_time_loop", "dead time in the loop", "T_d", always=True),
        _element("dead_time_set_point", "dead time of the set point", "T_set", always=True),
        _element("actuator_lag", "lag of the actuator", "tau_act", always=True),
        _element("speed_filter", "filter of the measured speed", "T_f", always=True),
        _element("engine_lag", "lag of the drive's torque", "tau_eng", always=True),
        _element("derivative", "derivative gain", "vK_d"),
        _element("droop", "droop of the governor", "droop"),
        _element("sampling", "sampling of the governor", "T_s", T_0=0.0, always=True),
        _element("torque_limit", "upper torque limit", "M_max", M_soft=0.0),
        _element("rack_rate", "rate limit of the actuator", "rate"),
        _element("set_rate", "rate limit of the set point", "set_rate"),
        _element("twist", "torsionally flexible shaft", "tau_twist", "zeta_twist", always=True),
        _element("damping", "load damping", "damping"),
        _element("curvature", "second-order coefficient of the load", "c_2", always=True),
        _element("late_torque", "delay of the torque channel", "T_M", always=True),
        _element("late_brake", "delay of the brake's torque channel", "T_B"),
        _element("late_speed", "delay of the speed channel", "T_n"),
        _element("load", "measured load torque", "k_L", needs="load"),
    )
}
"""All elements by name, in the order in which structures list their parameters."""


LAGS = ("T_d", "T_set", "tau_act", "T_f", "tau_eng")
"""Dead times and lags between set point, speed and torque."""
LATE_CHANNELS = ("T_n", "T_M", "T_B")
"""Elements for delays of the sensors, which are outside the control loop."""
ABSENT = (*LAGS, "T_s", "c_2", "tau_prop", "tau_twist")
"""Parameters without effect at zero that the full ship always has."""


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
            raise InputError(f"element {name!r} needs the element {needs!r}; name both")
    return tuple(element for element in ELEMENTS.values() if element.name in names)
