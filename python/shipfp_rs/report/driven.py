"""Words that go with the drive and the load of a trial: a genset has no propeller, an electric motor no fuel rack."""

from __future__ import annotations

from collections.abc import Iterable

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.vessel.vessel import Vessel

LOADS = Sentence("a load beside the propeller's = a second load; propeller = load")
"""Words of a propeller, each with that of any load: a catalogue lists those of its own language."""
DRIVES = Sentence(
    "engine = drive; fuel rack = control signal; fuel actuator = actuator; fuel path = actuator path; "
    "fuel's torque = drive's torque; the rack = the control signal"
)
"""Words of a combustion engine, each with that of any drive."""
COMMANDS = Sentence("set point = command")
"""Words of a governor's set point, each with that of a drive in open loop."""


def instead(vessel: Vessel | None, experiments: Iterable[Experiment]) -> list[str]:
    """Return lists of words to write in place of a ship's; nothing for an engine that turns a propeller.

    A vessel without a propeller, or a load that was measured, is no ship's; a vessel without cylinders, whose fuel rack
    was not measured, either, has a drive of any kind; one in open loop has a command. Where no
    vessel is given, it is a ship's.
    """
    signals = {name for experiment in experiments for name in experiment.signals}
    words: list[str] = []
    if "M_load" in signals or (vessel is not None and not vessel.given("propeller")):
        words.append(LOADS)
    if vessel is not None and not vessel.given("engine.cylinders") and "X_f" not in signals:
        words.append(DRIVES)
    if "command" in signals:
        words.append(COMMANDS)
    return words
