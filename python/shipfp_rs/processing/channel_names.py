"""Quantity and role of a channel, from its name and unit."""

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
"""Least number of letters of a word that is recognised within a longer one."""
LETTERS = str.maketrans({"ø": "o", "æ": "ae", "ß": "ss", "ł": "l", "ı": "i", "đ": "d"})
"""Letters that Unicode does not decompose into base letter and accent, and their replacements."""
WORD_ENDS = re.compile(r"(?<=[^\W\d_A-Z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Boundaries between words in names like MotorVelocitySet."""
TAIL = re.compile(
    r"(?:[ _(\[-]+|(?<=[^\W\d_A-Z])(?=[A-Z]))(?i:"
    r"(rpm|rad_?p?s|deg_?p?s|rad[_/]s(?:ec)?|deg[_/]s(?:ec)?|rev_s|rps|hz|k?nm|k?w|u_?min|1_?min|1_s|pct|percent|%))[)\]]?$"
)
"""Unit at the end of a name, for logs without separate units."""
TAILS: Mapping[str, str] = {
    "rads": "rad/s", "radps": "rad/s", "radsec": "rad/s", "degs": "deg/s", "degps": "deg/s", "degsec": "deg/s",
    "revs": "rev/s", "umin": "rpm", "1min": "rpm", "1s": "1/s", "hz": "Hz", "w": "W", "kw": "kW",
}  # fmt: skip


@functools.cache
def words() -> Mapping[str, frozenset[str]]:
    """Words of all languages by meaning."""
    text = (resources.files("shipfp_rs") / "data" / "channel_words.toml").read_text(encoding="utf-8")
    return {
        what: frozenset(word for language in languages.values() for word in language)
        for what, languages in tomllib.loads(text).items()
    }


@dataclass(frozen=True)
class Named:
    """Unit, quantity (None if undetermined) and word meanings (headings of `channel_words.toml`) of a channel's name."""

    unit: str
    quantity: str | None
    tells: frozenset[str]
    by: str

    @property
    def is_open(self) -> bool:
        """Whether the unit does not determine the quantity."""
        return self.unit in ELECTRIC


def named(channel: Channel) -> Named:
    """Interpret the name and unit of a channel.

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
    """Quantity of a unit; a frequency is a speed only if the name means speed."""
    if unit in FREQUENCIES:
        return "speed" if tells & {"speed", "wanted"} else "frequency" if "frequency" in tells else "other"
    for quantity, known in QUANTITIES.items():
        if unit in known.factors:
            return quantity
    # A drive reports torque and speed in per cent of rated values, which the user has to give.
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
