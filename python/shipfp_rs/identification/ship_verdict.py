"""Elements and verdict of a ship: what acts, what the fingerprint can be used for, in typed rows and in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from shipfp_rs.identification.estimate import KNOWN, Estimate
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.question import BOUNDS, TRIED
from shipfp_rs.identification.ship_found import ShipFit
from shipfp_rs.identification.usability import Usability, listed, usability
from shipfp_rs.identification.verdict import shown
from shipfp_rs.structures.elements import ELEMENTS

OFF_S = 1e-3
"""A delay whose interval begins below this may be none [s]."""
SHORT_S = 0.02
"""A delay that may be none and is at most this is called off [s]."""

BENT = (
    "Usable for simulation and comparison, but its intervals hold for the model, not for the drive train: they agree only "
    "if the channels are wrong by more than a calibration leaves open."
)
JAGGED = (
    "Usable for simulation and comparison, but its intervals are too narrow: the rate of the fuel rack is limited, and the "
    "deviance of such a ship is not smooth."
)
ALWAYS = ("tau_n", "g", "p", "vK_p", "vK_i")
"""Parameters that are off on no ship, so that an end of what is searched is no value of theirs."""
AT_BOUND = 1e-6
UNDECIDED = 6.0
"""Fall of the deviance from which an element fitted along may act: chance gives it once in 20 with two parameters."""


def element_rows(fit: ShipFit, parameters: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    """Return each element's state: on, open or off by what its interval says, with an upper limit where it is not on."""
    rows: dict[str, dict[str, Any]] = {}
    for name in ("dead_time_loop", "dead_time_set_point", "actuator_lag"):
        parameter = ELEMENTS[name].parameters[0]
        estimate = parameters.get(parameter.name)
        if estimate is None or estimate.ci95 is None:
            continue
        low, high = estimate.ci95
        state = "on" if low > OFF_S else "off" if high <= SHORT_S else "open"
        limit = None if state == "on" else _limit(parameter.name, high, parameter.unit)
        rows[name] = _row(name, state, limit)
    for name in TRIED:
        told = parameters.get(TRIED[name][0])
        acts = told is not None and told.status != "unidentifiable" and TRIED[name][0] not in fit.along
        if acts or name in fit.question.tried:
            undecided = TRIED[name][0] in fit.along and fit.gains[name] > UNDECIDED
            state = "on" if acts else "open" if undecided else "off"
            rows[name] = _row(name, state, None, fit.gains.get(name))
    if fit.question.loaded:
        rows["load"] = _row("load", "on", None)
    # A governor's clock is seen in the raw torque or not at all: half its period is part of T_d either way.
    clocks = [one.governor_clock[0] for one in fit.question.experiments if one.governor_clock]
    if clocks:
        rows["sampling"] = _row("sampling", "open", _limit("T_s", float(np.median(clocks)), "s"))
    elif "dead_time_loop" in rows and rows["dead_time_loop"]["state"] != "off":
        delay = parameters["T_d"].ci95
        assert delay is not None
        rows["sampling"] = _row("sampling", "open", _limit("T_s", 2.0 * delay[1], "s"))
    return rows


def _is_on_bound(name: str, estimate: Estimate) -> bool:
    """Whether a parameter that no ship lacks stands at an end of what is searched."""
    if name not in ALWAYS or estimate.status not in KNOWN or estimate.value is None:
        return False
    low, high = BOUNDS[name]
    return min(estimate.value - low, high - estimate.value) <= AT_BOUND * (high - low)


def _row(
    name: str, state: str, limit: dict[str, Any] | None, evidence: float | None = None
) -> dict[str, Any]:
    return {"state": state, "evidence": evidence, "limit": limit, "words": ELEMENTS[name].words}


def _limit(name: str, value: float, unit: str) -> dict[str, Any]:
    return {"parameter": name, "value": float(value), "unit": unit, "level": 0.95}


def with_verdict(fingerprint: Fingerprint, strain: float = 0.0) -> Fingerprint:
    """Return the fingerprint with what it can be used for, and the sentences about it; strain: of `adequacy`."""
    found = usability(fingerprint)
    ended = [name for name, one in fingerprint.parameters.items() if _is_on_bound(name, one)]
    if ended and found.state != "not usable":
        because = (
            f"the search ended where {listed(ended)} can't go further; the ship is another one than the model"
        )
        found = Usability("not usable", f"Not usable, because {because}.", "misfit")
    elif strain > 1.0 and found.state == "usable":
        found = replace(found, state="usable except", sentence=BENT)
    elif fingerprint.elements.get("rack_rate", {}).get("state") == "on" and found.state == "usable":
        found = replace(found, state="usable except", sentence=JAGGED)
    known = [name for name, one in fingerprint.parameters.items() if one.status in KNOWN]
    lines = [found.sentence]
    if known and found.state != "not usable":
        lines.append("Known: " + "; ".join(shown(name, fingerprint.parameters[name]) for name in known) + ".")
    if fingerprint.derived and found.state != "not usable":
        lines.append(
            "Known together: " + "; ".join(shown(*item) for item in fingerprint.derived.items()) + "."
        )
    for name, one in fingerprint.parameters.items():
        if one.status == "unidentifiable":
            lines.append(f"Not identifiable from these data: {name} ({one.reason}).")
    by_state: dict[str, list[str]] = {"on": [], "off": [], "open": []}
    for name, row in fingerprint.elements.items():
        if name == "sampling":
            continue
        limit = row["limit"]
        bound = f" ({limit['parameter']} below {limit['value']:.3g} {limit['unit']}, 95 %)" if limit else ""
        by_state[row["state"]].append(row["words"] + bound)
    for state, said in (("on", "Acting elements"), ("off", "Not found to act"), ("open", "Undecided")):
        if by_state[state]:
            lines.append(f"{said}: " + ", ".join(by_state[state]) + ".")
    if "sampling" in fingerprint.elements:
        lines.append("T_d holds half the sampling period of the governor, if it samples.")
    return replace(
        fingerprint,
        usable=found.sentence,
        usability=found.state,
        why_not=found.why_not,
        verdict=tuple(lines),
    )
