"""States of a ship's elements, and plain sentences on what a fingerprint can be used for and what the data do not tell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from shipfp_rs.identification.estimate import KNOWN, OPEN, Estimate, is_rough, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint, Identifiability
from shipfp_rs.identification.fingerprint_content import ALARM
from shipfp_rs.identification.fit_statistics import missed_pct
from shipfp_rs.identification.question import BOUNDS, PRIORS, TRIED, within_reach
from shipfp_rs.identification.ship_found import BELIEVED, ShipFit
from shipfp_rs.identification.sides import KINDS
from shipfp_rs.identification.usability import Usability, misfit, usability
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.names import OF_WHAT
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.sentences import Sentence, joined, listed
from shipfp_rs.support.units import unit_shown

SMALL_PCT = 0.1
"""Misfit, in per cent of an output's spread, that is no fault of the structure: no sensor of a ship is more accurate."""


def verdict(
    parameters: Mapping[str, Estimate],
    derived: Mapping[str, Estimate],
    identifiability: Identifiability,
    fit: Mapping[str, Mapping[str, float | None]],
    structure: Structure,
    trouble: str = "",
    *,
    contradicted: bool = True,
) -> tuple[str, ...]:
    """Return the sentences of the verdict, most important first.

    `trouble` is why the search did not reach a minimum; `contradicted`: whether residuals may contradict the structure.
    """
    lines = [
        *(
            [
                Sentence(
                    "The search did not end in a minimum, so take no figure for an estimate: {trouble}.",
                    trouble=trouble,
                )
            ]
            if trouble
            else []
        ),
        *_known(parameters, derived),
        *_unknown(parameters),
        *_gaps(identifiability),
        *(_contradictions(fit, structure) if contradicted else ()),
    ]
    if poor := _poor(fit):
        lines.append(
            Sentence(
                "The structure {structure} explains the data poorly ({figures}): its intervals hold for the structure, not "
                "for the drive train.",
                structure=repr(structure.name),
                figures=joined(poor),
            )
        )
    return tuple(lines)


def _known(parameters: Mapping[str, Estimate], derived: Mapping[str, Estimate]) -> Iterator[str]:
    yield from known(parameters)
    together = [shown(name, estimate) for name, estimate in derived.items()]
    if together:
        yield Sentence("Known only together: {estimates}.", estimates=joined(together, "; "))


def known(parameters: Mapping[str, Estimate]) -> Iterator[Sentence]:
    """Yield known parameters, and separately those whose interval is wider than the value."""
    found = {name: e for name, e in parameters.items() if e.status in KNOWN and e.value is not None}
    sure = [shown(name, e) for name, e in found.items() if not is_rough(e, OPEN)]
    unsure = [shown(name, e) for name, e in found.items() if is_rough(e, OPEN)]
    if sure:
        yield Sentence("Known: {estimates}.", estimates=joined(sure, "; "))
    if unsure:
        yield Sentence("Estimated, but hardly known: {estimates}.", estimates=joined(unsure, "; "))


def _unknown(parameters: Mapping[str, Estimate]) -> Iterator[str]:
    """Yield unknown parameters and those on a bound."""
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
    """Yield what the data can't distinguish, and what would settle it."""
    if identifiability.rank < identifiability.free:
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


def _poor(fit: Mapping[str, Mapping[str, float | None]]) -> list[str]:
    """Figures of a fit that explains the data poorly."""
    overall = fit.get("overall", {})
    chi_squared, freedom = overall.get("chi_squared"), overall.get("degrees_of_freedom")
    if chi_squared is not None and freedom is not None:
        # With known deviations chi-squared is better than per cent, since some points may have no weight.
        poor = chi_squared > 2 * freedom
        told = Sentence(
            "chi-squared {value} at {freedom} degrees of freedom",
            value=f"{chi_squared:.4g}",
            freedom=f"{freedom:.0f}",
        )
        return [told] if poor else []
    rows = {output: row["nrmse_pct"] for output, row in fit.items() if output != "overall"}
    return [
        Sentence("fit of {output} {share} %", output=output, share=f"{value:.1f}")
        for output, value in rows.items()
        if value is not None and value < 60.0
    ]


