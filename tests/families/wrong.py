"""Data from which no honest answer can name a parameter: channels mixed up, nothing excited, noise, too little.

Each is made from a good draw by the mistake that an engineer or a cable makes; every second is as long as a trial, the
others are short. Right is a refusal, or a fingerprint in which nothing is called known; `harm` names what must not be
called known. Where the mistake spares a parameter (a torque of the wrong sign leaves the speed as it is), it may be told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.families.draw import FAMILIES, draw

KINDS = (
    "set point and speed swapped",
    "set point and torque swapped",
    "load torque as set point",
    "white noise",
    "constant set point",
    "torque of the wrong sign",
    "too few samples",
    "operating point three times too low",
    "speed far out of range",
    "gauge called brake",
    "unrelated set point",
    "torque of another trial",
)
TORQUE = ("p", "tau_n", "tau_prop", "vK_p", "vK_i", "g")


@dataclass(frozen=True)
class Wrong:
    """One wrong data set, as arrays that an experiment is made from, and what must not be called known."""

    kind: str
    seed: int
    experiment: dict[str, Any]
    harm: tuple[str, ...]
    """Parameters; empty: any parameter at all."""


def wrong(seed: int) -> Wrong:
    """Make one of the wrong data sets; kinds follow one another with the seed, and so do families."""
    kind = KINDS[seed % len(KINDS)]
    random = np.random.default_rng([99, seed])
    family = FAMILIES[seed // len(KINDS) % len(FAMILIES)]
    if kind == "gauge called brake":
        family = "tug"
    longest = 320.0 if seed // len(KINDS) % 2 else 201.0
    good = replace(draw(family, 50_000 + seed, load=False, longest_s=longest), late_s=None)
    experiment = good.experiment()
    torque = next(name for name in experiment["signals"] if name.startswith("M_"))
    signals, point = dict(experiment["signals"]), dict(experiment["operating_point"])
    signals, point, harm = _made(kind, signals, point, torque, random, good)
    if kind == "too few samples":
        count = int(random.integers(3, 60))
        begin = int((good.excitation.start_s + random.uniform(0.0, 60.0)) * 50.0)
        signals = {name: one[begin : begin + count] for name, one in signals.items()}
    return Wrong(kind, seed, experiment | {"signals": signals, "operating_point": point}, harm)


def _made(kind, signals, point, torque, random, good):
    count = len(signals["n_set"])
    harm: tuple[str, ...] = ()
    if kind == "set point and speed swapped":
        signals["n_set"], signals["n_e"] = signals["n_e"], signals["n_set"]
    elif kind in ("set point and torque swapped", "load torque as set point"):
        # As the wrong column through the right calibration: a swing of per cents about the operating point.
        as_speed = point["n_set"] * signals[torque] / point[torque]
        if kind == "set point and torque swapped":
            signals[torque] = point[torque] * signals["n_set"] / point["n_set"]
        signals["n_set"] = as_speed
    elif kind == "white noise":
        for name in signals:
            signals[name] = point[name] * (1.0 + 0.02 * random.standard_normal(count))
    elif kind == "constant set point":
        rest = slice(0, int((good.excitation.start_s - 0.5) * 50.0))
        repeats = 5
        for name, one in signals.items():
            # Five times the steady stretch with its noise mirrored, so that no seam shows.
            piece = one[rest]
            whole = [piece if k % 2 == 0 else piece[::-1] for k in range(repeats)]
            signals[name] = np.concatenate(whole)
        signals["n_set"] = np.full(len(signals["n_set"]), point["n_set"])
    elif kind == "torque of the wrong sign":
        signals[torque] = point[torque] * (2.0 - signals[torque] / point[torque])
        harm = TORQUE
    elif kind == "operating point three times too low":
        point = {name: value / 3.0 if name != torque else value for name, value in point.items()}
    elif kind == "speed far out of range":
        for name in ("n_set", "n_e"):
            signals[name], point[name] = signals[name] * 1e6, point[name] * 1e6
    elif kind == "gauge called brake":
        signals["M_b"], point["M_b"] = signals.pop(torque), point.pop(torque)
        harm = ("tau_n", "g")
    elif kind == "unrelated set point":
        signals["n_set"] = np.roll(signals["n_set"], count // 2)[::-1].copy()
    elif kind == "torque of another trial":
        signals[torque] = np.roll(signals[torque], int(count * random.uniform(0.3, 0.7)))
        harm = TORQUE
    return signals, point, harm
