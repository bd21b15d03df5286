"""What a fingerprint can be used for: a state to decide by, why not where it is none, and the sentence about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from shipfp_rs.identification.estimate import KNOWN, OPEN, Estimate, Usable, WhyNot, is_rough
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import missed_pct
from shipfp_rs.identification.residual_tests import INPUT_LAGS
from shipfp_rs.identification.wording import OUTPUTS
from shipfp_rs.structures.names import as_looked_at

SMALL_MISS_PCT = 1.6
"""Part of an output's spread that a model may miss and still stand: as much as a calibrated torque gauge is off by
(static torque check of the thesis, eq. 6.3)."""
LARGE_MISS_PCT = 10.0
"""Part of an output's spread that a model may miss, in per cent, before it is called unusable."""
LEAST_EXPLAINED_PCT = 2.0
"""Part of an output's spread that a usable model explains at least: below it the output is not the ship's answer."""


@dataclass(frozen=True)
class Usability:
    """What a fingerprint can be used for, in a word, and in a sentence."""

    state: Usable
    sentence: str
    why_not: WhyNot = ""


def judged(fingerprint: Fingerprint, samples: int) -> Fingerprint:
    """Return the fingerprint of a given structure with what it can be used for; as it is where no residuals test it."""
    if "structure_p" not in fingerprint.fit.get("overall", {}):
        return fingerprint
    misses = misses_of(fingerprint.fit, samples)
    stands = bool(fingerprint.model_adequate) or max(misses.values(), default=0.0) <= SMALL_MISS_PCT
    adequate = {"stands": stands, "misses_pct": misses, "bias": {}, "dispersion": 1.0}
    found = usability(replace(fingerprint, adequate=adequate))
    return replace(
        fingerprint,
        adequate=adequate,
        usable=found.sentence,
        usability=found.state,
        why_not=found.why_not,
    )


def misses_of(fit: Mapping[str, Mapping[str, float | None]], samples: int) -> dict[str, float]:
    """Return what a model misses of each output, in per cent of its spread.

    What the set point still explains of an output's whitened residual, less what chance explains, is its miss: the root
    of that share of the residual.
    """
    misses = {}
    for name, row in fit.items():
        if name == "overall":
            continue
        misses[name] = missed_pct(row, chance=(INPUT_LAGS + 1) / samples)
    return misses


def usability(fingerprint: Fingerprint) -> Usability:
    """Judge a fingerprint, `adequate` included."""
    known = [name for name, estimate in fingerprint.parameters.items() if estimate.status in KNOWN]
    left_open = as_looked_at(
        name
        for name, estimate in fingerprint.parameters.items()
        if not (estimate.status in (*KNOWN, "fixed") or _known_from_one_side(estimate))
        or is_rough(estimate, OPEN)
    )
    worst = max(fingerprint.adequate["misses_pct"].values(), default=0.0)
    unexplained = [
        f"the {OUTPUTS.get(name, name)}"
        for name, row in fingerprint.fit.items()
        if name != "overall" and (share := row.get("nrmse_pct")) is not None and share < LEAST_EXPLAINED_PCT
    ]
    if not fingerprint.settings.get("converged", True):
        return _unusable("no minimum", "the search did not end in a minimum; no figure is an estimate")
    if unexplained:
        return _unusable("nothing explained", f"the model explains nothing of {listed(unexplained)}")
    if not known:
        return _unusable("nothing told", "the data determine no parameter")
    if not fingerprint.adequate["stands"] and worst > LARGE_MISS_PCT:
        return _unusable("misfit", f"the model misses {worst:.2g} % of the response to the set point")
    if not fingerprint.adequate["stands"] and fingerprint.adequate["dispersion"] == 1.0:
        return Usability(
            "usable except",
            "Usable for simulation and comparison, but its intervals hold for the model, not for the drive train: the "
            f"model misses {worst:.2g} % of the response to the set point.",
        )
    rough = as_looked_at(
        name for name in known if name not in left_open and is_rough(fingerprint.parameters[name])
    )
    if left_open:
        also = f", and determine {listed(rough)} only roughly" if rough else ""
        return Usability(
            "usable except",
            f"Usable for simulation and comparison, but the data do not determine {listed(left_open)}{also}: "
            "other values fit as well.",
        )
    if not fingerprint.adequate["stands"]:
        return Usability(
            "usable except",
            f"Usable for simulation and comparison, but the model misses {worst:.2g} % of the response to the set point.",
        )
    but = f", {listed(rough)} only roughly" if rough else ""
    return Usability(
        "usable",
        f"Usable for simulation, control tuning and comparison: the data determine every parameter{but}.",
    )


def _known_from_one_side(estimate: Estimate) -> bool:
    """Whether an estimate stands on a bound from which the data allow it to go only so far, as a delay that may be none."""
    return estimate.status == "at_bound" and estimate.ci95 is not None


def _unusable(why_not: WhyNot, because: str) -> Usability:
    return Usability("not usable", f"Not usable, because {because}.", why_not)


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence lists them."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
