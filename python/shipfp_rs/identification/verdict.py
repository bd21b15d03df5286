"""States of a ship's elements, and plain sentences on the uses of a fingerprint and on what the data do not determine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.adequacy import missed_pct
from shipfp_rs.identification.estimate import KNOWN, OPEN, Estimate, is_rough, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint, Identifiability
from shipfp_rs.identification.fingerprint_content import ALARM
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.ship_found import BELIEVED, ShipFit
from shipfp_rs.identification.usability import Case, usability
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.names import OF_WHAT
from shipfp_rs.support.sentences import Sentence, joined
from shipfp_rs.support.units import unit_shown

SMALL_PCT = 0.1
"""Misfit [% of an output's spread] up to which the structure is not faulted: no sensor of a ship is more accurate."""
SHORT_S = 0.02
"""A delay counts as absent ("off") if its interval includes zero and ends at or below this value [s]."""
AT_THE_METER = Sentence(
    "The measured load is the whole torque of the shaft, so the model ends at the torque meter: tau_n is the time constant "
    "of the inertia on the drive's side, and gains, margins and steps are those of the drive without its load. A record "
    "whose set point moves determines the whole drive train."
)
BEHIND_THE_METER = Sentence(
    "The measured load is the whole torque of the shaft, so the model ends at the torque meter: tau_n is the time constant "
    "of the inertia on the drive's side. The load's side of the meter was estimated from speed and this torque: {load}. "
    "Margins and the step response are those of drive and load together."
)
NO_TORQUE = Sentence(
    "A torque of the load acts with a gain k_L of 1, but {shown} was found: is the channel a torque? A pitch, a current or "
    'a valve is quantity = "other".'
)
PLAUSIBLE_LOAD = (0.5, 2.0)
"""Plausible range of the gain k_L of a measured load torque."""
STATES: Mapping[str, str] = {
    "on": Sentence("Acting elements: {elements}."),
    "off": Sentence("Not found to act: {elements}."),
    "open": Sentence("Undecided: {elements}."),
}
"""Sentence that lists the elements in each state."""
UNDECIDED = 6.0
"""Decrease of the deviance from which a searched element may act; with two parameters, chance causes it once in 20 times."""


class Told(NamedTuple):
    """A fingerprint without a verdict, and what its verdict needs; see `Case`."""

    fingerprint: Fingerprint
    experiments: Sequence[Experiment]
    strain: float = 0.0
    kind: str | None = None
    is_short: bool = False
    contradicted: bool = False  # whether residuals may contradict the structure


def with_verdict(told: Told) -> Fingerprint:
    """Return the fingerprint with its usability and verdict."""
    fingerprint, is_short, further = told.fingerprint, told.is_short, told.fingerprint.verdict
    # Without `adequate`, as for a frequency response, only too short records get a usability.
    if fingerprint.adequate or is_short:
        found = usability(Case(fingerprint, told.kind, told.strain, is_short))
        fingerprint = replace(
            fingerprint, usable=found.sentence, usability=found.state, why_not=found.why_not
        )
    lines = (
        *([fingerprint.usable] if fingerprint.usable and fingerprint.why_not != "no minimum" else []),
        *_found(fingerprint, is_short),
        *_unknown(fingerprint.parameters),
        *_gaps(fingerprint.identifiability),
        *(_contradictions(fingerprint) if told.contradicted else ()),
        *_poor(fingerprint),
        *_elements(fingerprint),
    )
    return replace(fingerprint, verdict=(*lines, *further))


def _found(fingerprint: Fingerprint, is_short: bool) -> Iterator[str]:
    """Yield sentences on the results, most important first."""
    trouble, limit = fingerprint.settings.get("message"), fingerprint.adequate.get("limit")
    if trouble:
        yield Sentence(
            "The search did not end in a minimum, so take no figure for an estimate: {trouble}.",
            trouble=trouble,
        )
    if limit:
        yield _clear_of(limit)
    if far := fingerprint.behind_meter:
        yield Sentence(
            BEHIND_THE_METER, load=joined([shown(name, far[name]) for name in ("p", "tau_prop")], " and ")
        )
    elif fingerprint.ends_at_meter:
        yield AT_THE_METER
    yield from _no_torque(fingerprint)
    if fingerprint.usability == "not usable" and not trouble:
        return
    for line in known(fingerprint.parameters):
        doubted = is_short and line.template == "Known: {estimates}."
        yield (
            Sentence("Estimated, if the structure is right: {estimates}.", **line.values) if doubted else line
        )
    if fingerprint.derived:
        estimates = [shown(*item) for item in fingerprint.derived.items()]
        yield Sentence("Known together: {estimates}.", estimates=joined(estimates, "; "))


def known(parameters: Mapping[str, Estimate]) -> Iterator[Sentence]:
    """Yield sentences on known parameters, and on those whose interval is wider than the value."""
    found = {name: e for name, e in parameters.items() if e.status in KNOWN and e.value is not None}
    sure = [shown(name, e) for name, e in found.items() if not is_rough(e, OPEN)]
    unsure = [shown(name, e) for name, e in found.items() if is_rough(e, OPEN)]
    if sure:
        yield Sentence("Known: {estimates}.", estimates=joined(sure, "; "))
    if unsure:
        yield Sentence("Estimated, but hardly known: {estimates}.", estimates=joined(unsure, "; "))


def _unknown(parameters: Mapping[str, Estimate]) -> Iterator[str]:
    """Yield sentences on unknown parameters and on those at a bound."""
    for name, estimate in parameters.items():
        if estimate.status == "unidentifiable":
            yield not_identifiable(name, estimate)
    on_bound = {name: estimate for name, estimate in parameters.items() if estimate.status == "at_bound"}
    pressed = [_because(name, e) for name, e in on_bound.items() if e.ci95 is None]
    if pressed:
        yield Sentence(
            "At a bound, so not an estimate: {names}. The structure or the bounds do not suit the data. The other"
            " intervals hold only if these parameters have the values of their bounds.",
            names=joined(pressed),
        )
    limited = [_because(name, e) for name, e in on_bound.items() if e.ci95 is not None]
    if limited:
        yield Sentence(
            "At a bound that agrees with the data, so limited from one side only: {names}.",
            names=joined(limited),
        )


def not_identifiable(name: str, estimate: Estimate) -> Sentence:
    """Say that the data do not determine a parameter, and why."""
    return Sentence("Not identifiable from these data: {name}.", name=_because(name, estimate))


def _because(name: str, estimate: Estimate) -> Sentence:
    return Sentence("{name} ({reason})", name=name, reason=estimate.reason)


def _gaps(identifiability: Identifiability) -> Iterator[str]:
    """Yield sentences on directions that the data do not determine, and on further information that would determine them."""
    if identifiability.null_space:
        yield Sentence(
            "The data determine {rank} independent combinations of the {free} free parameters. The response does "
            "not change along: {directions}.",
            rank=identifiability.rank,
            free=identifiability.free,
            directions=joined([entry["combination"] for entry in identifiability.null_space], " / "),
        )
    if identifiability.closes_gap:
        yield Sentence(
            "Any of these, known from elsewhere (torsional calculation, factory test), would settle the rest: {names}.",
            names=joined(identifiability.closes_gap, "; "),
        )


def _poor(fingerprint: Fingerprint) -> Iterator[str]:
    """Yield a sentence if a structure explains the data poorly."""
    overall = fingerprint.fit.get("overall", {})
    chi_squared, freedom = overall.get("chi_squared"), overall.get("degrees_of_freedom")
    poor = []
    if chi_squared is not None and freedom is not None:
        # With known standard deviations, chi-squared is used instead of the fit [%], since some points may have no weight.
        if chi_squared > 2 * freedom:
            said = Sentence("chi-squared {value} at {freedom} degrees of freedom")
            poor = [Sentence(said, value=f"{chi_squared:.4g}", freedom=f"{freedom:.0f}")]
    elif fingerprint.adequate.get("sides") is None:
        poor = [
            Sentence("fit of {output} {share} %", output=output, share=f"{value:.1f}")
            for output, row in fingerprint.fit.items()
            if output != "overall" and (value := row["nrmse_pct"]) is not None and value < 60.0
        ]
    if poor:
        yield Sentence(
            "The structure {structure} explains the data poorly ({figures}): its intervals hold for the structure, not "
            "for the drive train.",
            structure=repr(fingerprint.structure["name"]),
            figures=joined(poor),
        )


def _contradictions(fingerprint: Fingerprint) -> list[str]:
    """Say where the residuals contradict the structure, or else the noise model."""
    rows = {output: row for output, row in fingerprint.fit.items() if output != "overall"}
    threshold, name = ALARM / len(rows), repr(fingerprint.structure["name"])
    follows = {
        output: _chance(p)
        for output, row in rows.items()
        if (p := row.get("input_correlation_p")) is not None and p < threshold
    }
    followed = [
        Sentence(
            "{output} ({chance}, it explains {share} % of the residuals)",
            output=output,
            chance=chance,
            share=f"{rows[output]['input_explained_pct']:.2g}",
        )
        for output, chance in follows.items()
        if missed_pct(rows[output]) > SMALL_PCT
    ]
    if follows and not followed:
        return [
            Sentence(
                "The residuals follow the set point in {outputs}, by less than {share} % of it: too little to matter.",
                outputs=joined([*follows]),
                share=f"{SMALL_PCT:g}",
            )
        ]
    if followed:
        return [
            Sentence(
                "The residuals contradict the structure {structure}: the set point still explains some of {outputs}. "
                "Dynamics are missing, a dead time for instance; the intervals hold for the structure, not for the drive "
                "train.",
                structure=name,
                outputs=joined(followed),
            )
        ]
    coloured = [
        Sentence("{output} ({chance})", output=output, chance=_chance(p))
        for output, row in rows.items()
        if (p := row.get("whiteness_p")) is not None and p < threshold
    ]
    if coloured:
        return [
            Sentence(
                "The noise is not what was assumed: whitened residuals are still correlated in {outputs}, so the intervals "
                "may be too narrow.",
                outputs=joined(coloured),
            )
        ]
    return []


def _chance(p: float) -> Sentence:
    return Sentence("p = {p}", p=f"{p:.1g}") if p > 1e-6 else Sentence("p < 1e-6")


def shown(name: str, estimate: Estimate) -> Sentence:
    """Return a parameter with value, interval and unit as a phrase."""
    assert estimate.value is not None
    (row,) = rounded_rows({name: estimate})
    spread: str = ""
    if estimate.ci95 is not None:
        spread = Sentence(" ({ends})", ends=Sentence("{low} to {high}", low=row.low, high=row.high))
    unit = unit_shown(estimate.unit) or Sentence(OF_WHAT.get(name, ""))
    text = "{name} = {value}{spread} {unit}" if unit else "{name} = {value}{spread}"
    return Sentence(text, name=name, value=row.value, spread=spread, unit=unit)


def element_rows(fit: ShipFit, parameters: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    """Return each element's state by its interval: on, open or off, with an upper limit unless it is on."""
    rows: dict[str, dict[str, Any]] = {}
    for name in (
        "dead_time_loop",
        "dead_time_set_point",
        "actuator_lag",
        "speed_filter",
        "engine_lag",
        "twist",
        "droop",
    ):
        parameter = ELEMENTS[name].parameters[0]
        estimate = parameters.get(parameter.name)
        if estimate is None or estimate.ci95 is None:
            continue
        low, high = estimate.ci95
        state = "on" if low > 0.0 else "off" if high <= SHORT_S else "open"
        limit = None if state == "on" else _limit(parameter.name, high, parameter.unit)
        rows[name] = _row(name, state, limit)
    for name in TRIED:
        told = parameters.get(TRIED[name][0])
        gain = fit.gains.get(name, np.inf)
        acts = told is not None and told.status != "unidentifiable" and gain > BELIEVED
        if name not in rows and (acts or name in fit.question.tried):
            # The decrease of the deviance by one limit changes once other limits act.
            gain = fit.scores[name].fall if name in fit.scores and name not in fit.elements else gain
            undecided = np.isfinite(gain) and gain > (UNDECIDED if name in fit.elements else BELIEVED)
            state = "on" if acts else "open" if undecided else "off"
            rows[name] = _row(name, state, None, gain if np.isfinite(gain) else None)
    if fit.question.loaded:
        rows["load"] = _row("load", "on", None)
        if any(one.load.get("quantity") == "other" for one in fit.question.experiments):
            rows["load"]["words"] = Sentence("measured load")
    # The fit cannot determine a governor's sampling period, since half the period is part of T_d.
    if "dead_time_loop" in rows and rows["dead_time_loop"]["state"] != "off":
        delay = parameters["T_d"].ci95
        assert delay is not None
        rows["sampling"] = _row("sampling", "open", _limit("T_s", 2.0 * delay[1], "s"))
    return rows


def _row(
    name: str, state: str, limit: dict[str, Any] | None, evidence: float | None = None
) -> dict[str, Any]:
    return {"state": state, "evidence": evidence, "limit": limit, "words": ELEMENTS[name].words}


def _limit(name: str, value: float, unit: str) -> dict[str, Any]:
    return {"parameter": name, "value": float(value), "unit": unit, "level": 0.95}


def _elements(fingerprint: Fingerprint) -> Iterator[str]:
    """Yield a sentence on the elements in each state."""
    rows = {name: row for name, row in fingerprint.elements.items() if name != "sampling"}
    for state, said in STATES.items():
        if found := [_element(row) for row in rows.values() if row["state"] == state]:
            yield Sentence(said, elements=joined(found))
    if "sampling" in fingerprint.elements:
        yield Sentence(
            "If the governor computes at intervals, half of such an interval is part of the dead time T_d."
        )


def _element(row: Mapping[str, Any]) -> Sentence:
    """Return an element's name, with its limit if it has one."""
    words, limit = Sentence(row["words"]), row["limit"]
    if not limit:
        return words
    return Sentence(
        "{element} ({parameter} below {value} {unit}, 95 %)",
        element=words,
        parameter=limit["parameter"],
        value=f"{limit['value']:.3g}",
        unit=limit["unit"],
    )


def _no_torque(fingerprint: Fingerprint) -> list[Sentence]:
    """Return a sentence if a load that is declared as a torque does not act as one."""
    gain = fingerprint.parameters.get("k_L")
    if (
        gain is None
        or gain.ci95 is None
        or any(row.get("load", {}).get("quantity") == "other" for row in fingerprint.data)
    ):
        return []
    low, high = gain.ci95
    outside = high < PLAUSIBLE_LOAD[0] or low > PLAUSIBLE_LOAD[1]
    return [Sentence(NO_TORQUE, shown=shown("k_L", gain))] if outside else []


def _clear_of(limit: Mapping[str, float]) -> Sentence:
    """Sentence on the torque that a limit removes, and on the amplitude at which the limit does not act."""
    level = "rate" if "rate" in limit else "M_max"
    return Sentence(
        "A limit of {name} at about {level} acts {share} % of the time and removes {removed} % of what the torque moves; "
        "with {amplitude} % of the amplitude the next trial stays clear of it.",
        name=Sentence("the actuator's rate" if level == "rate" else "the torque"),
        level=f"{limit[level]:.3g}" + (" 1/s" if level == "rate" else ""),
        **{name: f"{100.0 * limit[name]:.2g}" for name in ("share", "removed", "amplitude")},
    )
