"""Usability of a fingerprint: state and sentence of the first rule of an ordered list that applies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shipfp_rs.identification.adequacy import LARGE_MISS_PCT, LEAST_EXPLAINED_PCT
from shipfp_rs.identification.engine_tests import LIMITS
from shipfp_rs.identification.estimate import KNOWN, OPEN, Estimate, Usable, WhyNot, is_rough
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.question import BOUNDS, PRIORS, within_reach
from shipfp_rs.identification.sides import KINDS
from shipfp_rs.identification.wording import OUTPUTS
from shipfp_rs.structures.names import as_looked_at
from shipfp_rs.support.sentences import Sentence, listed

GAINS = ("vK_p", "vK_i", "K_p", "K_i")
TO_TUNE = 1.0 / 3.0
"""Relative error of a gain that control tuning tolerates: less than most loops' margins."""
BEHIND_A_GAUGE = 0.9
"""Share of the inertia behind the sensor, above which a torque called gauge is probably the brake's: brake torques show 0.95
to 1, gauges of the test ships up to 0.7."""
ALWAYS = ("tau_n", "g", "p", "vK_p", "vK_i")
"""Parameters of every ship; a value at the end of the search range is not plausible for them."""
AT_BOUND = 1e-6


@dataclass(frozen=True)
class Case:
    """A fingerprint to be judged, and test results of its fit."""

    fingerprint: Fingerprint
    kind: str | None = None  # of `sides.KINDS`: contradiction to the model's drive and governor
    strain: float = 0.0  # size of the systematic errors, see `adequacy.strain`
    is_short: bool = False  # whether the records are too short for a test of their residuals

    @property
    def stands(self) -> bool:
        """Whether the residuals are consistent with the model."""
        return bool(self.fingerprint.adequate.get("stands", True))

    @property
    def missed_pct(self) -> float:
        """Largest misfit of an output [%]."""
        return float(max(self.fingerprint.adequate.get("misses_pct", {}).values(), default=0.0))

    @property
    def is_whole(self) -> bool:
        """Whether the whole model is judged, not only the load."""
        return self.kind is None or not self.fingerprint.load_side

    @property
    def tells_nothing(self) -> bool:
        """Whether no parameter is known."""
        return not any(one.status in KNOWN for one in self.fingerprint.parameters.values())

    @cached_property
    def unexplained(self) -> list[Sentence]:
        """Outputs of which the model explains nothing."""
        return [
            Sentence("the {name}", name=Sentence(OUTPUTS.get(name, name)))
            for name, row in self.fingerprint.fit.items()
            if name != "overall"
            and (share := row.get("nrmse_pct")) is not None
            and share < LEAST_EXPLAINED_PCT
        ]

    @cached_property
    def ended(self) -> list[str]:
        """Parameters of every ship that are at an end of the search range."""
        return [name for name, one in self.fingerprint.parameters.items() if _is_on_bound(name, one)]

    @cached_property
    def behind(self) -> float:
        """Share of the inertia behind the gauge; 0 for a brake torque."""
        behind, whole = (self.fingerprint.parameters.get(name) for name in ("tau_prop", "tau_n"))
        if "tau_prop" not in self.fingerprint.load_side or behind is None or whole is None:
            return 0.0
        return (behind.value or 0.0) / (whole.value or np.inf)

    @cached_property
    def unknown(self) -> list[str]:
        """Parameters that the data neither determine nor limit from one side."""
        return as_looked_at(
            name
            for name, one in self.fingerprint.parameters.items()
            if not (one.status in (*KNOWN, "fixed") or (one.status == "at_bound" and one.ci95 is not None))
            or is_rough(one, OPEN)
        )

    @cached_property
    def rough(self) -> list[str]:
        """Parameters that are known only roughly."""
        return as_looked_at(
            name
            for name, one in self.fingerprint.parameters.items()
            if one.status in KNOWN and name not in self.unknown and is_rough(one)
        )

    @cached_property
    def unsure(self) -> list[str]:
        """Gains that may be too far off for control tuning."""
        known = self.fingerprint.parameters
        return as_looked_at(name for name in GAINS if name in known and not _tunes(known[name]))

    @property
    def ends_at_meter(self) -> bool:
        """Whether the model ends at a torque meter, behind which nothing is known."""
        return self.fingerprint.ends_at_meter and not self.fingerprint.behind_meter

    @property
    def is_limited(self) -> bool:
        """Whether a limit of torque or rate acts."""
        return any(self.fingerprint.elements.get(name, {}).get("state") == "on" for name in LIMITS)


def _is_on_bound(name: str, estimate: Estimate) -> bool:
    if name not in ALWAYS or estimate.status not in KNOWN or estimate.value is None:
        return False
    low, high = within_reach(BOUNDS[name], PRIORS.get(name))
    return min(estimate.value - low, high - estimate.value) <= AT_BOUND * (high - low)


def _tunes(gain: Estimate) -> bool:
    """Whether a gain is accurate to a third, wherever its true value is in the interval."""
    if gain.status == "fixed":
        return True
    if gain.value is None or gain.ci95 is None:
        return False
    low, high = gain.ci95
    return gain.value - low <= TO_TUNE * low and high - gain.value <= TO_TUNE * high


@dataclass(frozen=True)
class Usability:
    """State, sentence and reason of a fingerprint's usability."""

    state: Usable
    sentence: Sentence
    why_not: WhyNot = ""


