"""What the name and the unit of a channel tell: of what quantity it is, and whether it was asked for or measured."""

from __future__ import annotations

import functools
import re
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

from shipfp_rs.logs.channel import Channel
from shipfp_rs.support.units import ELECTRIC, FREQUENCIES, QUANTITIES, told

LEAST_PART = 4
"""Letters from which a word counts as a part of a longer one."""
LETTERS = str.maketrans({"ø": "o", "æ": "ae", "ß": "ss", "ł": "l", "ı": "i", "đ": "d"})
"""Letters that are no base letter with an accent, and what to write for each."""
WORD_ENDS = re.compile(r"(?<=[^\W\d_A-Z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Where a word of MotorVelocitySet ends."""
TAIL = re.compile(
    r"(?:[ _(\[-]+|(?<=[^\W\d_A-Z])(?=[A-Z]))(?i:"
    r"(rpm|rad_?p?s|deg_?p?s|rad[_/]s(?:ec)?|deg[_/]s(?:ec)?|rev_s|rps|hz|k?nm|k?w|u_?min|1_?min|1_s|pct|percent|%))[)\]]?$"
)
"""A unit at the end of a name, where the log has no other place for it."""
TAILS: Mapping[str, str] = {
    "rads": "rad/s", "radps": "rad/s", "radsec": "rad/s", "degs": "deg/s", "degps": "deg/s", "degsec": "deg/s",
    "revs": "rev/s", "umin": "rpm", "1min": "rpm", "1s": "1/s", "hz": "Hz", "w": "W", "kw": "kW",
}  # fmt: skip


@functools.cache
def words() -> Mapping[str, frozenset[str]]:
    """Return the words of all languages by what they tell."""
    text = (resources.files("shipfp_rs") / "data" / "channel_words.toml").read_text(encoding="utf-8")
    return {
        what: frozenset(word for language in languages.values() for word in language)
        for what, languages in tomllib.loads(text).items()
    }


@dataclass(frozen=True)
class Named:
    """What a channel's name and unit tell.

    Parameters
    ----------
    unit
        The channel's, or that at the end of its name; empty where neither tells one.
    quantity
        "speed", "frequency", "torque", "power", "angle" or "other"; None where unit and name leave it open.
    tells
        What the words of its name tell, of the table's heads.
    by
        "its unit 'rpm'" or "its name".
    """

    unit: str
    quantity: str | None
    tells: frozenset[str]
    by: str

    @property
    def is_open(self) -> bool:
        """Whether the unit leaves open what was recorded."""
        return self.unit in ELECTRIC


def named(channel: Channel) -> Named:
    """Return what the name and unit of a channel tell.

    Examples
    --------
    >>> found = named(Channel("MotorVelocitySet", "1/min", 100.0, 1))
    >>> found.quantity, "wanted" in found.tells
    ('speed', True)
    >>> named(Channel("feedback_deg_s", "", 100.0, 1)).unit
    'deg/s'
    """
    name, unit = channel.name, told(channel.unit)
    if not unit and (tail := TAIL.search(name)):
        letters = re.sub("[_/]", "", tail[1].lower())
        unit = TAILS.get(letters) or told(letters)
        name = name[: tail.start()]
    tells = _told_by(WORD_ENDS.sub(" ", name))
    quantity = _of_unit(unit, tells)
    by = f"its unit {unit!r}"
    if quantity is None:
        by = "its name"
        quantity = next((what for what in ("torque", "speed") if what in tells), None)
    return Named(unit, quantity, tells, by)


def _of_unit(unit: str, tells: frozenset[str]) -> str | None:
    """Return the quantity of a unit; a frequency is a speed only where the name says speed."""
    if unit in FREQUENCIES:
        return "speed" if tells & {"speed", "wanted"} else "frequency" if "frequency" in tells else "other"
    for quantity, known in QUANTITIES.items():
        if unit in known.factors:
            return quantity
    # A drive tells torque and speed in per cent of ones that are to be given.
    by_name = unit in ELECTRIC or (unit == "%" and tells & {"torque", "speed"})
    return None if by_name else "other"


def _told_by(name: str) -> frozenset[str]:
    plain = unicodedata.normalize("NFKD", name.casefold().translate(LETTERS))
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    alone = re.findall(r"[^\W\d_]+", plain)
    together = "".join(alone)
    return frozenset(
        what
        for what, known in words().items()
        if any(word in alone or (len(word) >= LEAST_PART and word in together) for word in known)
    )
