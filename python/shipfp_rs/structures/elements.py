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
    """A parameter before any data: unit, start and bounds in every structure; prior and scale in the search of a ship."""

    name: str
    unit: str
    start: float
    lower: float  # bounds are wide: they express no knowledge
    upper: float
    prior: tuple[float, float] | None = None  # mean and standard deviation over all ships; None: bounds alone
    scale: Literal["linear", "log"] = "linear"  # whether the value or its logarithm is searched
    loose: bool = False  # whether the prior is too wide to matter for most data
    nuisance: bool = False  # whether it is estimated like the others, but reported without an interval

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
        # Governors of ships have a droop of 3 to 5 % from no load to full load, and so do those of generating sets.
        Quantity("droop", "-", 0.03, 0.0, 1.0),
        # Governors sample every 5 to 50 ms.
        Quantity("T_s", "s", 0.02, 0.0, 0.5, prior=(0.0, 0.03), nuisance=True),
        Quantity("T_0", "s", 0.0, 0.0, 0.5, nuisance=True),
        Quantity("M_max", "-", 1.2, 0.5, 10.0),
        # No gauge resolves a limit's corner that is sharper than 2e-4, and sharper corners stop descents.
        Quantity("M_soft", "-", 5e-3, 2e-4, 0.1, scale="log", nuisance=True),
        Quantity("rate", "1/s", 1.0, 1e-3, 100.0, scale="log"),
        Quantity("set_rate", "1/s", 1.0, 1e-5, 100.0, scale="log"),
        # The natural frequency of shafts is 4 Hz or more, also in ships with little inertia.
        Quantity("tau_twist", "s", 0.0, 0.0, 0.2, prior=(0.0, 5e-3), loose=True),
        Quantity("zeta_twist", "-", 0.5, 0.0, 10.0, prior=(0.0, 1.0), nuisance=True),
        Quantity("damping", "-", 0.0, -5.0, 10.0),
        # Open-water curves differ from a power by about a fifth of the second-order coefficient of N^2.2.
        Quantity("c_2", "-", 0.0, -5.0, 5.0, prior=(0.0, 0.25)),
        # Filters and hold of fast telemetry delay a torque channel by 1 to 5 ms, those of slow telemetry by some 20 ms.
        Quantity("T_M", "s", 1e-3, -0.5, 0.5, prior=(3e-3, 1e-2)),
        Quantity("T_B", "s", 1e-3, -0.5, 0.5, prior=(3e-3, 1e-2)),
        Quantity("T_n", "s", 1e-3, -0.5, 0.5, prior=(0.0, 3e-3)),
        Quantity("k_L", "-", 1.0, 1e-3, 100.0),
    )
}
"""All parameters of a ship: the one table that structures, search and reports read."""


@dataclass(frozen=True)
class Element:
    """An optional element of a drive train."""

    name: str  # in `Structure.ship`, TRIAL.toml and fingerprints
    words: str  # name in a report
    parameters: tuple[Parameter, ...]  # parameters that it adds to a structure
    needs: str = ""  # "load" (a measured load torque), another element that it requires, or ""
    always: bool = False  # whether the full ship always has it, since it has a value without effect


def _element(
    name: str, words: str, *names: str, needs: str = "", always: bool = False, **fixed: float
) -> Element:
    """Return an element; structures hold the `fixed` parameters at the given values unless the user frees them."""
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
"""Delays of the sensors' channels, which are outside the control loop."""
ABSENT = (*LAGS, "T_s", "c_2", "tau_prop", "tau_twist")
"""Parameters that the full ship always has and that have no effect at zero."""


def chosen(names: Names) -> tuple[Element, ...]:
    """Return the named elements in the table's order; `InputError` for a wrong name or a missing requirement."""
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
