"""Data of a fingerprint for a block diagram: parameters that act, operating point, names of the signals."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.exports.blocks import Block, Model, ship_blocks
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.elements import LAGS, QUANTITIES
from shipfp_rs.structures.ship import KERNEL, ShipEquations
from shipfp_rs.structures.structure import Structure

LEAST_S = 1e-4
"""Lag or dead time [s] below which it is omitted: its effect on the speed is then below 1e-4 of a step."""
UNITS = {"n_e": "rpm", "n_set": "rpm", "n_s": "rev/s"}
"""Units of the signals that are not torques; torques are in Nm."""


def require_known(fingerprint: Fingerprint) -> None:
    """Raise `InputError` for a fingerprint without usable values of drive and governor."""
    if not fingerprint.engine_described:
        raise InputError(
            "fingerprint: found the load alone, expected gains too; see its verdict for the trial that tells them"
        )
    if fingerprint.usability == "not usable":
        raise InputError(f"fingerprint: found {fingerprint.usable!r}, expected a usable one; see its verdict")


@dataclass(frozen=True)
class Drive:
    """The ship of a fingerprint, ready for a block diagram."""

    name: str
    blocks: tuple[Block, ...]
    parameters: dict[str, float]
    inputs: dict[str, str]
    """Signal of each input block, such as "M_load" of "load"."""
    outputs: dict[str, str]
    """Signal of each output block, such as "n_e" of "speed"; its operating point is the parameter "n_e_0"."""
    undetermined: tuple[str, ...]
    """Parameters that the data determine only together with others."""

    @classmethod
    def of(cls, fingerprint: Fingerprint) -> Drive:
        """Return a fingerprint's ship; `InputError` if it is no ship with a continuous governor, or a value is unknown."""
        require_known(fingerprint)
        structure = Structure.from_dict(fingerprint.structure)
        equations, row = structure.equations, fingerprint.data[0] if fingerprint.data else {}
        if structure.settings.get("kind") != "ship" or not isinstance(equations, ShipEquations):
            raise InputError(
                f"structure {structure.name!r}: found no ship with a governor, expected `Structure.ship`"
            )
        values = structure.complete(fingerprint.optimum)
        vector = dict(zip(_core.SHIP_PARAMETERS, equations.vector(values).tolist(), strict=True))
        if vector["T_s"]:
            raise InputError(
                "T_s: found a governor with a clock, expected `mean_sampling`, as `identify` uses by itself"
            )
        off = dict(zip(_core.SHIP_PARAMETERS, _core.SHIP_OFF, strict=True))
        own = {KERNEL.get(name, name): name for name in values}
        q = {
            own.get(name, name): value
            for name, value in vector.items()
            if value != off[name] and not (name in LAGS and value < LEAST_S)
        }
        q |= {name: values[name] for name in ("set_rate",) if name in values}
        if q["v"] == 1.0:
            del q["v"]
        loaded = equations.loaded and "k_L" in q
        gauge, place = equations.gauge, row.get("operating_point", {})
        signals = row.get("signals", {})
        speed = "propeller speed" if equations.propeller_speed and "tau_twist" in q else "speed"
        outputs = {speed: signals.get("dn", "n_e")}
        if "dM" in structure.outputs:
            outputs["torque"] = signals.get("dM", "M_b")
        inputs = {"n_set": "n_set"} | ({"load": "M_load"} if loaded else {})
        for signal in (*inputs.values(), *outputs.values()):
            if signal not in place:
                raise InputError(
                    f"data: found no operating point of {signal}, expected one to give signals their units"
                )
        if loaded:
            apart = {"n_set": np.zeros(2), "M_load": place["M_load"] + np.arange(2.0)}
            record = Experiment("load", 1.0, apart, place, provenance={"load": row.get("load", {})})
            q |= {"load_0": place["M_load"], "load_scale": 1.0 / float(record.normalised("M_load")[1])}
        q |= {f"{signal}_0": place[signal] for signal in ("n_set", *outputs.values())}
        blocks = tuple(ship_blocks(q, gauge=gauge, loaded=loaded))
        used = {word for block in blocks for word in re.findall(r"[A-Za-z_]\w*", block.value)}
        q = {name: value for name, value in q.items() if name in used or name.endswith("_0")}
        try:
            Model(blocks, q)
        except ValueError as error:
            raise InputError(f"vK_d: found {error}, expected T_d, tau_act or T_f beside it") from error
        open_ones = [name for name, one in fingerprint.parameters.items() if name in q and one.value is None]
        return cls(fingerprint.vessel or "ship", blocks, q, inputs, outputs, tuple(open_ones))

    def described(self, name: str) -> str:
        """Return the unit of a parameter or signal, and whether the data determine it."""
        signal = name.removesuffix("_0")
        unit = UNITS.get(signal, "Nm" if signal.startswith(("M_", "load")) else "-")
        unit = QUANTITIES[name].unit if name in QUANTITIES else unit
        return f"[{unit}]" + (", determined only together with others" if name in self.undetermined else "")
