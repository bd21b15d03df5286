"""Quantities and roles of a log's channels: from their names and units, or from their samples if these are ambiguous."""

from __future__ import annotations

import functools
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.conditioning import block_means
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.files import words_of
from shipfp_rs.support.spikes import bridge
from shipfp_rs.support.units import ELECTRIC, FREQUENCIES, QUANTITIES, TO_RPM, told

LEAST_PART = 4
"""Words with at least this many letters are recognised within longer words."""
LETTERS = str.maketrans({"ø": "o", "æ": "ae", "ß": "ss", "ł": "l", "ı": "i", "đ": "d"})
"""Letters that Unicode does not decompose into base letter and accent, and their replacements."""
WORD_ENDS = re.compile(r"(?<=[^\W\d_A-Z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Pattern of word boundaries in names like MotorVelocitySet."""
TAIL = re.compile(
    r"(?:[ _(\[-]+|(?<=[^\W\d_A-Z])(?=[A-Z]))(?i:"
    r"(rpm|rad_?p?s|deg_?p?s|rad[_/]s(?:ec)?|deg[_/]s(?:ec)?|rev_s|rps|hz|k?nm|k?w|u_?min|1_?min|1_s|pct|percent|%))[)\]]?$"
)
"""Pattern of a unit at the end of a name, for logs without separate units."""
TAILS: Mapping[str, str] = {
    "rads": "rad/s", "radps": "rad/s", "radsec": "rad/s", "degs": "deg/s", "degps": "deg/s", "degsec": "deg/s",
    "revs": "rev/s", "umin": "rpm", "1min": "rpm", "1s": "1/s", "hz": "Hz", "w": "W", "kw": "kW",
}  # fmt: skip


@functools.cache
def words() -> Mapping[str, frozenset[str]]:
    """Words of channel names in all languages, by meaning."""
    return {
        what: frozenset(word for language in languages.values() for word in language)
        for what, languages in words_of("channel_words").items()
    }


@dataclass(frozen=True)
class Named:
    """Unit and quantity of a channel (None if undetermined), meanings of its name (headings of channel_words.toml), why."""

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
    """Quantity of a unit; a frequency is a speed only if the channel's name means speed."""
    if unit in FREQUENCIES:
        return "speed" if tells & {"speed", "wanted"} else "frequency" if "frequency" in tells else "other"
    for quantity, known in QUANTITIES.items():
        if unit in known.factors:
            return quantity
    # A drive may report torque and speed in per cent of rated values, which the user must give.
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


RESTING = 1e-3
"""Largest range of a set point at rest, relative to its level."""
LAG_RATE_HZ = 20.0
LONGEST_LAG_S = 3.0
LEAST_CORRELATION = 0.3
SAME_SHAFT = 0.1
"""Medians of a speed and a set point of the same shaft differ by at most this fraction."""
WHOLE = 0.02
"""A pulse train counts as on the engine's shaft if its pulses per turn are within this distance of a whole number."""

Shaft = Literal["engine", "propeller"]


@dataclass
class Roles:
    """Channels by role, and one line with the reason for each channel."""

    named: Mapping[str, Named]
    set_point: str | None = None
    command: str | None = None
    """Command of an open-loop drive; only if no channel's name means a set point of speed."""
    torque: str | None = None
    location: Literal["gauge", "brake"] = "gauge"
    """Location of the torque."""
    located_by: str = (
        'a guess: between the inertias; "brake" before all inertia, of the engine or motor itself'
    )
    actuator: str | None = None
    load: str | None = None
    """Measured load of the machine, as power or torque."""
    speeds: dict[str, Shaft] = field(default_factory=dict)
    """Shaft of each channel with a speed or an encoder's angle."""
    trains: dict[str, float] = field(default_factory=dict)
    """Pulses per second of each pulse train."""
    pulses: dict[str, int] = field(default_factory=dict)
    """Pulses of each train per turn of the engine, if a recorded speed or set point determines them."""
    reasons: dict[str, str] = field(default_factory=dict)


def guess_roles(
    log: Log, pulse_rate: Callable[[str], float | None] = lambda _: None, set_point: str | None = None
) -> Roles:
    """Guess the role of each channel; `pulse_rate` returns the pulses per second of a pulse train, else None."""
    roles = named_roles(list(log.channels.values()), set_point)
    open_ = [
        name
        for name, given in roles.named.items()
        if given.is_open
        and name not in (roles.set_point, roles.torque)
        and not (given.quantity == "torque" or "wanted" in given.tells)
    ]
    rates = {name: pulse_rate(name) for name in open_}
    roles.trains = {name: rate for name, rate in rates.items() if rate is not None}
    for name, rate in roles.trains.items():
        roles.reasons[name] = f"pulse train, {rate:.4g} pulses a second"
    roles.speeds = {name: shaft for name, shaft in roles.speeds.items() if name not in roles.trains}
    if not (roles.set_point or roles.command or roles.load):
        _by_what_it_does(log, roles)
    if roles.load is None and (roles.set_point is None or _rests(log, roles.set_point)):
        _shaft_as_load(roles)
    _find_shafts(log, roles)
    return roles


def _rests(log: Log, name: str) -> bool:
    values = _coarse(log, name)
    return values is not None and float(np.ptp(values)) <= RESTING * float(np.abs(values).max())


def _shaft_as_load(roles: Roles) -> None:
    """Use the shaft's torque as the load if the engine's torque is recorded as well."""
    torques = [name for name, given in roles.named.items() if _role(given) == "torque"]
    shafts = [name for name in torques if "gauge" in roles.named[name].tells]
    engines = [name for name in torques if name not in shafts]
    if roles.command is None and len(shafts) == 1 and len(engines) == 1:
        roles.torque, roles.load = engines[0], shafts[0]
        roles.reasons[shafts[0]] = "load: torque of the shaft by its name, where the set point rests"
        roles.reasons[engines[0]] = roles.reasons[engines[0]].partition(";")[0]
        _locate(roles, engines[0])


def named_roles(channels: Sequence[Channel], set_point: str | None = None) -> Roles:
    """Assign roles by names and units alone."""
    roles = Roles({channel.name: named(channel) for channel in channels})
    wanted = set_points(roles.named)
    if set_point is not None:
        roles.set_point = set_point
        roles.reasons[set_point] = "set point as told"
    elif len(wanted) == 1:
        roles.set_point = wanted[0]
        roles.reasons[wanted[0]] = "set point by its name" + _and_unit(roles.named[wanted[0]])
    elif not wanted and len(commands := _commands(roles.named)) == 1:
        roles.command = commands[0]
        roles.reasons[commands[0]] = "command of a drive in open loop by its name, no set point being named"
    found: dict[str, list[str]] = {"torque": [], "load": [], "actuator": []}
    for name, given in roles.named.items():
        if name in roles.reasons:
            continue
        role = _role(given)
        if role == "speed":
            roles.speeds[name] = "engine"
        elif role in found:
            found[role].append(name)
        what = role.replace("_", " ")
        roles.reasons[name] = f"{what} by {_why(role, given)}" if role else "not known by name or unit"
    for name in wanted if roles.set_point is None else ():
        roles.reasons[name] = f"one of {len(wanted)} that may be the set point: {', '.join(wanted)}; choose"
    for role, names in found.items():
        # A channel whose name means a measured quantity takes precedence.
        ordered = sorted(names, key=lambda name: "measured" not in roles.named[name].tells)
        setattr(roles, role, ordered[0] if ordered else None)
        for other in ordered[1:]:
            roles.reasons[other] += f"; not used beside {ordered[0]}"
    if not (roles.set_point or roles.command or roles.speeds or wanted):
        _of_a_generator(roles)
    if roles.torque is not None:
        _locate(roles, roles.torque)
    return roles


def _of_a_generator(roles: Roles) -> None:
    """Use the frequency of a generating set as its speed, and a single power channel as its load."""
    turns = [name for name, given in roles.named.items() if given.quantity == "frequency"]
    powers = [name for name, given in roles.named.items() if given.quantity == "power"]
    if len(turns) != 1 or not (roles.load or len(powers) == 1):
        return
    roles.speeds[turns[0]] = "engine"
    roles.reasons[turns[0]] = f"speed of a generator by its name and {roles.named[turns[0]].by}"
    if roles.load is None:
        roles.load = powers[0]
        roles.reasons[powers[0]] = f"load by {roles.named[powers[0]].by}, beside a frequency"


def _commands(given: Mapping[str, Named]) -> list[str]:
    """Channels whose names mean a commanded torque, or a commanded position of the actuator, such as rack or throttle."""
    return [
        name
        for name, one in given.items()
        if "wanted" in one.tells
        and "measured" not in one.tells
        and (one.quantity == "torque" or "actuator" in one.tells)
    ]


def set_points(given: Mapping[str, Named]) -> list[str]:
    """Channels whose names mean a set point of speed; channels with a unit of speed take precedence."""
    wanted = {
        name: one
        for name, one in given.items()
        if "wanted" in one.tells
        and "measured" not in one.tells
        and (one.quantity == "speed" or (one.quantity is None and _may_ask(one)) or one.unit == "%")
    }
    # Since PitchFeedback is not a speed, PitchCommand is not the set point of a speed.
    others = {
        _stem(name) for name, one in given.items() if "measured" in one.tells and one.quantity != "speed"
    }
    wanted = {n: one for n, one in wanted.items() if one.quantity == "speed" or _stem(n) not in others - {""}}
    sure = [name for name, one in wanted.items() if one.quantity == "speed" and one.unit in TO_RPM]
    return sure or [name for name, one in wanted.items() if one.quantity == "speed"] or list(wanted)


def _stem(name: str) -> str:
    """Words of a name except those that mean a demand or a measurement."""
    alone = re.findall(r"[^\W_]+", WORD_ENDS.sub(" ", name).casefold())
    return " ".join(word for word in alone if not _told_by(word) & {"wanted", "measured"})


def _may_ask(given: Named) -> bool:
    """Whether a channel with an electrical unit may be a set point of speed; a current [A] is not."""
    return given.is_open and given.unit != "A"


def _role(given: Named) -> str:
    """Role by name and unit; empty if they do not determine it."""
    wanted = "wanted" in given.tells and "measured" not in given.tells
    if given.quantity in ("torque", "power") and not given.is_open and "load" in given.tells and not wanted:
        return "load"
    if given.quantity == "torque":
        return "" if wanted else "torque"
    if given.quantity == "speed" or (given.quantity == "angle" and "measured" in given.tells):
        return "" if wanted else "speed"
    if given.quantity is None and "pulses" in given.tells:
        return "pulse_train"
    return "actuator" if "actuator" in given.tells and given.quantity != "power" else ""


def _why(role: str, given: Named) -> str:
    return given.by if role == "speed" or role not in given.tells else "its name" + _and_unit(given)


def _and_unit(given: Named) -> str:
    return "" if given.quantity in (None, "other") or given.is_open else f" and its unit {given.unit!r}"


def _locate(roles: Roles, torque: str) -> None:
    tells = roles.named[torque].tells
    if "brake" in tells and "gauge" not in tells:
        roles.location, roles.located_by = "brake", "of the engine or motor, by its name"
    elif "gauge" in tells:
        roles.located_by = "of the shaft, by its name"
    elif roles.named[torque].unit == "%":
        roles.location, roles.located_by = (
            "brake",
            "of the engine or motor, which alone tells a share of its rating",
        )


def _by_what_it_does(log: Log, roles: Roles) -> None:
    """Find the set point among channels with a suitable name or unit: other channels follow its changes."""
    wanted = set_points(roles.named)
    may_be = wanted or [
        name
        for name, given in roles.named.items()
        if name not in roles.trains
        and "measured" not in given.tells
        and (given.quantity == "speed" or (given.quantity is None and _may_ask(given)))
    ]
    found = {name: _coarse(log, name) for name in log.channels if name not in roles.trains}
    coarse = {name: values for name, values in found.items() if values is not None}
    count = min((len(values) for values in coarse.values()), default=0)
    if len(coarse) < 2 or count < 10 * LAG_RATE_HZ:
        return
    steps = {name: np.diff(values[:count]) for name, values in coarse.items()}
    leads = dict.fromkeys(steps, 0)
    for one in steps:
        for two in steps:
            if one < two and (lag := _lag(steps[one], steps[two])) is not None and lag != 0:
                first, second = (one, two) if lag > 0 else (two, one)
                leads[first] += 1
                leads[second] -= 10
    best = max((name for name in may_be if name in leads), key=leads.__getitem__, default=None)
    if best is None or leads[best] < 1:
        return
    roles.set_point = best
    roles.speeds.pop(best, None)
    follow = "1 other channel follows" if leads[best] == 1 else f"{leads[best]} other channels follow"
    roles.reasons[best] = f"set point by what it does: {follow} its changes"


def _lag(one: Array, two: Array) -> int | None:
    """Lag of the second signal behind the first [samples]; None if they are uncorrelated."""
    most = round(LONGEST_LAG_S * LAG_RATE_HZ)
    scale = float(np.linalg.norm(one) * np.linalg.norm(two))
    if not scale > 0.0:
        return None
    lags = list(range(-most, most + 1))
    found = [
        float(np.dot(one[max(-k, 0) : len(one) - max(k, 0)], two[max(k, 0) : len(two) - max(-k, 0)]))
        for k in lags
    ]
    place = int(np.argmax(np.abs(found)))
    return lags[place] if abs(found[place]) > LEAST_CORRELATION * scale else None


def _coarse(log: Log, name: str) -> Array | None:
    channel = log.channels[name]
    block = round(channel.rate_hz / LAG_RATE_HZ)
    if block < 1 or channel.samples < 2 * block:
        return None
    values = block_means(log, name, block)
    return bridge(values) if np.isfinite(values).sum() >= 2 else None


def _find_shafts(log: Log, roles: Roles) -> None:
    """Decide which speeds are of the set point's shaft, and calculate the pulses per turn of each train."""
    asked = None if roles.set_point is None else _typical_rpm(log, roles, roles.set_point)
    given = {name: _typical_rpm(log, roles, name) for name in roles.speeds}
    known = {name: rpm for name, rpm in given.items() if rpm is not None}
    engine = asked if asked is not None else max(known.values(), default=None)
    if engine is None or engine == 0.0:
        return
    same = [name for name, rpm in known.items() if abs(rpm / engine - 1.0) < SAME_SHAFT]
    for name, rpm in known.items():
        if name in same or rpm == 0.0:
            continue
        gear = f"{engine / rpm:.3g} turns of the engine to one of it"
        if same:
            del roles.speeds[name]
            roles.reasons[name] += f"; {gear}: not used, since no vessel file tells the gear"
        else:
            roles.speeds[name] = "propeller"
            roles.reasons[name] += f"; {gear}"
    for name, pulses_hz in roles.trains.items():
        count = pulses_hz / (known[same[0]] if same else engine) * 60.0
        if count > 0.5 and abs(count / round(count) - 1.0) < WHOLE:
            roles.pulses[name] = round(count)


def _typical_rpm(log: Log, roles: Roles, name: str) -> float | None:
    """Median magnitude of a channel with a unit of speed [rpm]."""
    factor = TO_RPM.get(roles.named[name].unit)
    channel = log.channel(name)
    if factor is None or channel.samples < 2:
        return None
    values = block_means(log, name, max(min(round(channel.rate_hz), channel.samples // 2), 1))
    return abs(float(np.nanmedian(values))) * factor if np.isfinite(values).any() else None
