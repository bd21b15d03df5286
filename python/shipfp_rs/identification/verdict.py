"""Plain sentences about a fit: what the data determine, what they don't, and what would."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from shipfp_rs.identification.estimate import KNOWN, OPEN, is_rough, rounded_rows
from shipfp_rs.identification.fingerprint import ALARM, Estimate, Identifiability
from shipfp_rs.identification.fit_statistics import missed_pct
from shipfp_rs.structures.names import OF_WHAT
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.sentences import Sentence, joined
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
) -> tuple[str, ...]:
    """Return the sentences of the verdict, most important first; `trouble`: why the search did not reach a minimum."""
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
        *_contradictions(fit, structure),
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
    """Yield known parameters, and separately those whose interval is wider than they are large."""
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
    followed = [
        Sentence(
            "{output} ({chance}, it explains {share} % of the residuals)",
            output=output,
            chance=_chance(p),
            share=f"{row['input_explained_pct']:.2g}",
        )
        for output, row in rows.items()
        if (p := row.get("input_correlation_p")) is not None and p < threshold and missed_pct(row) > SMALL_PCT
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
