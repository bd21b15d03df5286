"""What a simulation was made with, in the names of a fingerprint."""

from __future__ import annotations

from collections.abc import Mapping


def true_values(linear: Mapping[str, float]) -> dict[str, float]:
    """Return the linear parameters and every combination of them that a fingerprint may name."""
    from shipfp_rs.identification.identifiability import COMBINATIONS

    values = dict(linear)
    for name, (_, combine) in COMBINATIONS.items():
        values.setdefault(name, combine(linear))
    return values
