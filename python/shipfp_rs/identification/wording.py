"""Phrases of a fingerprint that the terminal and the report share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from shipfp_rs.identification.estimate import Identifiability
from shipfp_rs.logs.faults.record import KINDS
from shipfp_rs.support.sentences import Sentence, joined, listed

OUTPUTS: Mapping[str, str] = {
    "dn": "speed",
    "dM": "torque",
    "dE": "integrated speed error",
    "dX": "fuel rack",
    "dM_b": "brake torque",
    "overall": "all outputs",
}

DOUBT = "look at"
"""Phrase in the verdict's sentences on a sensor that disagrees with the others."""

FAULTS: Mapping[str, str] = {
    kind: f"{said} ({kind})" if kind[0].isupper() else said for kind, said in KINDS.items()
}
"""Faults of a log, with the letters of Table 6.10."""


def rank(found: Identifiability, unknown: Sequence[str] = (), helped: Sequence[str] = ()) -> Sentence:
    """Say how many free parameters the data determine: all but `unknown`, and `helped` only together with their priors."""
    if helped:
        helps = Sentence(
            "Of these, {names} are told only with the help of an expected range.", names=listed(helped)
        )
        return joined([rank(found, unknown), helps], " ")
    if found.rank < found.free:
        return Sentence(
            "The data determine {rank} independent combinations of the {free} free parameters.",
            rank=found.rank,
            free=found.free,
        )
    if unknown:
        return Sentence(
            "The data determine {known} of the {free} free parameters, but not {unknown}.",
            known=found.free - len(unknown),
            free=found.free,
            unknown=listed(unknown),
        )
    if not math.isfinite(found.condition):
        return Sentence("All {free} free parameters are identifiable.", free=found.free)
    return Sentence(
        "All {free} free parameters are identifiable (condition number of the scaled sensitivities {condition}).",
        free=found.free,
        condition=f"{found.condition:.3g}",
    )


def missed(adequate: Mapping[str, Any]) -> Sentence:
    """Say which share of each output's response the model misses; empty if unknown."""
    return joined(
        [
            Sentence(
                "{share} % of the {output}", share=f"{value:.2g}", output=Sentence(OUTPUTS.get(name, name))
            )
            for name, value in adequate.get("misses_pct", {}).items()
            if value is not None
        ]
    )
