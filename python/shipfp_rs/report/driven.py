"""Words that go with the drive and the load of a trial: a genset has no propeller, an electric motor no fuel rack."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
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


def is_loaded(fingerprint: Fingerprint, experiments: Iterable[Experiment]) -> bool:
    """Whether a load was measured: of a generator, a dynamometer or a brake."""
    return "load" in fingerprint.structure.get("elements", ()) or any(
        "M_load" in experiment.signals for experiment in experiments
    )


def instead(
    fingerprint: Fingerprint, experiments: Sequence[Experiment], vessel: Vessel | None = None
) -> list[str]:
    """Return lists of words to write in place of a ship's; nothing for an engine that turns a propeller.

    A propeller is spoken of only where there is one: its vessel's file has it, or the fingerprint names its ship, and no
    load was measured. A vessel without cylinders, whose fuel rack was not measured, either, has a drive of any kind; one
    in open loop has a command.
    """
    signals = {name for experiment in experiments for name in experiment.signals}
    words: list[str] = []
    turns = bool(fingerprint.vessel) if vessel is None else vessel.given("propeller")
    if is_loaded(fingerprint, experiments) or not turns:
        words.append(LOADS)
    if vessel is not None and not vessel.given("engine.cylinders") and "X_f" not in signals:
        words.append(DRIVES)
    if "command" in signals:
        words.append(COMMANDS)
    return words
