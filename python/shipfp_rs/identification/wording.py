"""Words of a fingerprint, the same on the terminal and in the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shipfp_rs.identification.estimate import Identifiability
from shipfp_rs.logs.faults.record import KINDS

OUTPUTS: Mapping[str, str] = {
    "dn": "speed",
    "dM": "torque",
    "dE": "integrated speed error",
    "dX": "fuel rack",
    "overall": "all outputs",
}

DOUBT = "look at"
"""What a sentence of a verdict says of a sensor that disagrees with the rest."""

FAULTS: Mapping[str, str] = {
    kind: f"{said} ({kind})" if kind[0].isupper() else said for kind, said in KINDS.items()
}
"""Faults of a log, those of Table 6.10 with their letters."""


def rank(found: Identifiability) -> str:
    """Say how many of the free parameters the data distinguish."""
    if found.rank == found.free:
        return (
            f"The data distinguish all {found.free} free parameters (condition number of the scaled "
            f"sensitivities {found.condition:.3g})."
        )
    return f"The data distinguish {found.rank} of {found.free} free parameters."


def something_missing(adequate: Mapping[str, Any]) -> str:
    """Say what a model that is not quite the ship's misses of each output; empty where nothing is missed."""
    if adequate.get("dispersion", 1.0) <= 1.0:
        return ""
    missed = ", ".join(
        f"{value:.2g} % of the {OUTPUTS.get(name, name)}" for name, value in adequate["misses_pct"].items()
    )
    size = "something small" if adequate["stands"] else "something"
    return f"The residuals show that {size} is missing ({missed}); every interval is widened by what that can do."
