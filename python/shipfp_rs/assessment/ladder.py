"""From a simple structure to a rich one: which step the data support, and where they stop carrying more."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.stats import chi2

from shipfp_rs.errors import InputError
from shipfp_rs.identification.fingerprint import ALARM, Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.structure_records import Data
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked

LEVEL = 0.01
"""Probability of taking a step that the data do not support."""

BETTER = 2.0
"""A structure with as many unknowns as the last one must lower BIC by this: less is no evidence (Kass and Raftery 1995,
doi:10.1080/01621459.1995.10476572)."""


@dataclass(frozen=True)
class Rung:
    """One structure of the ladder: what it costs, what it gains over the last supported one, and whether that counts.

    Parameters
    ----------
    structure
        Name.
    rank
        Directions of its parameters that the data tell.
    deviance
        -2 ln L: chi-squared where the points' deviations are known, else N ln det of the residuals' scatter.
    bic
        Deviance + rank ln N (Schwarz); the experiments' own unknowns are the same on every rung.
    gain
        Fall of the deviance from the last supported rung; None on the first.
    p
        Probability of such a gain if the added parameters were void (likelihood ratio, Wilks).
    residuals_white
        Whether no residual test of any output alarms; None without tests.
    supported
        Whether the data support the step to this rung.
    why
        The reason in words.
    """

    structure: str
    rank: int
    deviance: float
    bic: float
    gain: float | None
    p: float | None
    residuals_white: bool | None
    supported: bool
    why: str


@dataclass(frozen=True)
class Ladder:
    """All rungs, their fingerprints, and the place of the best supported one."""

    rungs: tuple[Rung, ...]
    fingerprints: tuple[Fingerprint, ...]
    best: int

    @property
    def fingerprint(self) -> Fingerprint:
        """The fingerprint of the best supported structure."""
        return self.fingerprints[self.best]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form of the rungs, and which one is best."""
        return {"rungs": [asdict(rung) for rung in self.rungs], "best": self.rungs[self.best].structure}

    def __str__(self) -> str:
        width = max(len(rung.structure) for rung in self.rungs)
        lines = [f"{'structure':{width}}  rank   deviance        BIC  supported"]
        for place, rung in enumerate(self.rungs):
            mark = "*" if place == self.best else " "
            lines.append(
                f"{rung.structure:{width}}  {rung.rank:4d} {rung.deviance:10.5g} {rung.bic:10.5g} {mark}{rung.why}"
            )
        return "\n".join(lines)


@checked
def ladder(
    data: Data | Sequence[Data],
    structures: Sequence[Structure],
    *,
    progress: Callable[[int, int], None] | None = None,
    **settings: Any,
) -> Ladder:
    """Fit structures from simple to rich and tell which the data support.

    A step is supported where the deviance falls by more than chance explains (likelihood ratio, p < 0.01), the data tell
    at least one direction more, and BIC falls. A step to a structure as rich as the last, such as one with the other
    dead time, is supported where BIC falls: it is no extension but a rival.

    Parameters
    ----------
    data, settings
        As for `identify`; the kind of noise is the same on every rung.
    structures
        Two or more with the same outputs, the simplest first.
    progress
        Called with (structures fitted, structures in all).

    Returns
    -------
    Ladder

    Raises
    ------
    InputError
        For fewer than two structures, or different outputs.
    IdentificationError
        As `identify`.
    """
    if len(structures) < 2:
        raise InputError(f"ladder: {len(structures)} structures, expected two or more from simple to rich")
    for structure in structures[1:]:
        if structure.outputs != structures[0].outputs:
            raise InputError(
                f"ladder: {structure.name!r} explains {', '.join(structure.outputs)}, {structures[0].name!r} explains "
                f"{', '.join(structures[0].outputs)}; expected the same outputs on every rung"
            )
    fingerprints = []
    for done, structure in enumerate(structures, 1):
        fingerprints.append(identify(data, structure, **settings))
        if progress is not None:
            progress(done, len(structures))
    return climb(fingerprints)


def climb(fingerprints: Sequence[Fingerprint]) -> Ladder:
    """Judge fingerprints of the same data by structures from simple to rich; see `ladder`."""
    rungs: list[Rung] = []
    best = 0
    for place, fingerprint in enumerate(fingerprints):
        rank, deviance, bic = _figures(fingerprint)
        gain = p = None
        supported, why = True, "the first"
        if place:
            last = rungs[best]
            gain, extra = last.deviance - deviance, rank - last.rank
            # A tie but for rounding is no improvement.
            better = bic < last.bic - BETTER
            if extra > 0:
                p = float(chi2.sf(max(gain, 0.0), extra))
                supported = better and p < LEVEL
                why = f"{'' if supported else 'not '}by the data: deviance {-gain:+.4g} for {extra} more, p = {p:.1g}"
            else:
                supported = better
                why = f"{'better' if better else 'no better'} than {last.structure!r}: BIC {bic - last.bic:+.4g}"
        if not fingerprint.settings.get("converged", True):
            supported, why = place == 0, "the search ended in no minimum"
        white = _white(fingerprint)
        if white is not None:
            why += "; residuals " + ("pass" if white else "fail") + " their tests"
        rungs.append(
            Rung(str(fingerprint.structure["name"]), rank, deviance, bic, gain, p, white, supported, why)
        )
        if supported:
            best = place
    return Ladder(tuple(rungs), tuple(fingerprints), best)


def _figures(fingerprint: Fingerprint) -> tuple[int, float, float]:
    overall, rank = fingerprint.fit["overall"], fingerprint.identifiability.rank
    chi_squared, samples = overall.get("chi_squared"), overall.get("samples")
    deviance = overall.get("deviance") if chi_squared is None else chi_squared
    if deviance is None or samples is None:
        raise InputError(
            f"structure {fingerprint.structure['name']!r} leaves no residual to judge by; nothing tells a richer one apart"
        )
    return rank, deviance, deviance + rank * math.log(samples)


def _white(fingerprint: Fingerprint) -> bool | None:
    found = [
        p
        for output, row in fingerprint.fit.items()
        if output != "overall"
        for p in (row.get("whiteness_p"), row.get("input_correlation_p"))
        if p is not None
    ]
    return min(found) >= ALARM / 2 if found else None
