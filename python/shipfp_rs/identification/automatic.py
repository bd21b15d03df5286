"""From the data's choice of a structure to a fingerprint: intervals that hold after the choice, and what is missed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.choose import Choice, State
from shipfp_rs.identification.chooser import Chooser
from shipfp_rs.identification.estimate import KNOWN
from shipfp_rs.identification.estimates import estimates
from shipfp_rs.identification.fingerprint import ALARM, Estimate, Fingerprint
from shipfp_rs.identification.fitted import Fitted
from shipfp_rs.identification.gates import is_loaded
from shipfp_rs.identification.promise import Neglect
from shipfp_rs.identification.residual_tests import INPUT_LAGS, input_dispersion
from shipfp_rs.identification.sampling import clock_of
from shipfp_rs.identification.usability import SMALL_MISS_PCT, misses_of, usability
from shipfp_rs.identification.verdict import shown
from shipfp_rs.identification.wording import something_missing
from shipfp_rs.structures.combinations import slope_of
from shipfp_rs.structures.elements import ELEMENTS, SHORTEST_S
from shipfp_rs.structures.outputs import Torque
from shipfp_rs.support.quantiles import DEVIATIONS_95

SIGNALS: Mapping[str, Torque] = {"M_g": "gauge", "M_s": "brake", "M_b": "brake"}
"""Torque signals, the best one first, with the side of the inertia that each is read on."""


def chooser_of(
    experiments: Sequence[Experiment],
    *,
    torque: Torque | None,
    outputs: Sequence[str] | None,
    elements: Mapping[str, bool],
    narrow: Mapping[str, Mapping[str, object]],
    search: Mapping[str, object],
) -> Chooser:
    """Return what fits structures to the experiments, with the outputs that all of them measured.

    Raises
    ------
    InputError
        Where no speed was measured, or an unknown element is forced on or off.
    """
    for name in elements:
        if name not in ELEMENTS:
            raise InputError(f"elements: no {name!r}, expected some of {', '.join(ELEMENTS)}")
    common = set.intersection(*(set(experiment.signals) for experiment in experiments))
    if not common & {"n_e", "n_s"}:
        raise InputError("identify: no experiment has a speed, expected the signal n_e or n_s")
    located = torque or next((side for signal, side in SIGNALS.items() if signal in common), None)
    if outputs is None:
        outputs = [
            "dn",
            *(["dM"] if located and common & set(SIGNALS) else []),
            *(["dX"] if "X_f" in common else []),
        ]
    clock = clock_of(experiments)
    if "sampling" in elements or any("T_s" in given for given in narrow.values()):
        clock = None
    if clock:
        elements = {**elements, "sampling": True}
        narrow = {**narrow, "fixed": {**narrow.get("fixed", {}), "T_s": clock[0]}}
    forced = [name for name, on in elements.items() if on]
    if is_loaded(experiments) and elements.get("load", True):
        forced = [*forced, *({"load"} - set(forced))]
    if "load" in forced and "dM" not in outputs:
        # The speed alone tells the load's gain over the inertia: one of the two must be known.
        narrow = {**narrow, "fixed": {"k_L": 1.0, **narrow.get("fixed", {})}}
    return Chooser(
        experiments,
        torque=located or "brake",
        outputs=outputs,
        forced=forced,
        excluded=[name for name, on in elements.items() if not on],
        narrow=narrow,
        search=search,
        clock=clock,
    )


def with_limits(fingerprint: Fingerprint) -> Fingerprint:
    """Return the fingerprint in which a parameter that ended on a bound of the search has a limit in place of a value."""
    parameters = dict(fingerprint.parameters)
    for name, estimate in parameters.items():
        if estimate.status != "at_bound" or estimate.value is None:
            continue
        if estimate.ci95 is None:
            reason = f"the fit goes beyond {estimate.value:.3g}, which no drive train has"
        elif estimate.value <= estimate.ci95[0]:
            reason = f"the data only say that it is below {estimate.ci95[1]:.3g} (95 %)"
        else:
            reason = f"the data only say that it is above {estimate.ci95[0]:.3g} (95 %)"
        parameters[name] = Estimate(None, None, None, estimate.unit, "unidentifiable", reason)
    return replace(fingerprint, parameters=parameters)


def with_rivals(fingerprint: Fingerprint, choice: Choice) -> Fingerprint:
    """Return the fingerprint with the union of the intervals of all structures that the data do not reject.

    The union covers where any of them is right, whichever was chosen; a parameter that one of them leaves open is
    open. A parameter that a structure lacks has the value of its element that is off, zero.
    """
    parameters, derived = dict(fingerprint.parameters), dict(fingerprint.derived)
    for rival in choice.rivals:
        found = estimates(replace(rival.search, intervals="symmetric"), rival.minimum)
        others = {**found.parameters, **found.derived}
        words = ", ".join(ELEMENTS[name].words for name in rival.elements) or "no element"
        for group in (parameters, derived):
            for name, estimate in group.items():
                lacks = group is parameters and name not in others
                bounds = _bounds(choice, name) if group is parameters else (-np.inf, np.inf)
                group[name] = _joined(estimate, others.get(name), words, bounds, off=lacks)
    return replace(fingerprint, parameters=parameters, derived=derived)


def _joined(
    estimate: Estimate, other: Estimate | None, words: str, bounds: tuple[float, float], *, off: bool
) -> Estimate:
    if estimate.status not in KNOWN or estimate.ci95 is None:
        return estimate
    if other is None:
        # A rival without the element has zero in its parameter's place.
        return replace(estimate, ci95=(min(0.0, estimate.ci95[0]), estimate.ci95[1])) if off else estimate
    if other.ci95 is None:
        if other.status == "fixed" or other.value is not None:
            return estimate
        return replace(
            estimate,
            value=None,
            std=None,
            ci95=None,
            status="unidentifiable",
            reason=f"not determined by a structure that fits as well ({words}): {other.reason}",
        )
    # An end that the rival's search did not find is the bound.
    low = max(min(estimate.ci95[0], other.ci95[0]), bounds[0])
    high = min(max(estimate.ci95[1], other.ci95[1]), bounds[1])
    widened = (high - low) / max(estimate.ci95[1] - estimate.ci95[0], 1e-300)
    std = None if estimate.std is None else estimate.std * widened
    return replace(estimate, ci95=(low, high), std=std)


def widened_by_neglect(fingerprint: Fingerprint, choice: Choice) -> Fingerprint:
    """Return the fingerprint with intervals that also hold where an element acts that was left out.

    With the strength s of the element the estimate is at theta + c s, to first order, and the deviance rises by
    ((s - s_hat) / sigma)^2 from the best s that is not negative; what is left of the quantile's square is for theta
    itself. The ends are those over all s, and what several elements add to a side is added in quadrature.
    """
    groups = {"parameters": dict(fingerprint.parameters), "derived": dict(fingerprint.derived)}
    values = {name: estimate.value for name, estimate in fingerprint.parameters.items()}
    neglected = [
        [(neglect, _most(neglect, fingerprint, choice)) for neglect in ways]
        for ways in choice.neglected.values()
    ]
    for group in groups.values():
        for name, estimate in group.items():
            if estimate.status not in KNOWN or estimate.ci95 is None or estimate.value is None:
                continue
            more = np.zeros(2)
            for ways in neglected:
                # The ways in which an element may act exclude each other: the widest of them counts.
                each = [(0.0, 0.0)]
                for neglect, most in ways:
                    slope = (
                        neglect.shift.get(name, 0.0)
                        if group is groups["parameters"]
                        else slope_of(name, values, neglect.shift)
                    )
                    each.append(_beyond(estimate, slope, neglect, most))
                more += np.square(np.max(each, axis=0))
            low, high = np.array(estimate.ci95) + np.sqrt(more) * (-1.0, 1.0)
            widened = (high - low) / max(estimate.ci95[1] - estimate.ci95[0], 1e-300)
            std = None if estimate.std is None else estimate.std * widened
            group[name] = replace(estimate, ci95=(float(low), float(high)), std=std)
    return replace(fingerprint, parameters=groups["parameters"], derived=groups["derived"])


def _most(neglect: Neglect, fingerprint: Fingerprint, choice: Choice) -> float:
    """Strength of an element that pushes a parameter's whole interval over a bound: stronger it can't be."""
    most = np.inf
    for name, slope in neglect.shift.items():
        estimate = fingerprint.parameters.get(name)
        if estimate is None or estimate.ci95 is None or slope == 0.0:
            continue
        lower, upper = _bounds(choice, name)
        room = upper - estimate.ci95[0] if slope > 0.0 else estimate.ci95[1] - lower
        most = min(most, max(room, 0.0) / abs(slope))
    return most


def _beyond(estimate: Estimate, slope: float, neglect: Neglect, most: float) -> tuple[float, float]:
    """How far an interval must be widened below and above for an element that may act with a strength of at most `most`."""
    if slope == 0.0 or not np.isfinite([slope, neglect.estimate, neglect.deviation]).all():
        return 0.0, 0.0
    best = max(neglect.estimate, 0.0)
    seen = best + np.linspace(0.0, 1.0, 41) * DEVIATIONS_95 * neglect.deviation
    seen = np.concatenate([np.linspace(0.0, best, 21), seen])
    rise = np.square((seen - neglect.estimate) / neglect.deviation)
    rise -= np.square((best - neglect.estimate) / neglect.deviation)
    left = np.sqrt(np.maximum(1.0 - rise / DEVIATIONS_95**2, 0.0))
    moved = slope * seen ** (1.0 / neglect.power)
    assert estimate.ci95 is not None
    assert estimate.value is not None
    low, high = estimate.ci95[0] - estimate.value, estimate.ci95[1] - estimate.value
    inside = (rise <= DEVIATIONS_95**2 * (1.0 + 1e-9)) & (seen <= most**neglect.power)
    inside[0] = True  # without the element
    lowest, highest = np.min((moved + low * left)[inside]), np.max((moved + high * left)[inside])
    return max(low - lowest, 0.0), max(highest - high, 0.0)


def within_bounds(fingerprint: Fingerprint, choice: Choice) -> Fingerprint:
    """Return the fingerprint with no interval beyond what the structure takes for possible; without an element it is off."""
    parameters = dict(fingerprint.parameters)
    for name, estimate in parameters.items():
        if estimate.status not in KNOWN or estimate.ci95 is None:
            continue
        lower, upper = _bounds(choice, name)
        ends = max(estimate.ci95[0], lower), min(estimate.ci95[1], upper)
        parameters[name] = replace(estimate, ci95=ends)
    return replace(fingerprint, parameters=parameters)


def _bounds(choice: Choice, name: str) -> tuple[float, float]:
    """Bounds of a parameter of the chosen structure, or of its element that is off, whose delay is none."""
    parameter = choice.best.search.structure[name]
    return 0.0 if parameter.lower == SHORTEST_S else parameter.lower, parameter.upper


def element_rows(choice: Choice, fingerprint: Fingerprint) -> dict[str, dict[str, Any]]:
    """Return each element's state, its evidence (change of the deviance), and the limit of one that is off.

    An element that is on is open where the interval of its time, all that may act beside it included, begins at none.
    """
    rows: dict[str, dict[str, Any]] = {}
    for name, found in choice.states.items():
        estimate = fingerprint.parameters.get(ELEMENTS[name].parameters[0].name)
        told = None if estimate is None else estimate.ci95
        state = "open" if found == "on" and told is not None and told[0] <= 0.0 else found
        evidence = choice.evidence.get(name)
        rows[name] = {
            "state": state,
            "evidence": None if evidence is None or not np.isfinite(evidence) else float(evidence),
            "limit": _limit(choice, name, state),
            "words": ELEMENTS[name].words,
        }
    for name in choice.best.elements:
        rows.setdefault(name, {"state": "on", "evidence": None, "limit": None, "words": ELEMENTS[name].words})
    return rows


def _limit(choice: Choice, name: str, state: State) -> dict[str, Any] | None:
    """Return the 95 % limit of an element that is off: above it (below it, for a torque limit) the data reject it."""
    limit = choice.limits.get(name)
    if state == "on" or limit is None:
        return None
    parameter = ELEMENTS[name].parameters[0]
    return {"parameter": parameter.name, "value": limit, "unit": parameter.unit, "level": 0.95}


def adequacy(fingerprint: Fingerprint, choice: Fitted) -> dict[str, Any]:
    """Return whether the model stands, what it misses of each output, and what that can do to each parameter.

    The test's statistic over its degrees of freedom is the residual's power along what the set point drives over that of
    noise, and estimates follow the residual along nothing else: a dispersion, by whose root their deviations grow
    (McCullagh and Nelder 1989, section 4.5).
    """
    freedom = float(INPUT_LAGS + 1)
    samples = sum(block.count for block in choice.search.blocks)
    misses = misses_of(fingerprint.fit, samples)
    dispersion = max([1.0, *(input_dispersion(fingerprint.fit[name], samples) for name in misses)])
    p = fingerprint.fit.get("overall", {}).get("structure_p")
    unchallenged = p is None or p >= ALARM
    dispersion = 1.0 if unchallenged else dispersion
    stands = unchallenged or max(misses.values(), default=0.0) <= SMALL_MISS_PCT
    # A miss that counts need not be spread evenly over what the set point drives: all of it may lie along one estimate.
    beyond = (dispersion - 1.0) * (1.0 if stands else freedom)
    bias = {
        name: estimate.std * float(np.sqrt(beyond))
        for name, estimate in {**fingerprint.parameters, **fingerprint.derived}.items()
        if estimate.status in KNOWN and estimate.std is not None
    }
    return {"stands": bool(stands), "misses_pct": misses, "bias": bias, "dispersion": dispersion}


def widened_by_bias(fingerprint: Fingerprint, bias: Mapping[str, float]) -> Fingerprint:
    """Return the fingerprint with what a misfit can do added to the intervals, in quadrature with their halves."""
    groups = {"parameters": dict(fingerprint.parameters), "derived": dict(fingerprint.derived)}
    for name, bound in bias.items():
        group = groups["parameters" if name in fingerprint.parameters else "derived"]
        estimate = group[name]
        if bound == 0.0 or estimate.ci95 is None or estimate.value is None:
            continue
        low, high = (
            estimate.value + sign * float(np.hypot(end - estimate.value, DEVIATIONS_95 * bound))
            for sign, end in zip((-1.0, 1.0), estimate.ci95, strict=True)
        )
        std = None if estimate.std is None else float(np.hypot(estimate.std, bound))
        group[name] = replace(estimate, ci95=(low, high), std=std)
    return replace(fingerprint, parameters=groups["parameters"], derived=groups["derived"])


def reworded(fingerprint: Fingerprint) -> Fingerprint:
    """Return the fingerprint with a verdict that opens with what it can be used for, elements and misfit included."""
    known = [name for name, estimate in fingerprint.parameters.items() if estimate.status in KNOWN]
    found = usability(fingerprint)
    rest = [
        line for line in fingerprint.verdict if not line.startswith(("Known:", "The residuals contradict"))
    ]
    lines = [found.sentence]
    if known:
        told = "Known" if fingerprint.adequate["stands"] else "According to this model"
        lines.append(
            f"{told}: " + "; ".join(shown(name, fingerprint.parameters[name]) for name in known) + "."
        )
    acting = [row["words"] for row in fingerprint.elements.values() if row["state"] == "on"]
    limits = [
        f"{row['words']} ({row['limit']['parameter']} {'above' if name == 'torque_limit' else 'below'} "
        f"{row['limit']['value']:.3g} {row['limit']['unit']}, 95 %)".replace(" -,", ",")
        for name, row in fingerprint.elements.items()
        if row["state"] == "off" and row["limit"]
    ]
    undecided = [row["words"] for row in fingerprint.elements.values() if row["state"] == "open"]
    if acting:
        lines.append("Acting elements: " + ", ".join(acting) + ".")
    if limits:
        lines.append("Not found to act: " + ", ".join(limits) + ".")
    if undecided:
        lines.append(
            "Undecided, with and without it the model fits as well: "
            + ", ".join(undecided)
            + "; the intervals hold for both."
        )
    if little := something_missing(fingerprint.adequate):
        lines.append(little)
    return replace(
        fingerprint,
        usable=found.sentence,
        usability=found.state,
        why_not=found.why_not,
        verdict=(*lines, *rest),
    )
