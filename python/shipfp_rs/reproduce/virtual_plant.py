"""The nonlinear plant of a vessel as a structure, in the linear structure's parameters (eq. 3.1 to 3.11)."""

from __future__ import annotations

import dataclasses

import numpy as np

from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

SUBSTEPS = 30
"""Steps a sample of 0.02 s: data without noise show what the kernel's own step of 4 ms leaves."""


def plant_structure(vessel: Vessel) -> Structure:
    """Return the ship with exponent 2 below the torque envelope of a vessel."""
    ship = Structure.ship(name="plant").with_fixed(p=2.0)
    assert isinstance(ship.equations, ShipEquations)
    speed, torque = vessel.envelope()
    points = np.stack([speed / vessel.nominal_engine_speed, torque / vessel.nominal_brake_torque], axis=1)
    equations = dataclasses.replace(
        ship.equations, envelope=tuple((n, M) for n, M in points.tolist()), substeps=SUBSTEPS
    )
    return dataclasses.replace(ship, equations=equations, settings={"kind": "plant"})
