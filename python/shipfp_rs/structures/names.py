"""Plain names of parameters and combinations, in English and German, for tables and reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from shipfp_rs.structures import glossary

Language = Literal["en", "de"]

NAMES: Mapping[str, tuple[str, str]] = {
    "tau_n": ("inertia time constant", "Zeitkonstante der Trägheit"),
    "tau_prop": ("inertia time constant behind the gauge", "Zeitkonstante hinter der Messstelle"),
    "g": ("slope of engine torque with speed", "Steigung des Motormoments über der Drehzahl"),
    "v": ("slope of engine torque with fuel rack", "Steigung des Motormoments über der Füllung"),
    "p": ("propeller exponent", "Exponent des Propellers"),
    "K_p": ("proportional gain of the governor", "P-Beiwert des Reglers"),
    "K_i": ("integral gain of the governor", "I-Beiwert des Reglers"),
    "K_d": ("derivative gain of the governor", "D-Beiwert des Reglers"),
    "vK_p": ("proportional gain of the loop", "P-Verstärkung des Kreises"),
    "vK_i": ("integral gain of the loop", "I-Verstärkung des Kreises"),
    "vK_d": ("derivative gain of the loop", "D-Verstärkung des Kreises"),
    "T_d": ("dead time in the loop", "Totzeit im Kreis"),
    "T_set": ("dead time of the set point", "Totzeit des Sollwerts"),
    "T_s": ("sampling period of the governor", "Abtastzeit des Reglers"),
    "T_0": ("first sample of the governor", "erster Abtastzeitpunkt des Reglers"),
    "c_2": ("second-order coefficient of the load", "Beiwert zweiter Ordnung der Last"),
    "hold": (
        "share of T_d from sampling and holding",
        "Anteil von T_d durch Abtasten und Halten",
    ),
    "M_soft": ("rounding of the torque limit", "Rundung der Momentengrenze"),
    "T_M": ("delay of the torque channel", "Verzug des Drehmomentkanals"),
    "T_n": ("delay of the speed channel", "Verzug des Drehzahlkanals"),
    "tau_act": ("lag of the fuel actuator", "Zeitkonstante des Stellglieds"),
    "tau_twist": ("torsional compliance of the shaft", "Drehnachgiebigkeit der Welle"),
    "zeta_twist": ("damping of the flexible shaft", "Dämpfung der Wellenverdrehung"),
    "damping": ("load damping", "Dämpfung der Last"),
    "M_max": ("upper torque limit", "obere Momentengrenze"),
    "rate": ("rate limit of the fuel rack", "Stellgeschwindigkeit der Füllung"),
    "k_L": ("gain of the measured load", "Beiwert der gemessenen Last"),
    "dM_b(0)": ("torque over speed, for slow motions", "Moment je Drehzahl, bei langsamen Bewegungen"),
    "dM_g(0)": ("torque over speed, for slow motions", "Moment je Drehzahl, bei langsamen Bewegungen"),
    "dM_b(inf)": ("torque over set point, for fast motions", "Moment je Sollwert, bei schnellen Bewegungen"),
    "dM_g(inf)": ("torque over set point, for fast motions", "Moment je Sollwert, bei schnellen Bewegungen"),
    "ultimate gain": (
        "proportional gain of the loop at which it swings (K_u)",
        "P-Verstärkung, bei der der Kreis schwingt (K_u)",
    ),
    "ultimate period": (
        "period with which it swings then (P_u)",
        "Periode, mit der er dann schwingt (P_u)",
    ),
    "K_p/K_i": ("reset time of the governor", "Nachstellzeit des Reglers"),
    "p-g": ("self-regulation", "Selbstausgleich"),
    "(p-g)/tau_n": ("corner frequency without governor", "Eckfrequenz ohne Regler"),
    "vK_p/tau_n": ("proportional gain over inertia", "P-Verstärkung je Trägheit"),
    "vK_i/tau_n": ("integral gain over inertia", "I-Verstärkung je Trägheit"),
    "tau_prop/tau_n": ("share of the inertia behind the gauge", "Anteil der Trägheit hinter der Messstelle"),
    "(p-g)/(vK_i)": (
        "lag behind a slow ramp of the set point",
        "Rückstand hinter einer langsamen Sollwertrampe",
    ),
    "(p-g)/(vK_i)+T_set": (
        "lag behind a slow ramp of the set point, dead time included",
        "Rückstand hinter einer langsamen Sollwertrampe, mit Totzeit",
    ),
}
"""Symbol, or figure of the loop, to its plain name in English and in German."""

LOOKED_AT = (
    *("k_L", "tau_prop", "T_M", "T_n", "T_0"),
    *("v", "T_set", "T_d", "hold", "T_s", "tau_act", "M_max", "M_soft", "rate"),
    *("tau_n", "g", "p", "c_2", "damping", "tau_twist", "zeta_twist"),
    *("K_p", "K_i", "K_d", "vK_p", "vK_i", "vK_d"),
)
"""Parameters in the order in which an engineer looks: sensors and their places, actuation, drive train and load, gains."""


def as_looked_at(names: Iterable[str]) -> list[str]:
    """Return parameters in the order in which an engineer looks at them; a user's own last, as they came."""

    def place(name: str) -> int:
        own = name.partition(" (")[0]
        return LOOKED_AT.index(own) if own in LOOKED_AT else len(LOOKED_AT)

    return sorted(names, key=place)


def plain_name(symbol: str, language: Language = "en") -> str:
    """Return a symbol's plain name; the glossary's meaning where it has none, empty for a parameter of a user's own.

    The name of a trial of a joint structure stays in brackets behind it: "inertia time constant (fast)".
    """
    own, bracket, part = symbol.partition(" (")
    if own in NAMES:
        return NAMES[own][language == "de"] + bracket + part
    return glossary.meaning(symbol)
