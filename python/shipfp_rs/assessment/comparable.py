"""Whether fingerprints can be compared at all, with which elements, and what weakens it if they can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.automatic import FULL_SHIP
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.question import TRIED
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.ties import declared

SPEED_APART = 0.05
"""Operating speeds that differ by more than this part are two operating points: every parameter depends on it."""
TORQUE_APART = 0.05
"""Operating torques that differ by more than this part are worth a word: tau_n is relative to them."""


def with_common_elements(
    fingerprints: Sequence[Fingerprint], data: Sequence[Sequence[Experiment]] | None
) -> tuple[list[Fingerprint], list[str]]:
    """Return fingerprints of the full ship that all have the elements that one of them shows, fitted again where need be.

    Parameters
    ----------
    fingerprints
        Two or more; those of a given structure are returned as they are.
    data
        The experiments of each; None: not at hand.

    Raises
    ------
    InputError
        Where one has to be fitted again, and its experiments are not given.
    """
    acting = {
        name for one in fingerprints for name in TRIED if one.elements.get(name, {}).get("state") == "on"
    }
    names = {name for element in acting for name in TRIED[element]}
    lacking = [one for one in fingerprints if not names <= set(one.parameters)]
    if not lacking or any(one.settings.get("structure") != FULL_SHIP for one in fingerprints):
        return list(fingerprints), []
    words = " and ".join(ELEMENTS[name].words for name in TRIED if name in acting)
    if data is None:
        raise InputError(
            f"{len(lacking)} of {len(fingerprints)} fingerprints have no {words}, expected the same elements in all; give "
            "data, the experiments of each, to fit them again with it, or keep experiments.parquet beside fingerprint.json"
        )
    if len(data) != len(fingerprints):
        raise InputError(f"data of {len(data)} fingerprints, expected those of {len(fingerprints)}")
    found = [
        one
        if one not in lacking
        else identify(
            experiments,
            elements={name: name in acting for name in TRIED},
            torque=one.structure["torque"],
            outputs=one.structure["outputs"],
            fixed={
                name: estimate.value
                for name, estimate in one.parameters.items()
                if estimate.status == "fixed" and estimate.reason == "given" and estimate.value is not None
            },
            vessel=one.vessel,
            seed=one.seed,
        )
        for one, experiments in zip(fingerprints, data, strict=True)
    ]
    return found, [
        f"{len(lacking)} of {len(fingerprints)} fingerprints were fitted again with {words}, which another one shows"
    ]


def require_comparable(before: Fingerprint, after: Fingerprint) -> tuple[str, ...]:
    """Raise where a difference would mean nothing, return remarks on what weakens it."""
    if before.vessel and after.vessel and before.vessel != after.vessel:
        raise InputError(f"fingerprints of {before.vessel!r} and {after.vessel!r}; expected the same ship")
    for key in ("kind", "torque", "outputs"):
        one, other = before.structure.get(key), after.structure.get(key)
        if one != other:
            raise InputError(
                f"structures differ in {key}, {one!r} and {other!r}, so their parameters mean different things; identify "
                "both logs with the same structure"
            )
    if set(before.parameters) != set(after.parameters):
        apart = ", ".join(sorted(set(before.parameters) ^ set(after.parameters)))
        raise InputError(f"only one structure has {apart}; identify both logs with the same structure")
    for label, fingerprint in (("first", before), ("second", after)):
        if not fingerprint.settings.get("converged", True):
            raise InputError(
                f"the {label} fingerprint's search ended in no minimum ({fingerprint.settings.get('message')}); identify "
                "that log again"
            )
    for name, estimate in before.parameters.items():
        other = after.parameters[name]
        if estimate.unit != other.unit:
            raise InputError(
                f"{name} is in {estimate.unit!r} in the first fingerprint and in {other.unit!r} in the second; expected "
                "the same unit"
            )
        if (estimate.status == "fixed") != (other.status == "fixed") or (
            estimate.status == "fixed" and estimate.value != other.value
        ):
            raise InputError(
                f"{name} was {_given(estimate)} in the first fingerprint and {_given(other)} in the second, and the other "
                "parameters lean on it; identify both the same way"
            )
    ties = declared(before.structure), declared(after.structure)
    for name in {**ties[0], **ties[1]}:
        one, two = (str(of.get(name, "on its own")) for of in ties)
        if one != two:
            raise InputError(
                f"{name} was {one} in the first fingerprint and {two} in the second; tie both the same way"
            )
    remarks = _operating_points(before, after)
    leaning = [name for name, estimate in before.parameters.items() if estimate.status == "prior"]
    if leaning:
        remarks.append(f"{', '.join(leaning)}: both lean on a prior, which hides part of a change")
    return tuple(remarks)


def _given(estimate: Estimate) -> str:
    return (
        f"given as {estimate.value:g}"
        if estimate.status == "fixed" and estimate.value is not None
        else "estimated"
    )


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
