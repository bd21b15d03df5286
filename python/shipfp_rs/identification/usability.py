"""Usability of a fingerprint: a state, the reason where it can't be used, and a sentence for the report.

Model adequacy: the residual power that appears only where the ship is excited, which noise can't explain.

Noise does not depend on the excitation, but the error of a wrong model does. The residual's power is therefore compared
between stretches in which the response in a band is strong, and stretches in which it is weak.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import stft
from scipy.stats import chi2

from shipfp_rs.identification.estimate import KNOWN, OPEN, Estimate, Usable, WhyNot, is_rough
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import missed_pct
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.residual_tests import INPUT_LAGS
from shipfp_rs.identification.sampling import BEFORE_S
from shipfp_rs.identification.wording import OUTPUTS
from shipfp_rs.structures.names import as_looked_at
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence, listed

STRETCH_S = 20.0
"""Length of a stretch, over which a spectrum is computed [s]."""
STRONG, WEAK = 0.75, 0.5
"""Quantiles of the response's power in a band: above the first a stretch counts as excited, below the second as quiet."""
LOBE = 2.0
"""Half width of the main lobe of the spectra's window (Hann), in bins."""
CHANCE = 3.0
"""Standard deviations of the noise power that are subtracted from an excess, so that chance does not count as a misfit."""

SELDOM = 0.99
"""Level of the systematic errors' chi-squared law up to which they are attributed to gauge and calibration."""


def strain(likelihood: Likelihood, vector: Array) -> float:
    """Return the squared size of the fit's systematic errors, over the largest that gauge and calibration explain.

    Above 1 the model is wrong: it fits only with errors larger than those of gauge and calibration.
    """
    sizes, unsure = likelihood.smooth_errors(likelihood.residuals(vector))
    told = len(unsure) - float(np.trace(unsure))
    return float(np.sum(sizes**2) / chi2.ppf(SELDOM, max(told, 1.0)))


