"""What the reproduction of chapters 6 and 7 says, in sentences made of its own figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.reproduce import Row

STEP_DELAY_S = 0.5
"""Seen at every step of the trial (section 7.3.2)."""


def of(
    rows: Iterable[Row], fingerprints: Mapping[str, Fingerprint], extended: Mapping[str, Fingerprint]
) -> tuple[str, ...]:
    """Return the verdict, one line an entry.

    Parameters
    ----------
    rows
        All rows.
    fingerprints
        Case and structure to fingerprint.
    extended
        Two cases of the best supported structure, each point weighted: without and with the torsional calculation.
    """
    weighted, held = extended
    structure = extended[weighted].structure["name"]
    steps = [found for name, found in fingerprints.items() if name.startswith(f"{weighted}:")]
    return (
        "What the published sine fits tell of the tug:",
        *(f"  {line}" for line in _told(extended[weighted])),
        *(f"  {line}" for line in _with_prior(extended[held])),
        "Why the thesis's fits failed:",
        *(f"  {line}" for line in _failure(list(rows), *map(chi_squared, steps[:2]))),
        "The thesis's structure, fitted to its own sine fits:",
        *(f"  {line}" for line in fingerprints["ii: thesis"].verdict),
        "The extended structure (gauge-side torque, free exponent, two dead times) on the same trial:",
        *(f"  {line}" for line in fingerprints[f"ii: {structure}"].verdict),
        "The same, each point weighted by how well its amplitude and phase are known:",
        *(f"  {line}" for line in extended[weighted].verdict),
        "The same, with tau_n from the torsional calculation:",
        *(f"  {line}" for line in extended[held].verdict),
        "From the thesis's structure to that one, each point weighted; the least BIC has a star:",
        *(f"  {line}" for line in _steps(steps)),
    )


def chi_squared(found: Fingerprint) -> float:
    """Return what a fit of weighted points leaves unexplained."""
    return float(found.fit["overall"]["chi_squared"] or 0.0)


def bic(found: Fingerprint) -> float:
    """Return Schwarz's criterion: chi-squared + rank ln N."""
    return chi_squared(found) + found.identifiability.rank * math.log(found.fit["overall"]["samples"] or 1.0)


def _steps(steps: Sequence[Fingerprint]) -> Iterator[str]:
    best = min(map(bic, steps))
    yield f"{'structure':26}  rank  chi-squared        BIC"
    for found in steps:
        star = " *" if bic(found) == best else ""
        rank, name = found.identifiability.rank, found.structure["name"]
        yield f"{name:26}  {rank:4d}  {chi_squared(found):11.4g} {bic(found):10.4g}{star}"


def _shown(fingerprint: Fingerprint, name: str, unit: str = "") -> str:
    return _interval(name, fingerprint[name], unit)


def _interval(name: str, estimate: Estimate, unit: str = "") -> str:
    if estimate.value is None or estimate.ci95 is None:
        return f"{name} unknown"
    low, high = estimate.ci95
    return f"{name} {estimate.value:.3g}{unit} ({low:.3g} to {high:.3g})"


def _told(found: Fingerprint) -> tuple[str, ...]:
    open_ = [name for name, estimate in found.parameters.items() if estimate.status == "unidentifiable"]
    loop = closed_loop(found)
    return (
        f"Known with 95 % intervals: {_shown(found, 'p')}, {_shown(found, 'tau_prop', ' s')}, "
        f"{_shown(found, 'T_d', ' s')} in the loop, {_shown(found, 'T_set', ' s')} in the set point's path.",
        f"A slow set point is followed {_shown(found, '(p-g)/(vK_i)+T_set', ' s')} late, which is the delay of about "
        f"{STEP_DELAY_S} s that the thesis saw at every step and could not explain.",
        f"Not known: {', '.join(open_)}. The speed loop as a whole is: "
        f"{_interval('bandwidth', loop['bandwidth'], ' Hz')}, {_interval('phase margin', loop['phase margin'], ' deg')}, "
        f"{_interval('gain margin', loop['gain margin'])}.",
    )


def _with_prior(found: Fingerprint) -> tuple[str, ...]:
    return (
        f"With the torsional calculation as prior knowledge {_shown(found, 'tau_n', ' s')} and {_shown(found, 'vK_p')}; v "
        "stays open until a factory test or the fuel rack tells it.",
    )


def _failure(rows: list[Row], thesis: float, gauge: float) -> tuple[str, ...]:
    fits = {(row.table, row.case, row.way): row.parameters for row in rows if row.table in {"7.2", "7.3"}}
    steps = [fits["7.2", case, "ours"]["steps"] or 0.0 for case in ("ii", "iii", "iv")]
    best = fits["7.2", "ii, weighted", "ours"]["short chirp"] or 0.0
    worst = fits["7.2", "ii", "ours"]["short chirp"] or 0.0
    return (
        "The gauge sits between the inertias, so its torque is not the engine's; the governor's dead time and that of the "
        "set point's path are not in the structure; phases from 0.1 Hz up are lost to each channel's own fitted frequency.",
        f"None of these alone mends it: chi-squared {thesis:.0f} with the thesis's structure, {gauge:.0f} with gauge-side "
        "torque only; the table below adds one at a time.",
        f"Tables 7.2 and 7.3 print one and the same fit for three different parameter sets (95.85 % to the steps); on the "
        f"simulated tug these sets fit its steps to {', '.join(f'{fit:.1f}' for fit in steps)} %.",
        f"There case ii fits the speed of the short chirp to {worst:.0f} %, our best structure to {best:.0f} %.",
    )
