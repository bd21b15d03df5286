"""Plain words: what a fit tells, what it doesn't, and what would settle it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from shipfp_rs.identification.estimate import rounded_rows
from shipfp_rs.identification.fingerprint import ALARM, Estimate, Identifiability
from shipfp_rs.identification.fit_statistics import missed_pct
from shipfp_rs.structures.structure import Structure

SMALL_PCT = 0.1
"""Part of an output's spread below which what is missed is no fault of the structure: no sensor of a ship is better [%]."""


def verdict(
    parameters: Mapping[str, Estimate],
    derived: Mapping[str, Estimate],
    identifiability: Identifiability,
    fit: Mapping[str, Mapping[str, float | None]],
    structure: Structure,
    trouble: str = "",
) -> tuple[str, ...]:
    """Return the sentences of the verdict, most important first.

    `trouble` says why the search's end is no minimum.
    """
    lines = [
        *(
            [f"The search did not end in a minimum, so take no figure for an estimate: {trouble}."]
            if trouble
            else []
        ),
        *_known(parameters, derived, structure),
        *_unknown(parameters),
        *_gaps(identifiability),
        *_contradictions(fit, structure),
    ]
    if poor := _poor(fit):
        lines.append(
            f"The structure {structure.name!r} explains the data poorly ({', '.join(poor)}): its intervals "
            "hold for the structure, not for the drive train."
        )
    return tuple(lines)


def _known(
    parameters: Mapping[str, Estimate], derived: Mapping[str, Estimate], structure: Structure
) -> Iterator[str]:
    known = [
        shown(name, e)
        for name, e in parameters.items()
        if e.status in ("free", "prior") and e.value is not None
    ]
    if known:
        yield "Known: " + "; ".join(known) + "."
    together = [shown(name, estimate) for name, estimate in derived.items()]
    if together:
        yield "Known only together: " + "; ".join(together) + "."


def _unknown(parameters: Mapping[str, Estimate]) -> Iterator[str]:
    """Yield what is not known at all, and what is on a bound."""
    for name, estimate in parameters.items():
        if estimate.status == "unidentifiable":
            yield f"Not identifiable from these data: {name} ({estimate.reason})."
    on_bound = {name: estimate for name, estimate in parameters.items() if estimate.status == "at_bound"}
    pressed = [f"{name} ({e.reason})" for name, e in on_bound.items() if e.ci95 is None]
    if pressed:
        yield (
            "On a bound, so no estimate but a sign that the structure or the bounds do not suit the data: "
            + ", ".join(pressed)
            + ". The other intervals hold only if they are there."
        )
    limited = [f"{name} ({e.reason})" for name, e in on_bound.items() if e.ci95 is not None]
    if limited:
        yield "On a bound that the data do not contradict, known from one side: " + ", ".join(limited) + "."


def _gaps(identifiability: Identifiability) -> Iterator[str]:
    """Yield what the data can't tell apart, and what would settle it."""
    if identifiability.rank < identifiability.free:
        yield (
            f"The data distinguish {identifiability.rank} of {identifiability.free} free parameters; the response stays the "
            "same along: "
            + " / ".join(str(entry["combination"]) for entry in identifiability.null_space)
            + "."
        )
    if identifiability.closes_gap:
        yield (
            "Any of these, known from elsewhere (torsional calculation, factory test), would settle the rest: "
            + "; ".join(identifiability.closes_gap)
            + "."
        )


def _poor(fit: Mapping[str, Mapping[str, float | None]]) -> list[str]:
    """Figures of a fit that explains the data poorly."""
    overall = fit.get("overall", {})
    chi_squared, freedom = overall.get("chi_squared"), overall.get("degrees_of_freedom")
    if chi_squared is not None and freedom is not None:
        # With known deviations chi-squared judges a fit better than per cent do: some points may carry no weight.
        poor = chi_squared > 2 * freedom
        return [f"chi-squared {chi_squared:.4g} at {freedom:.0f} degrees of freedom"] if poor else []
    rows = {output: row["nrmse_pct"] for output, row in fit.items() if output != "overall"}
    return [
        f"fit of {output} {value:.1f} %"
        for output, value in rows.items()
        if value is not None and value < 60.0
    ]


def structure_test(tests: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Return the one verdict on the structure of all outputs' residual tests; nothing where there is none.

    "structure_p" is the probability that the set point explains as much of any output's residuals by chance: the
    least of the outputs' times their number (Bonferroni). "structure_misses_pct" is how much it explains of what was
    left, the most of any output [%]: on long records a structure can be told wrong though what it lacks is little.
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
        f"{output} ({_chance(p)}, it explains {row['input_explained_pct']:.2g} % of what was left)"
        for output, row in rows.items()
        if (p := row.get("input_correlation_p")) is not None and p < threshold and missed_pct(row) > SMALL_PCT
    ]
    if followed:
        return [
            f"The residuals contradict the structure {structure.name!r}: the set point still explains some of "
            + ", ".join(followed)
            + ". Dynamics are missing, a dead time for instance; the intervals hold for the structure, "
            "not for the drive train."
        ]
    coloured = [
        f"{output} ({_chance(p)})"
        for output, row in rows.items()
        if (p := row.get("whiteness_p")) is not None and p < threshold
    ]
    if coloured:
        return [
            "The noise is not what was assumed: whitened residuals are still correlated in "
            + ", ".join(coloured)
            + ", so the intervals may be too narrow."
        ]
    return []


def _chance(p: float) -> str:
    return f"p = {p:.1g}" if p > 1e-6 else "p < 1e-6"


def shown(name: str, estimate: Estimate) -> str:
    """Return a parameter with its value, interval and unit, as a sentence has it."""
    assert estimate.value is not None
    (row,) = rounded_rows({name: estimate})
    spread = "" if estimate.ci95 is None else f" ({row.low} to {row.high})"
    unit = "" if estimate.unit == "-" else f" {estimate.unit}"
    return f"{name} = {row.value}{spread}{unit}"
