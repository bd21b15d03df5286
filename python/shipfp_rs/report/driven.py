"""Words that go with the drive and the load of a trial: a genset has no propeller, an electric motor no fuel rack."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.vessel.vessel import Vessel

Pairs = Sequence[tuple[str, str]]

LOADS: Mapping[str, Pairs] = {
    "en": (
        ("a load beside the propeller's", "a second load"),
        ("propeller", "load"),
    ),
    "de": (
        ("eine Last neben dem Propeller", "eine zweite Last"),
        ("des Propellers", "der Last"),
        ("Propellermoment", "Lastmoment"),
        ("Propellerwelle", "Lastwelle"),
        ("Propellerseite", "Lastseite"),
        ("Propellerdrehzahl", "Lastdrehzahl"),
    ),
}
"""Words of a propeller to those of any load."""
DRIVES: Mapping[str, Pairs] = {
    "en": (
        ("engine", "drive"),
        ("fuel rack", "control signal"),
        ("fuel actuator", "actuator"),
        ("fuel path", "actuator path"),
        ("fuel's torque", "drive's torque"),
        ("the rack", "the control signal"),
    ),
    "de": (
        ("Füllung", "Stellgröße"),
        ("Kraftstoffweg", "Stellweg"),
        ("Kraftstoffstellers", "Stellglieds"),
        ("aus dem Kraftstoff", "des Antriebs"),
    ),
}
"""Words of a combustion engine to those of any drive."""
COMMANDS: Mapping[str, Pairs] = {
    "en": (("set point", "command"),),
    "de": (("Sollwert", "Stellbefehl"), ("Sollwerts", "Stellbefehls"), ("Sollwerte", "Stellbefehle")),
}
"""Words of a governor's set point to those of a drive in open loop."""


def replacements(
    vessel: Vessel | None, experiments: Iterable[Experiment], language: str
) -> tuple[tuple[re.Pattern[str], str], ...]:
    """Return what to write in place of a ship's words, as patterns; nothing for an engine that turns a propeller.

    A vessel without a propeller, or a load that was measured, is no ship's; a vessel without cylinders, whose fuel rack
    was not measured, either, has a drive of any kind; one in open loop has a command. Where no
    vessel is given, it is a ship's.
    """
    signals = {name for experiment in experiments for name in experiment.signals}
    pairs: list[tuple[str, str]] = []
    if "M_load" in signals or (vessel is not None and not vessel.given("propeller")):
        pairs += LOADS[language]
    if vessel is not None and not vessel.given("engine.cylinders") and "X_f" not in signals:
        pairs += DRIVES[language]
    if "command" in signals:
        pairs += COMMANDS[language]
    return tuple((re.compile(rf"\b{re.escape(said)}\b"), word) for said, word in pairs)