def misses_pct(likelihood: Likelihood, vector: Array) -> list[float]:
    """Return the misfit of each output, in per cent of its response, over all records."""
    missed = np.zeros(len(likelihood.accuracy))
    scatter = np.zeros(len(likelihood.accuracy))
    size = np.full(len(likelihood.accuracy), 1e-30)
    for index, record in enumerate(likelihood.records):
        rate = record.data_hz / record.down
        begin = int(BEFORE_S * rate)
        model = likelihood.modelled(vector, index)[:, begin:]
        length = min(int(STRETCH_S * rate), model.shape[1] // 4)
        for output, (response, data) in enumerate(zip(model, record.decimated[:, begin:], strict=True)):
            power, left = (
                np.abs(stft(row - row.mean(), rate, nperseg=length, boundary=None, padded=False)[2]) ** 2
                for row in (response, data[: len(response)] - response)
            )
            # Above the band the residual is zero, and the window's main lobe spreads this edge into the band.
            at = np.arange(len(power))
            kept = (at > 0) & (at <= record.band_hz * length / rate - LOBE)
            power, left = power[kept], left[kept]
            strong = power >= np.quantile(power, STRONG, axis=1, keepdims=True)
            weak = power <= np.quantile(power, WEAK, axis=1, keepdims=True)
            quiet = np.sum(left * weak, axis=1) / weak.sum(axis=1)
            missed[output] += np.sum((left - quiet[:, None]) * strong)
            # The standard deviation of a spectral power equals its mean.
            scatter[output] += np.sum(
                quiet**2 * (strong.sum(axis=1) + strong.sum(axis=1) ** 2 / weak.sum(axis=1))
            )
            size[output] += np.sum(power * strong)
    surely = np.maximum(missed - CHANCE * np.sqrt(scatter), 0.0)
    return [float(one) for one in 100.0 * np.sqrt(surely / size)]


def explained_pct(likelihood: Likelihood, vector: Array) -> list[list[float]]:
    """Return the fit 100 (1 - |y - model| / |y - mean(y)|) of each record's outputs in the band."""
    rows = []
    for index, record in enumerate(likelihood.records):
        model = likelihood.modelled(vector, index)
        data = record.decimated
        spread = np.linalg.norm(data - data.mean(axis=1, keepdims=True), axis=1)
        rows.append(
            [
                float(100.0 * (1.0 - a / max(b, 1e-30)))
                for a, b in zip(np.linalg.norm(data - model, axis=1), spread, strict=True)
            ]
        )
    return rows


SMALL_MISS_PCT = 1.6
"""Misfit, as a share of an output's spread, that is acceptable: the error of a calibrated torque gauge (static torque check
of the thesis, eq. 6.3)."""
LARGE_MISS_PCT = 10.0
"""Misfit, as a share of an output's spread, above which a fingerprint is not usable."""
LEAST_EXPLAINED_PCT = 2.0
"""Least explained share of an output's spread, below which the output is not the ship's response."""

MISSES = Sentence("the model misses {share} % of the drive train's response")
GAINS = ("vK_p", "vK_i", "K_p", "K_i")
TO_TUNE = 1.0 / 3.0
"""Relative error of a gain that control tuning tolerates: less than most loops' margins."""


@dataclass(frozen=True)
class Usability:
    """State, sentence and reason of a fingerprint's usability."""

    state: Usable
    sentence: Sentence
    why_not: WhyNot = ""


UNTESTED = Sentence(
    "Usable for simulation and comparison, but not for control tuning: the record is too short for a test of its residuals."
)


def judged(fingerprint: Fingerprint, misses: Mapping[str, float] | None, *, tested: bool) -> Fingerprint:
    """Return the fingerprint of a given structure with its usability.

    `misses` is the misfit of each output [%], None for a record too short for residual tests; `tested`: a structure that its
    residuals do not contradict stands anyway.
    """
    stands = (tested and bool(fingerprint.model_adequate)) or max(
        (misses or {}).values(), default=0.0
    ) <= SMALL_MISS_PCT
    adequate = {"stands": stands, "misses_pct": dict(misses or {})}
    found, lines = usability(replace(fingerprint, adequate=adequate)), fingerprint.verdict
    if misses is None:
        found = found if found.state == "not usable" else Usability("usable except", UNTESTED)
        adequate, lines = dict(fingerprint.adequate), tuple(map(_doubted, lines))
    # A search that did not end in a minimum has a first sentence of its own.
    first = () if found.why_not == "no minimum" else (found.sentence,)
    return replace(
        fingerprint,
        adequate=adequate,
        verdict=(*first, *lines),
        usable=found.sentence,
        usability=found.state,
        why_not=found.why_not,
    )


def _doubted(line: str) -> str:
    """Return a sentence of the verdict that calls no parameter known."""
    if isinstance(line, Sentence) and line.template == "Known: {estimates}.":
        return Sentence("Estimated, if the structure is right: {estimates}.", **line.values)
    return line


def misses_of(fit: Mapping[str, Mapping[str, float | None]], samples: int) -> dict[str, float]:
    """Return the misfit of each output, in per cent of its spread.

    The misfit is the root of the share of the whitened residual's power that the set point still explains, less the share
    by chance, times the residual.
    """
    misses = {}
    for name, row in fit.items():
        if name == "overall":
            continue
        misses[name] = missed_pct(row, chance=(INPUT_LAGS + 1) / samples)
    return misses


def usability(fingerprint: Fingerprint) -> Usability:
    """Judge the usability of a fingerprint by its estimates and `adequate`."""
    if (why := _why_not(fingerprint)) is not None:
        return why
    share = f"{_worst(fingerprint):.2g}"
    if not fingerprint.adequate["stands"]:
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
    """Whether a gain is accurate to a third, wherever its true value is in the interval."""
    if gain.status == "fixed":
        return True
    if gain.value is None or gain.ci95 is None:
        return False
    low, high = gain.ci95
    return gain.value - low <= TO_TUNE * low and high - gain.value <= TO_TUNE * high


def misfit(fingerprint: Fingerprint) -> Sentence:
    """Name the outputs that the model does not explain, or else the largest misfit."""
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
    """Return the reason why a fingerprint is not usable; None if the fingerprint is usable."""
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
    """Whether an estimate is on a bound and has an interval, for example a delay that may be zero."""
    return estimate.status == "at_bound" and estimate.ci95 is not None
