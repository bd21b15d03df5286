"""Fingerprints of ships whose parameters are given."""

from __future__ import annotations

from typing import Any

from shipfp_rs import Structure
from shipfp_rs.identification.estimate import Estimate, Identifiability
from shipfp_rs.identification.fingerprint import Fingerprint

POINT = {"n_set": 1300.0, "n_e": 1300.0, "n_s": 7.2222, "M_b": 222.93, "M_g": 635.35, "M_load": 50.0}
RIGID = {"tau_n": 1.5, "g": -0.6, "vK_p": 5.0, "vK_i": 4.0, "p": 2.1}
SHIPS: dict[str, tuple[str, dict[str, float]]] = {
    "rigid": ("brake", {}),
    "late": ("brake", {"T_d": 0.044, "T_set": 0.212, "tau_act": 0.06, "T_f": 0.011}),
    "sampled": ("brake", {"T_d": 0.06, "T_s": 0.04, "tau_eng": 0.12}),
    "gauge": ("gauge", {"tau_prop": 0.6, "T_d": 0.03, "tau_act": 0.02, "c_2": 0.3, "damping": 0.2}),
    "twisted": (
        "gauge",
        {"tau_prop": 0.7, "tau_twist": 3e-3, "zeta_twist": 0.8, "tau_act": 0.05, "T_d": 0.02},
    ),
    "limited": ("brake", {"M_max": 1.12, "M_soft": 0.01, "rate": 2.0, "tau_act": 0.05, "T_d": 0.03}),
    "ramped": ("brake", {"set_rate": 0.05, "T_d": 0.02, "rate": 1.0}),
    "slope": ("brake", {"vK_d": 0.2, "T_d": 0.028}),
    "derivative": ("brake", {"vK_d": 0.2, "T_f": 0.02, "T_d": 0.02, "tau_act": 0.03}),
    "drooping": ("brake", {"droop": 0.05, "T_d": 0.02, "tau_act": 0.05}),
}
"""Kind of the torque, and parameters beside the rigid ship's."""
OF_PARAMETER = {
    "T_d": "dead_time_loop",
    "T_set": "dead_time_set_point",
    "tau_act": "actuator_lag",
    "T_f": "speed_filter",
    "tau_eng": "engine_lag",
    "vK_d": "derivative",
    "droop": "droop",
    "T_s": "sampling",
    "M_max": "torque_limit",
    "rate": "rack_rate",
    "set_rate": "set_rate",
    "tau_twist": "twist",
    "damping": "damping",
    "c_2": "curvature",
    "k_L": "load",
}


def known_ship(torque: str = "brake", unknown: str = "", **more: float) -> Fingerprint:
    """Return the fingerprint of a ship with these parameters; the data do not determine `unknown`."""
    elements = [OF_PARAMETER[name] for name in more if name in OF_PARAMETER]
    structure = Structure.ship(elements, torque=torque, mean_sampling=True)
    values = {**{one.name: one.start for one in structure.parameters}, **RIGID, **more}
    rows: dict[str, Any] = {
        name: Estimate(None, status="unidentifiable", reason="the data allow any value")
        if name == unknown
        else Estimate(value, status="fixed")
        for name, value in values.items()
    }
    return Fingerprint(
        parameters=rows,
        derived={},
        identifiability=Identifiability(rank=0, free=0, condition=1.0),
        fit={},
        structure=structure.to_dict(),
        vessel="tug",
        data=(
            {
                "name": "trial",
                "signals": {"dn": "n_e", "dM": "M_g" if torque == "gauge" else "M_b"},
                "operating_point": POINT,
            },
        ),
        settings={"optimum": values, "criterion": 0.0, "converged": True, "message": "", "minima": []},
    )
