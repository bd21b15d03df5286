"""Identifiable quantities of a trial: parameters, and combinations of those that are only known together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.designs.subject import Subject
from shipfp_rs.identification.estimate import Status
from shipfp_rs.identification.identifiability import NULL_PART, Sensitivity, gradient_of
from shipfp_rs.structures.combinations import COMBINATIONS
from shipfp_rs.support.arrays import Array


@dataclass(frozen=True)
class Quantity:
    """Expected value, unit, and slopes with respect to the free parameters, shape (P,)."""

    value: float
    unit: str
    gradient: Array
    status: Status = "free"


def quantities(subject: Subject, sensitivity: Sensitivity) -> dict[str, Quantity]:
    """Identifiable quantities: parameters first, then combinations with members that are not known separately."""
    alone = dict(zip(sensitivity.names, np.linalg.norm(sensitivity.null, axis=0) <= NULL_PART, strict=True))
    found = {
        parameter.name: Quantity(
            subject.values[parameter.name],
            parameter.unit,
            row,
            "free" if parameter.prior is None else "prior",
        )
        for parameter, row in zip(subject.structure.free, np.eye(len(subject.free)), strict=True)
        if alone[parameter.name]
    }
    for name, (unit, function) in COMBINATIONS.items():
        try:
            value = function(subject.values)
            gradient = gradient_of(function, subject.values, subject.free, subject.structure.ties)
        except (KeyError, ZeroDivisionError):
            continue
        joined = any(
            slope and not alone[member] for member, slope in zip(subject.free, gradient, strict=True)
        )
        if joined and sensitivity.tells(gradient):
            found[name] = Quantity(value, unit, gradient)
    return found
