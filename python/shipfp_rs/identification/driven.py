"""Vocabulary for the drive and load of a trial: a generating set has no propeller, an electric motor no fuel rack."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.progress import said_as
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.vessel.vessel import Vessel

Words = Sequence[tuple[re.Pattern[str], str]]
"""Patterns and their replacements."""

LOADS = Sentence("a load beside the propeller's = a second load; propeller = load")
"""Replacements of "propeller" for a load of any kind; each translation lists its own words."""
DRIVES = Sentence(
    "engine = drive; fuel rack = control signal; fuel actuator = actuator; fuel path = actuator path; "
    "fuel's torque = drive's torque; the rack = the control signal"
)
"""Replacements of terms of combustion engines for a drive of any kind."""
COMMANDS = Sentence("set point = command")
"""Replacement of a governor's set point for a drive in open loop."""
METER = Sentence(
    "inertia of the whole drive train = inertia before the load's torque meter; "
    "the whole drive train's inertia = the inertia before the load's torque meter"
)
"""Replacements where the model ends at the load's torque meter."""
GIVEN = ("propeller", "engine.cylinders")
"""Keys of a vessel file that imply a propeller and a combustion engine."""


class Identified(Protocol):
    """Attributes of a fingerprint that identify its drive and load."""

    @property
    def structure(self) -> Mapping[str, Any]:
        """Elements of the ship, and its input."""

    @property
    def vessel(self) -> str | None:
        """Name of the ship."""

    @property
    def data(self) -> tuple[Mapping[str, Any], ...]:
        """A row for each experiment."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the fit."""

    @property
    def ends_at_meter(self) -> bool:
        """Whether the model ends at the load's torque meter."""


@dataclass(frozen=True)
class Asked:
    """A fit before its start, of which only the ship's name is known."""

    vessel: str | None
    structure: Mapping[str, Any] = field(default_factory=dict)
    data: tuple[Mapping[str, Any], ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    ends_at_meter: bool = False


@contextmanager
def progress_of(
    experiments: Sequence[Experiment], name: str | None, vessel: Vessel | None = None
) -> Iterator[None]:
    """Within the block, report progress in the vocabulary of the drive and its load."""
    words = pairs_of(instead(Asked(name), experiments, vessel))
    with said_as(lambda what: fitting(what, words)):
        yield


def of_vessel(vessel: Vessel) -> dict[str, Any]:
    """Return the fingerprint settings that say which of `GIVEN` the vessel's file has."""
    return {"vessel_gives": [name for name in GIVEN if vessel.given(name)]}


def pairs_of(lists: Iterable[str]) -> Words:
    """Return the pairs of words in lists such as `LOADS`."""
    pairs = [pair.split(" = ") for words in lists for pair in words.split("; ")]
    return [(re.compile(rf"\b{re.escape(said)}\b"), word) for said, word in pairs]


def fitting(text: str, words: Words, *, is_english: bool = True) -> str:
    """Return a text with words replaced, and the English articles before them adjusted."""
    for pattern, word in words:
        if is_english:
            article = r"\1n " if word[0] in "aeiou" else r"\1 "
            text = re.sub(rf"\b([Aa])n? (?={pattern.pattern})", article, text)
        text = pattern.sub(word, text)
    return text


def is_loaded(fingerprint: Identified, experiments: Iterable[Experiment]) -> bool:
    """Whether a load was measured: of a generator, a dynamometer or a brake."""
    return "load" in fingerprint.structure.get("elements", ()) or any(
        "M_load" in experiment.signals for experiment in experiments
    )


def instead(
    fingerprint: Identified, experiments: Sequence[Experiment], vessel: Vessel | None = None
) -> list[str]:
    """Return the lists of word replacements; none for an engine that turns a propeller.

    "Propeller" is kept where no load was measured, and the vessel file has a propeller or the fingerprint names its ship.
    The word "engine" is replaced where the vessel file has no cylinders and no fuel rack was measured. In open loop "set
    point" becomes "command". Without a vessel, the fingerprint's settings say what its file contained.
    """
    told: Mapping[str, Any] = fingerprint.settings if vessel is None else of_vessel(vessel)
    gives = told.get("vessel_gives")
    signals = {name for experiment in experiments for name in experiment.signals}
    signals |= {name for record in fingerprint.data for name in record.get("signals", {}).values()}
    words: list[str] = [METER] if fingerprint.ends_at_meter else []
    turns = bool(fingerprint.vessel) if gives is None else "propeller" in gives
    if is_loaded(fingerprint, experiments) or not turns:
        words.append(LOADS)
    if gives is not None and "engine.cylinders" not in gives and "X_f" not in signals:
        words.append(DRIVES)
    if "command" in signals or fingerprint.structure.get("kind") == "commanded":
        words.append(COMMANDS)
    return words