def misfit(case: Case) -> Sentence:
    """Name the outputs that the model does not explain, or else the largest misfit."""
    if case.unexplained:
        return Sentence("the model explains nothing of {outputs}", outputs=listed(case.unexplained))
    return Sentence(MISSES, share=f"{case.missed_pct:.2g}")


MISSES = Sentence("the model misses {share} % of the drive train's response")
UNTESTED = Sentence(
    "Usable for simulation and comparison, but not for control tuning: the record is too short for a test of its residuals."
)
LOAD_ONLY = Sentence(
    "Usable for simulation and comparison of the load's side only: drive and governor are not described ({what}), so "
    "gains, delays and the slope of the drive's torque are not given."
)
NO_GAUGE = Sentence(
    "Usable for simulation and comparison, but not for control tuning: the torque is hardly a gauge's, since {behind} % of "
    "the inertia would lie behind it. If it is the drive's own, say torque = brake: tau_n and the gains are now too large "
    "by about {over} %."
)
MISSED = Sentence(
    "Usable for simulation and comparison, but not for control tuning: its intervals hold for the model, not for "
    "the drive train, of whose response the model misses {share} %."
)
TO_THE_METER = Sentence(
    "Usable for simulation and comparison, but not for control tuning: the model ends at the load's torque meter."
)
BENT = Sentence(
    "Usable for simulation and comparison, but not for control tuning: its intervals hold for the model, not for the drive "
    "train; both agree only if the channels are wrong by more than a calibration allows."
)
LIMITED = Sentence(
    "Usable for simulation and comparison, but not for control tuning: a limit of torque or rate acts, and on simulated "
    "ships with such a limit fewer than nine intervals in ten held the true value."
)
Rule = tuple[Usable, WhyNot, Callable[[Case], object], Sentence]
RULES: tuple[Rule, ...] = (
    (
        "not usable",
        "no minimum",
        lambda case: case.is_whole and not case.fingerprint.settings.get("converged", True),
        Sentence("Not usable, because the search did not end in a minimum; no figure is an estimate."),
    ),
    (
        "not usable",
        "nothing explained",
        lambda case: case.is_whole and case.unexplained,
        Sentence("Not usable, because {what}."),
    ),
    (
        "not usable",
        "nothing told",
        lambda case: case.is_whole and case.tells_nothing,
        Sentence("Not usable, because the data determine no parameter."),
    ),
    (
        "not usable",
        "misfit",
        lambda case: case.is_whole and not case.stands and case.missed_pct > LARGE_MISS_PCT,
        Sentence("Not usable, because {what}."),
    ),
    (
        "not usable",
        "misfit",
        lambda case: case.ended,
        Sentence(
            "Not usable, because the search ended at a bound of {names}; the model does not describe this ship."
        ),
    ),
    ("usable except", "", lambda case: case.is_short, UNTESTED),
    ("usable except", "", lambda case: case.kind, LOAD_ONLY),
    ("usable except", "", lambda case: case.behind > BEHIND_A_GAUGE, NO_GAUGE),
    ("usable except", "", lambda case: not case.stands, MISSED),
    (
        "usable except",
        "",
        lambda case: case.unknown and case.rough,
        Sentence(
            "Usable for simulation and comparison, but not for control tuning: the data do not determine {unknown}, for "
            "which other values fit as well, and give {rough} only roughly."
        ),
    ),
    (
        "usable except",
        "",
        lambda case: case.unknown,
        Sentence(
            "Usable for simulation and comparison, but not for control tuning: the data do not determine {unknown}, for "
            "which other values fit as well."
        ),
    ),
    (
        "usable except",
        "",
        lambda case: case.unsure,
        Sentence(
            "Usable for simulation and comparison, but not for control tuning: {gains} may be off by more than a third."
        ),
    ),
    ("usable except", "", lambda case: case.ends_at_meter, TO_THE_METER),
    ("usable except", "", lambda case: case.strain > 1.0, BENT),
    ("usable except", "", lambda case: case.is_limited, LIMITED),
    (
        "usable",
        "",
        lambda case: case.rough,
        Sentence(
            "Usable for simulation, control tuning and comparison: the data determine every parameter, but {rough} "
            "only roughly."
        ),
    ),
    (
        "usable",
        "",
        lambda case: True,
        Sentence("Usable for simulation, control tuning and comparison: the data determine every parameter."),
    ),
)
"""Rules: state, reason if nothing is usable, predicate, sentence. The first rule whose predicate is true decides."""


def usability(case: Case) -> Usability:
    """Return the usability of a case."""
    state, why_not, _, sentence = next(rule for rule in RULES if rule[2](case))
    behind = max(min(case.behind, 1.0), 1e-9)
    contradicted = state != "not usable" and case.kind not in (None, "misfit")
    values = {
        "what": KINDS[case.kind or ""] if contradicted else misfit(case),
        "names": listed(case.ended),
        "behind": f"{100.0 * behind:.0f}",
        "over": f"{100.0 / behind - 100.0:.1f}",
        "share": f"{case.missed_pct:.2g}",
        "unknown": listed(case.unknown),
        "rough": listed(case.rough),
        "gains": listed(case.unsure),
    }
    return Usability(state, Sentence(sentence, **values), why_not)
