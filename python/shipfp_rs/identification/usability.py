"""What a fingerprint can be used for: a state, the reason where it can't be used, and a sentence for the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from shipfp_rs.identification.estimate import KNOWN, OPEN, Estimate, Usable, WhyNot, is_rough
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import missed_pct
from shipfp_rs.identification.residual_tests import INPUT_LAGS
from shipfp_rs.identification.wording import OUTPUTS
from shipfp_rs.structures.names import as_looked_at
from shipfp_rs.support.sentences import Sentence, listed

SMALL_MISS_PCT = 1.6
"""Part of an output's spread that a model may miss and still stand: as much as a calibrated torque gauge is off by
(static torque check of the thesis, eq. 6.3)."""
LARGE_MISS_PCT = 10.0
"""Part of an output's spread that a model may miss, in per cent, before it is called unusable."""
LEAST_EXPLAINED_PCT = 2.0
"""Part of an output's spread that a usable model explains at least: below it the output is not the ship's answer."""

MISSES = Sentence("the model misses {share} % of the drive train's response")
GAINS = ("vK_p", "vK_i", "K_p", "K_i")
TO_TUNE = 1.0 / 3.0
"""Error of a gain, over the true one, that control tuning bears: less than what most loops' margins leave."""


@dataclass(frozen=True)
class Usability:
    """What a fingerprint can be used for, in a word, and in a sentence."""

    state: Usable
    sentence: Sentence
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

    The set point still explains some share of the power of an output's whitened residual. The miss is the root of that
    share, less the share that chance explains, times the residual.
    """
    misses = {}
    for name, row in fit.items():
        if name == "overall":
            continue
        misses[name] = missed_pct(row, chance=(INPUT_LAGS + 1) / samples)
    return misses


def usability(fingerprint: Fingerprint) -> Usability:
    """Judge what a fingerprint can be used for, from its estimates and from `adequate`."""
    if (why := _why_not(fingerprint)) is not None:
        return why
    share = f"{_worst(fingerprint):.2g}"
    if not fingerprint.adequate["stands"] and fingerprint.adequate["dispersion"] == 1.0:
        bent = Sentence(
            "Usable for simulation and comparison, but not for control tuning: its intervals hold for the model, not for "
            "the drive train, of whose response the model misses {share} %."
        )
        return Usability("usable except", Sentence(bent, share=share))
    estimates = fingerprint.parameters
    left_open = as_looked_at(
        name
        for name, estimate in estimates.items()
        if not (estimate.status in (*KNOWN, "fixed") or _known_from_one_side(estimate))
        or is_rough(estimate, OPEN)
    )
    rough = as_looked_at(
        name
        for name, estimate in estimates.items()
        if estimate.status in KNOWN and name not in left_open and is_rough(estimate)
    )
    unsure = as_looked_at(name for name in GAINS if name in estimates and not _tunes(estimates[name]))
    names = {"unknown": listed(left_open), "rough": listed(rough), "gains": listed(unsure)}
    if left_open and rough:
        said = Sentence(
            "Usable for simulation and comparison, but not for control tuning: the data do not determine {unknown}, for "
            "which other values fit as well, and give {rough} only roughly."
        )
    elif left_open:
        said = Sentence(
            "Usable for simulation and comparison, but not for control tuning: the data do not determine {unknown}, for "
            "which other values fit as well."
        )
    elif unsure:
        said = Sentence(
            "Usable for simulation and comparison, but not for control tuning: {gains} may be off by more than a third."
        )
    elif not fingerprint.adequate["stands"]:
        said = Sentence(
            "Usable for simulation and comparison, but not for control tuning: the model misses {share} % of the drive "
            "train's response."
        )
    elif rough:
        said = Sentence(
            "Usable for simulation, control tuning and comparison: the data determine every parameter, but {rough} "
            "only roughly."
        )
    else:
        said = Sentence(
            "Usable for simulation, control tuning and comparison: the data determine every parameter."
        )
    stands = fingerprint.adequate["stands"] and not (left_open or unsure)
    state: Usable = "usable" if stands else "usable except"
    return Usability(state, Sentence(said, share=share, **names))


def _tunes(gain: Estimate) -> bool:
    """Whether a gain is right to a third, whatever value of its interval is the true one."""
    if gain.status == "fixed":
        return True
    if gain.value is None or gain.ci95 is None:
        return False
    low, high = gain.ci95
    return gain.value - low <= TO_TUNE * low and high - gain.value <= TO_TUNE * high


def misfit(fingerprint: Fingerprint) -> Sentence:
    """Say of which output the model explains nothing, or else which share it misses of the one of which it misses most."""
    unexplained = [
        Sentence("the {name}", name=Sentence(OUTPUTS.get(name, name)))
        for name, row in fingerprint.fit.items()
        if name != "overall" and (share := row.get("nrmse_pct")) is not None and share < LEAST_EXPLAINED_PCT
    ]
    if unexplained:
        return Sentence("the model explains nothing of {outputs}", outputs=listed(unexplained))
    return Sentence(MISSES, share=f"{_worst(fingerprint):.2g}")


def _worst(fingerprint: Fingerprint) -> float:
    return max(fingerprint.adequate["misses_pct"].values(), default=0.0)


def _why_not(fingerprint: Fingerprint) -> Usability | None:
    """Return why nothing of a fingerprint can be used; None where something can."""
    what = misfit(fingerprint)
    said = Sentence("Not usable, because {what}.", what=what)
    why: WhyNot
    if not fingerprint.settings.get("converged", True):
        why = "no minimum"
        said = Sentence("Not usable, because the search did not end in a minimum; no figure is an estimate.")
    elif what.template != MISSES:
        why = "nothing explained"
    elif not any(estimate.status in KNOWN for estimate in fingerprint.parameters.values()):
        why, said = "nothing told", Sentence("Not usable, because the data determine no parameter.")
    elif not fingerprint.adequate["stands"] and _worst(fingerprint) > LARGE_MISS_PCT:
        why = "misfit"
    else:
        return None
    return Usability("not usable", said, why)


def _known_from_one_side(estimate: Estimate) -> bool:
    """Whether an estimate stands on a bound from which the data allow it to go only so far, as a delay that may be zero."""
    return estimate.status == "at_bound" and estimate.ci95 is not None
