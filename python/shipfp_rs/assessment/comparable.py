"""Whether fingerprints can be compared, with which elements of the model, and with which remarks.

Only values given by the user must be equal in the fingerprints. Structures that the data selected may differ
in an element, and some parameters may be undetermined; this is reported, but does not prevent a comparison.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.identification.estimate import ALONG
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.ship_estimates import FULL_SHIP
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.ties import declared

SPEED_APART = 0.05
"""Relative difference in speed above which operating points differ; every parameter depends on the operating point."""
OF_NO_MATTER = {"dX"}
"""Outputs in which two fingerprints may differ: measuring the rack does not change the meaning of the parameters."""
TORQUE_APART = 0.05
"""Relative difference in operating torque that is reported, since tau_n is relative to the torque."""


def with_common_elements(fingerprints: Sequence[Fingerprint]) -> tuple[list[Fingerprint], list[str]]:
    """Return fingerprints of the full ship with all elements found in any of them, refitted where an element is missing."""
    # They are returned unchanged if the user gave any structure, or if one to be refitted has no experiments.
    acting = {
        name for one in fingerprints for name in TRIED if one.elements.get(name, {}).get("state") == "on"
    }
    names = {name for element in acting for name in TRIED[element]}
    lacking = [one for one in fingerprints if not names <= set(one.parameters)]
    if not lacking or not _chosen(*fingerprints):
        return list(fingerprints), []
    words = " and ".join(ELEMENTS[name].words for name in TRIED if name in acting)
    if not all(one.experiments for one in lacking):
        return list(fingerprints), [
            f"{len(lacking)} of {len(fingerprints)} fingerprints have no {words}, which another fingerprint has, and are "
            "compared unchanged; to fit them again with it, keep experiments.parquet beside fingerprint.json"
        ]
    found = [
        one
        if one not in lacking
        else identify(
            one.experiments,
            elements={name: name in acting for name in TRIED},
            torque=one.structure["torque"],
            outputs=one.structure["outputs"],
            fixed=_given(one),
            vessel=one.vessel,
            seed=one.seed,
        )
        for one in fingerprints
    ]
    return found, [
        f"{len(lacking)} of {len(fingerprints)} fingerprints were fitted again with {words}, which another fingerprint has"
    ]


def require_comparable(before: Fingerprint, after: Fingerprint) -> tuple[str, ...]:
    """Return remarks on circumstances that weaken a comparison; raise `InputError` if the comparison has no meaning."""
    if before.vessel and after.vessel and before.vessel != after.vessel:
        raise InputError(f"fingerprints of {before.vessel!r} and {after.vessel!r}; expected the same ship")
    chosen = _chosen(before, after)
    for key in ("kind", "outputs", "torque"):
        one, other = before.structure.get(key), after.structure.get(key)
        if chosen and key == "outputs":
            one, other = (sorted({*found} - OF_NO_MATTER) for found in (one or (), other or ()))
        if one != other:
            raise InputError(
                f"structures differ in {key}, {one!r} and {other!r}, so their parameters mean different things; identify "
                f"both logs with the same {'structure' if key == 'kind' else key}"
            )
    apart = set(before.parameters) ^ set(after.parameters)
    if apart and not chosen:
        raise InputError(
            f"only one structure has {', '.join(sorted(apart))}; identify both logs with the same structure"
        )
    for label, fingerprint in (("first", before), ("second", after)):
        if not fingerprint.settings.get("converged", True):
            raise InputError(
                f"the search of the {label} fingerprint found no minimum ({fingerprint.settings.get('message')}); identify "
                "that log again"
            )
    both = (before, after)
    given, ties = [_given(one) for one in both], [declared(one.structure) for one in both]
    told: list[tuple[str, list[str], str]] = [
        (name, [f"in {one.parameters[name].unit!r}" for one in both], "; expected the same unit")
        for name in before.parameters
        if name in after.parameters
    ]
    for name in {**given[0], **given[1]}:
        words = [
            f"given as {of[name]:g}" if name in of else "estimated" if name in one else "left out"
            for of, one in zip(given, both, strict=True)
        ]
        told.append((name, words, ", and the other parameters depend on it; identify both the same way"))
    told += [
        (name, [str(of.get(name, "on its own")) for of in ties], "; tie both the same way")
        for name in {**ties[0], **ties[1]}
    ]
    for name, (one, two), advice in told:
        if one != two:
            raise InputError(f"{name} was {one} in the first fingerprint and {two} in the second{advice}")
    remarks = [*_operating_points(before, after), *_alone(before, after)]
    leaning = [name for name, one in before.parameters.items() if one.status == "prior" and name in after]
    if leaning:
        remarks.append(
            f"{', '.join(leaning)}: both estimates depend on a prior, which hides some of a change"
        )
    return tuple(remarks)


def _chosen(*fingerprints: Fingerprint) -> bool:
    """Whether the data selected the elements of all structures, within the full ship."""
    return all(one.settings.get("structure") == FULL_SHIP for one in fingerprints)


def _given(fingerprint: Fingerprint) -> dict[str, float]:
    """Values fixed by the user; values that the search fixed, since the data do not determine them, are left out."""
    return {
        name: estimate.value
        for name, estimate in fingerprint.parameters.items()
        if estimate.status == "fixed" and estimate.reason != ALONG and estimate.value is not None
    }


def _alone(before: Fingerprint, after: Fingerprint) -> Iterator[str]:
    """Yield the quantities that only one of the fingerprints determines."""
    for label, one, other in (("first", before, after), ("second", after, before)):
        known = [name for name, estimate in one.items() if estimate.std]
        names = [name for name in known if name not in other or other[name].value is None]
        if names:
            yield f"known in the {label} fingerprint alone, so not compared: {', '.join(names)}"


def _operating_points(before: Fingerprint, after: Fingerprint) -> list[str]:
    remarks = []
    for signal, tolerance in (
        ("n_set", SPEED_APART),
        ("n_e", SPEED_APART),
        ("M_g", TORQUE_APART),
        ("M_b", TORQUE_APART),
    ):
        one, other = (
            [
                point[signal]
                for entry in fingerprint.data
                if (point := entry.get("operating_point", {})).get(signal) is not None
            ]
            for fingerprint in (before, after)
        )
        if not one or not other:
            continue
        apart = np.mean(other) / np.mean(one) - 1.0
        if abs(apart) <= tolerance:
            continue
        text = f"{signal} is {np.mean(one):.5g} in the first and {np.mean(other):.5g} in the second ({100 * apart:+.1f} %)"
        if signal.startswith("n_"):
            raise InputError(
                f"operating points differ: {text}; every parameter depends on it, so compare trials at one speed"
            )
        remarks.append(
            f"operating torques differ: {text}; tau_n and the governor's factors are relative to them"
        )
    return remarks
