"""Parameters of a structure, and outputs of a drive train with the signals that measure them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.structures import glossary
from shipfp_rs.structures.ties import Tie
from shipfp_rs.support.arguments import check_fields

Torque = Literal["brake", "gauge"]

OUTPUTS = ("dn", "dM", "dE", "dX")
"""Outputs of the ship and of the linear structure: speed, torque, integrated speed error, fuel rack."""
BRAKE = "dM_b"
"""Output for the engine's brake torque, in addition to "dM" of a strain gauge."""


def signals_of(outputs: Sequence[str], torque: Torque) -> dict[str, tuple[str, ...]]:
    """Signals that may measure each output, best first; a torque from another location comes last."""
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
    """Raise `InputError` for unknown or repeated outputs; `both_torques` allows torques of gauge and brake together."""
    known = (*OUTPUTS, BRAKE) if both_torques else OUTPUTS
    for output in outputs:
        if output not in known:
            raise InputError(f"output {output!r}, expected some of {', '.join(known)}")
    if not len(outputs) or len(set(outputs)) != len(outputs):
        raise InputError(f"outputs {list(outputs)}, expected at least one and each once")


def require_no_rack(outputs: Sequence[str], *, dead_time: bool) -> None:
    """Raise `InputError` for the rack output with a dead time in the loop, which the linear structure can't model."""
    if dead_time and "dX" in outputs:
        raise InputError(
            "output 'dX' with dead_time_loop: the linear structure has the governor's command, not the rack behind its dead "
            'time; use Structure.ship(["dead_time_loop"], ...)'
        )


DECADES = 30.0
"""Ratio of positive bounds above which the logarithm of a parameter is searched."""


@dataclass(frozen=True)
class Parameter:
    """A parameter: name, unit, start, bounds; optionally fixed at its start, with a prior (mean, deviation), or tied."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    fixed: bool = False
    prior: tuple[float, float] | None = None
    tied: Tie | None = None

    def __post_init__(self) -> None:
        check_fields(self, f"parameter {self.name}")
        if not np.isfinite(self.start):
            raise InputError(f"parameter {self.name}: start is {self.start}, expected a finite number")
        if self.fixed or self.tied is not None:
            return
        if not self.lower < self.upper:
            raise InputError(
                f"parameter {self.name}: bounds {self.lower:g} to {self.upper:g} hold no value between them"
            )
        if not self.lower <= self.start <= self.upper:
            raise InputError(
                f"parameter {self.name}: start {self.start:g} is outside its bounds {self.lower:g} to {self.upper:g}; "
                "widen the bounds or move the start"
            )
        if self.prior is not None and not (np.isfinite(self.prior[0]) and self.prior[1] > 0):
            raise InputError(
                f"parameter {self.name}: prior {self.prior}, expected a finite mean and a positive standard deviation"
            )

    @property
    def scale(self) -> float:
        """Typical size, used to scale sensitivities."""
        return abs(self.start) if self.start else min(1.0, self.upper - self.lower)

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm of the parameter is searched instead of its value."""
        return self.lower > 0.0 and self.upper / self.lower > DECADES

    def drawn(self, random: np.random.Generator) -> float:
        """Return a random start within the bounds, or near the declared start if there are no bounds."""
        if not np.isfinite([self.lower, self.upper]).all():
            return float(self.start * (1.0 + random.normal()))
        if self.logarithmic:
            return float(np.exp(random.uniform(np.log(self.lower), np.log(self.upper))))
        return float(random.uniform(self.lower, self.upper))

    @property
    def meaning(self) -> str:
        """Short description; empty for a parameter of user equations."""
        return glossary.meaning(self.name)
