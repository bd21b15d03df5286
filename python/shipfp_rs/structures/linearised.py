"""Linearisation of a structure as a drive train: transfer functions, and a state space with approximated dead times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.structures.state_space import Wiring, wired
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.transfer import Place, TransferFunctions, loop_parameters
from shipfp_rs.support.arrays import Array, Values

KINDS = ("linear", "ship")
"""Kinds of structures that can be linearised."""


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u, y = C x + D u, with u the set point and y the outputs in their order."""

    A: Array
    B: Array
    C: Array
    D: Array
    outputs: tuple[str, ...]

    def step(self, times: Array) -> Array:
        """Return the outputs (O, N) after a step of the input at time 0, at times (N,) [s]."""
        poles, modes = np.linalg.eig(self.A)
        parts = np.linalg.solve(modes, self.B)
        grown = np.expm1(np.outer(poles, times)) * (parts / poles)[:, None]
        return np.asarray((self.C @ modes @ grown).real + self.D[:, None])


def require_linear(structure: Structure) -> None:
    """Raise `InputError` for a structure that can't be linearised as a drive train."""
    if structure.settings.get("kind") not in KINDS:
        raise InputError(
            f"structure {structure.name!r} of the fingerprint is not linear, expected one of kind {', '.join(KINDS)}; "
            "other kinds have no poles"
        )


def loop_of(structure: Structure, values: Values) -> tuple[TransferFunctions, dict[str, float]]:
    """Return a structure's transfer functions about its operating point, and their parameter values."""
    require_linear(structure)
    place: Place = "engine"
    if structure.settings.get("propeller_speed"):
        place = "propeller"
    mean = bool(structure.settings.get("mean_sampling"))
    known = loop_parameters(structure.complete(values), mean_sampling=mean)
    return TransferFunctions(structure.outputs, "tau_prop" in structure.names, place), known


def state_space(
    structure: Structure,
    values: Values,
    order: int = 3,
) -> StateSpace:
    """Return the linearisation as a state space; `order` is that of each dead time's Pade approximation."""
    equations, q = loop_of(structure, values)
    wiring = Wiring(order)
    rows = wired(q, wiring, gauge=equations.gauge, propeller_speed=equations.speed == "propeller")
    model = wiring.model([rows[output] for output in equations.outputs])
    A, B, C, D = (part[0].real for part in model[:4])
    return StateSpace(A, B[:, 0], C, D[:, 0], equations.outputs)
