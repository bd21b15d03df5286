"""Outputs of a drive train and the signals that measure them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from shipfp_rs.errors import InputError

Torque = Literal["brake", "gauge"]

OUTPUTS = ("dn", "dM", "dE", "dX")
"""Outputs of the ship and of the linear structure: speed, torque, integrated speed error, fuel rack."""
BRAKE = "dM_b"
"""Output for the brake's torque, where "dM" is a gauge's."""


def signals_of(outputs: Sequence[str], torque: Torque) -> dict[str, tuple[str, ...]]:
    """Signals that may measure each output, best first; other torque locations are used only if nothing else is there."""
    candidates = {
        "dn": ("n_e", "n_s"),
        "dM": ("M_g", "M_s", "M_b") if torque == "gauge" else ("M_b", "M_s", "M_g"),
        "dE": ("E_n",),
        "dX": ("X_f",),
    }
    if BRAKE in outputs:
        candidates |= {"dM": ("M_g",), BRAKE: ("M_b", "M_s")}
    return {output: candidates[output] for output in outputs}


def own_signals(outputs: Sequence[str] | Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Signals for user outputs, or for some of `OUTPUTS`."""
    if isinstance(outputs, Mapping):
        signals: dict[str, tuple[str, ...]] = {output: (signal,) for output, signal in outputs.items()}
    else:
        unknown = [output for output in outputs if output not in OUTPUTS]
        if unknown:
            raise InputError(
                f"output {unknown[0]!r}, expected some of {', '.join(OUTPUTS)}, or a mapping from the outputs to the "
                "signals that measure them"
            )
        signals = signals_of(outputs, "brake")
    if not signals or len(signals) != len(outputs):
        raise InputError(f"outputs {list(outputs)}, expected at least one and each once")
    return signals


def require_outputs(outputs: Sequence[str], *, both_torques: bool = False) -> None:
    """Refuse unknown or repeated outputs; `both_torques`: the brake's torque is allowed besides a gauge's."""
    known = (*OUTPUTS, BRAKE) if both_torques else OUTPUTS
    for output in outputs:
        if output not in known:
            raise InputError(f"output {output!r}, expected some of {', '.join(known)}")
    if not len(outputs) or len(set(outputs)) != len(outputs):
        raise InputError(f"outputs {list(outputs)}, expected at least one and each once")


def require_no_rack(outputs: Sequence[str], *, dead_time: bool) -> None:
    """Refuse the rack of a linear structure with dead time in the loop, which models the rack only without that delay."""
    if dead_time and "dX" in outputs:
        raise InputError(
            "output 'dX' with dead_time_loop: the linear structure has the governor's command, not the rack behind its dead "
            'time; use Structure.ship(["dead_time_loop"], ...)'
        )
