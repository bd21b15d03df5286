"""Plain names of parameters and combinations, for tables and reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from shipfp_rs.structures import glossary

NAMES: Mapping[str, str] = {
    "tau_n": "inertia time constant",
    "tau_prop": "inertia time constant behind the gauge",
    "g": "slope of drive torque with speed",
    "v": "slope of drive torque with actuator",
    "p": "load exponent",
    "K_p": "proportional gain of the governor",
    "K_i": "integral gain of the governor",
    "K_d": "derivative gain of the governor",
    "vK_p": "proportional gain of the loop",
    "vK_i": "integral gain of the loop",
    "vK_d": "derivative gain of the loop",
    "droop": "droop of the governor",
    "T_d": "dead time in the loop",
    "T_set": "dead time of the set point",
    "T_s": "sampling period of the governor",
    "T_0": "first sample of the governor",
    "c_2": "second-order coefficient of the load",
    "M_soft": "rounding of the torque limit",
    "T_M": "delay of the torque channel",
    "T_B": "delay of the brake's torque channel",
    "T_n": "delay of the speed channel",
    "tau_act": "lag of the actuator",
    "T_f": "filter time of the measured speed",
    "tau_eng": "lag of the drive's torque",
    "tau_twist": "torsional compliance of the shaft",
    "zeta_twist": "damping of the flexible shaft",
    "damping": "load damping",
    "M_max": "upper torque limit",
    "rate": "rate limit of the actuator",
    "set_rate": "rate limit of the set point",
    "k_L": "gain of the measured load",
    "dM_b(0)": "torque over speed, for slow motions",
    "dM_g(0)": "torque over speed, for slow motions",
    "dM_b(inf)": "torque over set point, for fast motions",
    "dM_g(inf)": "torque over set point, for fast motions",
    "ultimate gain": "proportional gain at which the loop oscillates (K_u)",
    "ultimate period": "period of that oscillation (P_u)",
    "K_p/K_i": "reset time of the governor",
    "p-g": "self-regulation",
    "(p-g)/tau_n": "corner frequency without governor",
    "vK_p/tau_n": "proportional gain over inertia",
    "vK_i/tau_n": "integral gain over inertia",
    "tau_prop/tau_n": "share of the whole inertia that is behind the gauge",
    "(p-g)/(vK_i)": "lag behind a slow ramp of the set point",
    "(p-g)/(vK_i)+T_set-T_f": "lag behind a slow ramp of the set point, delays included",
}
"""Plain names by the symbol of a parameter or the name of a loop's figure."""

OF_WHAT: Mapping[str, str] = {
    "droop": "of the speed, for the operating torque",
    "tau_prop/tau_n": "of tau_n",
    "M_max": "times the operating torque",
    "M_soft": "times the operating torque",
}
"""Reference of a dimensionless figure."""

LOOKED_AT = (
    *("k_L", "tau_prop", "T_M", "T_B", "T_n", "T_0"),
    *("v", "T_set", "T_d", "T_s", "tau_act", "T_f", "tau_eng", "M_max", "M_soft", "rate", "set_rate"),
    *("tau_n", "g", "p", "c_2", "damping", "tau_twist", "zeta_twist"),
    *("K_p", "K_i", "K_d", "vK_p", "vK_i", "vK_d", "droop"),
)
"""Parameters in the order of reports: sensors, actuation, drive train and load, gains."""


def as_looked_at(names: Iterable[str]) -> list[str]:
    """Return parameters in the order of reports; parameters of user equations follow in the given order."""

    def place(name: str) -> int:
        own = name.partition(" (")[0]
        return LOOKED_AT.index(own) if own in LOOKED_AT else len(LOOKED_AT)

    return sorted(names, key=place)


def plain_name(symbol: str) -> str:
    """Return a symbol's plain name with a trial in brackets, or its meaning in the glossary, or "" for user equations."""
    own, bracket, part = symbol.partition(" (")
    if own in NAMES:
        return NAMES[own] + bracket + part
    return glossary.meaning(symbol)