def structure_test(tests: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Return the joint test of the structure by the residuals of all outputs; empty without residual tests.

    "structure_p" is the outputs' least p-value times their number (Bonferroni). "structure_misses_pct"
    is the largest share of an output's residual that the set point explains [%]: on long records a structure may be
    rejected though what it lacks is small.
    """
    found = [p for row in tests.values() if (p := row.get("input_correlation_p")) is not None]
    if not found:
        return {}
    missed = max(row.get("input_explained_pct") or 0.0 for row in tests.values())
    return {"structure_p": min(1.0, len(found) * min(found)), "structure_misses_pct": missed}


def _contradictions(fit: Mapping[str, Mapping[str, float | None]], structure: Structure) -> list[str]:
    """Say where the residuals contradict the structure, or else the noise model."""
    threshold = ALARM / len(structure.outputs)
    rows = {output: row for output, row in fit.items() if output in structure.outputs}
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
                structure=repr(structure.name),
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


SHORT_S = 0.02
"""Largest value of a delay that may be zero, for it to be called off [s]."""

BENT = Sentence(
    "Usable for simulation and comparison, but not for control tuning: its intervals hold for the model, not for the drive "
    "train; both agree only if the channels are wrong by more than a calibration allows."
)
LIMITED = Sentence(
    "Usable for simulation and comparison, but not for control tuning: a limit of torque or rate acts, and on simulated "
    "ships with such a limit fewer than nine intervals in ten held the true value."
)
LOAD_ONLY = Sentence(
    "Usable for simulation and comparison of the load's side only: drive and governor are not described ({what}), so "
    "gains, delays and the slope of the drive's torque are not given."
)
NO_GAUGE = Sentence(
    "Usable for simulation and comparison, but not for control tuning: the torque is hardly a gauge's, since {share} % of "
    "the inertia would lie behind it. If it is the drive's own, say torque = brake: tau_n and the gains are now too large "
    "by about {over} %."
)
BEHIND_A_GAUGE = 0.9
"""Share of the inertia behind the sensor, above which a torque called gauge is probably the brake's: brake torques show 0.95
to 1, gauges of the test ships up to 0.7."""
TO_THE_METER = Sentence(
    "Usable for simulation and comparison, but not for control tuning: the model ends at the load's torque meter."
)
AT_THE_METER = Sentence(
    "The load is all the torque of a shaft, so the model ends at its meter: tau_n is the inertia before it, and gains, "
    "margins and steps are those of the drive without its load. A record whose set point moves tells the whole ship."
)
BEHIND_THE_METER = Sentence(
    "The load is all the torque of a shaft, so the model ends at its meter: tau_n is the inertia before it. By speed and "
    "this torque alone, what lies behind it has {load}; the loop's figures are those of the whole ship."
)
NO_TORQUE = Sentence(
    "A torque of the load acts with a gain k_L of 1, but {shown} was found: is the channel a torque? A pitch, a current or "
    'a valve is quantity = "other".'
)
PLAUSIBLE_LOAD = (0.5, 2.0)
"""Range of the gain of a measured torque of the load."""
STATES: Mapping[str, str] = {
    "on": Sentence("Acting elements: {elements}."),
    "off": Sentence("Not found to act: {elements}."),
    "open": Sentence("Undecided: {elements}."),
}
"""Sentence that lists the elements in each state."""
ALWAYS = ("tau_n", "g", "p", "vK_p", "vK_i")
"""Parameters of every ship; a value at the end of the search range is not plausible for them."""
AT_BOUND = 1e-6
UNDECIDED = 6.0
"""Decrease of the deviance from which a searched element may act; chance gives it once in 20 with two parameters."""


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
        if acts or name in fit.question.tried:
            # The decrease by a limit changes once others act.
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


def _is_on_bound(name: str, estimate: Estimate) -> bool:
    """Whether a parameter that every ship has is at an end of the search range."""
    if name not in ALWAYS or estimate.status not in KNOWN or estimate.value is None:
        return False
    low, high = within_reach(BOUNDS[name], PRIORS.get(name))
    return min(estimate.value - low, high - estimate.value) <= AT_BOUND * (high - low)


def _row(
    name: str, state: str, limit: dict[str, Any] | None, evidence: float | None = None
) -> dict[str, Any]:
    return {"state": state, "evidence": evidence, "limit": limit, "words": ELEMENTS[name].words}


def _limit(name: str, value: float, unit: str) -> dict[str, Any]:
    return {"parameter": name, "value": float(value), "unit": unit, "level": 0.95}


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


def _is_limited(fingerprint: Fingerprint) -> bool:
    """Whether a limit of torque or rate acts."""
    return any(
        fingerprint.elements.get(name, {}).get("state") == "on" for name in TRIED if name != "set_rate"
    )


def _no_torque(fingerprint: Fingerprint) -> list[Sentence]:
    """Say that a load declared as a torque does not act as one."""
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
    """Say what a limit removes, and the amplitude that stays clear of it."""
    level = "rate" if "rate" in limit else "M_max"
    return Sentence(
        "A limit of {name} at about {level} acts {share} % of the time and removes {removed} % of what the torque moves; "
        "with {amplitude} % of the amplitude the next trial stays clear of it.",
        name=Sentence("the actuator's rate" if level == "rate" else "the torque"),
        level=f"{limit[level]:.3g}" + (" 1/s" if level == "rate" else ""),
        **{name: f"{100.0 * limit[name]:.2g}" for name in ("share", "removed", "amplitude")},
    )


def _behind(fingerprint: Fingerprint) -> float:
    """Return the share of the inertia behind the gauge; 0 for a brake torque."""
    behind, whole = (fingerprint.parameters.get(name) for name in ("tau_prop", "tau_n"))
    if "tau_prop" not in fingerprint.load_side or behind is None or whole is None:
        return 0.0
    return (behind.value or 0.0) / (whole.value or np.inf)


def with_verdict(fingerprint: Fingerprint, strain: float = 0.0, kind: str | None = None) -> Fingerprint:
    """Return the fingerprint with its usability and verdict.

    `strain` is that of `adequacy`; `kind` is the contradiction, of `sides.KINDS`, to the model's drive and governor.
    """
    found = usability(fingerprint)
    if kind is not None:
        what = misfit(fingerprint) if kind == "misfit" else KINDS[kind]
        if found.state != "not usable" or fingerprint.load_side:
            found = Usability("usable except", Sentence(LOAD_ONLY, what=what))
    ended = [name for name, one in fingerprint.parameters.items() if _is_on_bound(name, one)]
    if ended and found.state != "not usable":
        sentence = Sentence(
            "Not usable, because the search ended at a bound of {names}; the model does not describe this ship.",
            names=listed(ended),
        )
        found = Usability("not usable", sentence, "misfit")
    elif kind is None and found.state != "not usable" and (share := _behind(fingerprint)) > BEHIND_A_GAUGE:
        share = min(share, 1.0)
        figures = {"share": f"{100.0 * share:.0f}", "over": f"{100.0 / share - 100.0:.1f}"}
        found = Usability("usable except", Sentence(NO_GAUGE, **figures))
    elif kind is None and found.state == "usable" and fingerprint.ends_at_meter:
        found = Usability("usable except", TO_THE_METER)
    elif kind is None and strain > 1.0 and found.state == "usable":
        found = replace(found, state="usable except", sentence=BENT)
    elif _is_limited(fingerprint) and found.state == "usable":
        found = replace(found, state="usable except", sentence=LIMITED)
    limit = fingerprint.adequate.get("limit")
    lines = [
        found.sentence,
        *([_clear_of(limit)] if limit else []),
        *([AT_THE_METER] if fingerprint.ends_at_meter else []),
        *_no_torque(fingerprint),
    ]
    lines += [] if found.state == "not usable" else known(fingerprint.parameters)
    if fingerprint.derived and found.state != "not usable":
        estimates = [shown(*item) for item in fingerprint.derived.items()]
        lines.append(Sentence("Known together: {estimates}.", estimates=joined(estimates, "; ")))
    for name, one in fingerprint.parameters.items():
        if one.status == "unidentifiable":
            lines.append(not_identifiable(name, one))
    by_state: dict[str, list[str]] = {"on": [], "off": [], "open": []}
    for name, row in fingerprint.elements.items():
        if name == "sampling":
            continue
        by_state[row["state"]].append(_element(row))
    for state, said in STATES.items():
        if by_state[state]:
            lines.append(Sentence(said, elements=joined(by_state[state])))
    if "sampling" in fingerprint.elements:
        lines.append(
            Sentence(
                "If the governor computes at intervals, half of such an interval is part of the dead time T_d."
            )
        )
    return replace(
        fingerprint,
        usable=found.sentence,
        usability=found.state,
        why_not=found.why_not,
        verdict=tuple(lines),
    )
