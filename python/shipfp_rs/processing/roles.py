"""What the channels of a log are: set point, torque, speed, actuator, load, pulse trains, by name and by what they do."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.coarse import block_means, bridged
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import TO_NM, TO_RPM, TO_W

NAMES: Mapping[str, str] = {
    "set_point": r"set[ _-]?point|n[ _-]?set|setp|soll|sollwert|f[üu]hrungsgr|gewenst|wenswaarde|consigne|b[øo]rv[æa]rde|"
    r"referansetall|setpunt|consigna|riferimento|zadana|asetusarvo|ayar|задан|requested|desired|demand|command|"
    r"speed ?ref|lever|hendel",
    "load": r"load|last|generator|alternator|belasting|dynamo|grid|netz",
    "torque": r"torq|moment|koppel|couple|torsion|strain|dehnung|rek$|coppia|par[ _]motor|vridmoment|"
    r"dreiemoment|drejningsmoment|"
    r"wej?wn|v[äa][äa]nt[öo]|tork|крутящ",
    "actuator": r"rack|fuel|kraftstoff|f[üu]llung|brandstof|carburant|br[æa]n[ds]el|combustible|carburante|paliwo|"
    r"polttoaine|yak[ıi]t|"
    r"топлив|throttle|gas(?:hendel|pedal)|drossel|current|strom$|stroom$|courant",
    "speed": r"speed|drehzahl|toeren|toerental|r[ée]gime|vitesse|omdrejning|turtall|varvtal|velocidad|velocit[àa]|giri|"
    r"obroty|kierros|devir|оборот|rpm|tacho|n[ _]?(?:e|eng|engine|motor|s|shaft)$",
}
"""Parts of names in the languages of yards and loggers, without regard to case; the first that fits counts."""
LOAD_UNITS = TO_W.keys() | TO_NM.keys()
"""Units of a load. The load on an engine's bus, in per cent, is not that of a shaft."""
LAG_RATE_HZ = 20.0
LONGEST_LAG_S = 3.0
LEAST_CORRELATION = 0.3


@dataclass
class Roles:
    """Channels by role, and why, one line each."""

    set_point: str | None = None
    torque: str | None = None
    actuator: str | None = None
    load: str | None = None
    """Channel of the load that the machine drives, as power or torque."""
    speeds: list[str] = field(default_factory=list)
    reasons: dict[str, str] = field(default_factory=dict)


def set_point_of(log: Log) -> str:
    """Return the one channel whose name says that it is a set point; `InputError` where there is none or several."""
    named = [name for name in log.channels if re.search(NAMES["set_point"], name, re.IGNORECASE)]
    if len(named) != 1:
        raise InputError(
            f"{log.name}: {'several channels are' if named else 'no channel is'} called a set point, found "
            f"{', '.join(named or log.channels)}; name it with --set-point"
        )
    return named[0]


def guess_roles(log: Log, trains: Mapping[str, float], set_point: str | None = None) -> Roles:
    """Guess what each channel is.

    Parameters
    ----------
    log
        The recording.
    trains
        Its pulse trains, with pulses per second.
    set_point
        Its set point, where the user says.
    """
    roles = Roles()
    named: dict[str, list[str]] = {role: [] for role in NAMES}
    for name, channel in log.channels.items():
        if name in trains:
            roles.reasons[name] = f"pulse train, {trains[name]:.4g} pulses a second"
            continue
        role = next(
            (
                role
                for role, words in NAMES.items()
                if re.search(words, name, re.IGNORECASE) and (role != "load" or channel.unit in LOAD_UNITS)
            ),
            None,
        )
        if role is None:
            role = (
                "torque"
                if channel.unit in TO_NM
                else "speed"
                if channel.unit in TO_RPM and channel.unit != "Hz"
                else None
            )
            why = f"its unit {channel.unit!r}"
        else:
            why = "its name"
        if role is not None:
            named[role].append(name)
            roles.reasons[name] = f"{role.replace('_', ' ')} by {why}"
        else:
            roles.reasons[name] = "not known by name or unit"
    if set_point is not None:
        roles.set_point = set_point
        roles.reasons[set_point] = "set point as told"
    else:
        roles.set_point = _only(named["set_point"], "set point", roles) or _leader(log, trains, named, roles)
    for role in ("torque", "actuator", "load"):
        chosen = _only([name for name in named[role] if name != roles.set_point], role, roles)
        setattr(roles, role, chosen)
    roles.speeds = [
        name for name in named["speed"] if name != roles.set_point and log.channels[name].unit in TO_RPM
    ]
    return roles


def _only(names: list[str], role: str, roles: Roles) -> str | None:
    if len(names) > 1:
        for name in names:
            roles.reasons[name] = f"one of {len(names)} that may be the {role}: {', '.join(names)}; choose"
    return names[0] if len(names) == 1 else None


def _leader(
    log: Log, trains: Mapping[str, float], named: Mapping[str, list[str]], roles: Roles
) -> str | None:
    """Return the channel whose changes come before those of all others that follow it."""
    if named["set_point"]:
        return None
    found = {name: _coarse(log, name) for name in log.channels if name not in trains}
    coarse = {name: values for name, values in found.items() if values is not None}
    count = min((len(values) for values in coarse.values()), default=0)
    if len(coarse) < 2 or count < 10 * LAG_RATE_HZ:
        return None
    steps = {name: np.diff(values[:count]) for name, values in coarse.items()}
    leads = dict.fromkeys(steps, 0)
    for one in steps:
        for two in steps:
            if one < two and (lag := _lag(steps[one], steps[two])) is not None and lag != 0:
                first, second = (one, two) if lag > 0 else (two, one)
                leads[first] += 1
                leads[second] -= 10
    best = max(leads, key=leads.__getitem__)
    if leads[best] < 1:
        return None
    roles.reasons[best] = f"set point by what it does: {leads[best]} other channels follow its changes"
    return best


def _lag(one: Array, two: Array) -> int | None:
    """Samples by which the second follows the first; None where they are not correlated."""
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
    return bridged(values) if np.isfinite(values).sum() >= 2 else None
