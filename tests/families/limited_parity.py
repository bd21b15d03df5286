"""Limited ships of the families beside the package's own simulation at exactly the true parameters.

    python -m tests.families.limited_parity --seconds 120

Cells are deviations of the differences of speed / torque over those of the signal, both behind one low-pass of 4 Hz.
"same" is the set point at steps of 0.5 ms and no water; each other column changes one thing: "5 ms" the stepper's step,
"50 Hz" a set point that is low-passed and sampled as data are, "mean T_s" a sampling governor as dead time and hold, "soft"
the least rounding of the torque limit in a fit, "c_2" the drift of the exponent (here N^(p + c_2 (N - 1)), in the package
N^p + c_2 (N - 1)^2), "water" moving water that the simulation has not, "driven" the true water as its load.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from scipy.signal import firwin

from shipfp_rs import _core
from shipfp_rs.identification.question import SHARPEST
from shipfp_rs.structures.ship import INDEX, KERNEL
from shipfp_rs.support.interpolation import interpolated
from tests.families import sensors
from tests.families.draw import STEP_S as H
from tests.families.draw import Draw, draw
from tests.families.plant import LIMITS, normalised, without
from tests.families.small_steps import Motion, simulate

STEP_S = 0.005
"""Step of the package where data are low-passed [s]."""
FAMILIES = ("tug", "lab_drive", "genset")
COLUMNS = ("same", "5 ms", "50 Hz", "mean T_s", "soft", "c_2", "water", "driven")
SEEN_HZ, FIRST = 4.0, 170_000


def parameters(relative: dict[str, float]) -> np.ndarray:
    found = np.array(_core.SHIP_OFF)
    found[INDEX["v"]] = 1.0
    for name, value in relative.items():
        found[INDEX[KERNEL.get(name, name)]] = value
    found[INDEX["rate_down"]] = relative["rate"]
    return found


def without_sampling(relative: dict[str, float]) -> dict[str, float]:
    # As a fit sees it: half a period more of dead time, of which that part is a hold.
    half, late = 0.5 * relative["T_s"], relative["T_d"] + 0.5 * relative["T_s"]
    gain = relative["vK_p"] + (half if relative["update"] else -half) * relative["vK_i"]
    return relative | {"T_d": late, "hold": half / late, "vK_p": gain, "T_s": 0.0, "T_0": 0.0}


def seen(signals: np.ndarray, rate_hz: float, start_s: float) -> np.ndarray:
    """Low-pass signals (O, N) and return them at 50 Hz from the excitation on."""
    factor = round(rate_hz / sensors.COMMON_HZ)
    taps = firwin(
        2 * round(0.3 * rate_hz) // factor * factor + 1, SEEN_HZ, window=("kaiser", 8.0), fs=rate_hz
    )
    rows = [sensors.decimated(row, taps, factor) for row in signals]
    return np.array(rows)[:, round(start_s * sensors.COMMON_HZ) :]


class Parity:
    def __init__(self, drawn: Draw):
        self.draw, self.straight = drawn, replace(drawn, plant=without(drawn.plant, "c_2"))
        self.torque = ("dM_g", "gauge_torque") if drawn.place == "gauge" else ("dM_b", "brake_torque")

    def motion(self, drawn: Draw, *, wet: bool = False) -> Motion:
        end = drawn.excitation.stop_s
        return simulate(drawn.plant, drawn.excitation, end, step_s=H, water=drawn.water if wet else None)

    def generated(self, motion: Motion) -> np.ndarray:
        plant = self.draw.plant
        torque = getattr(motion, self.torque[1])
        mean = plant.shaft_torque if self.draw.place == "gauge" else plant.brake_torque
        both = np.array([motion.engine_speed / plant.engine_speed, torque / mean]) - 1.0
        return seen(both, 1.0 / H, self.draw.excitation.start_s)

    def stepped(self, relative, set_point, rate_hz=1.0 / H, substeps=1, load=None) -> np.ndarray:
        outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", self.torque[0])]
        vector = parameters(relative | ({"k_L": 1.0} if load is not None else {}))
        load = np.empty(0) if load is None else load
        set_point = np.ascontiguousarray(set_point)
        found = _core.simulate_ship(vector, set_point, load, 1.0 / rate_hz, substeps, "first", outputs)
        return seen(found, rate_hz, self.draw.excitation.start_s)

    def differences(self) -> dict[str, np.ndarray]:
        """Return (speed, torque) differences by column; a column that has no meaning for the ship is left out."""
        true, dry = normalised(self.straight.plant), self.motion(self.straight)
        asked, base = dry.asked / self.draw.plant.engine_speed, self.generated(dry)
        every = round(STEP_S / H)
        logged = sensors.to_common(sensors.to_middle(asked, H))
        fine = interpolated(logged, round(1.0 / (STEP_S * sensors.COMMON_HZ)))
        pairs = {
            "same": (base, self.stepped(true, asked)),
            "5 ms": (base, self.stepped(true, asked[::every], 1.0 / STEP_S)),
            "50 Hz": (base, self.stepped(true, fine, 1.0 / STEP_S, every)),
        }
        if true["T_s"]:
            pairs["mean T_s"] = base, self.stepped(without_sampling(true), asked)
        if np.isfinite(true["M_max"]):
            pairs["soft"] = base, self.stepped(true | {"M_soft": SHARPEST}, asked)
        if self.draw.plant.exponent_drift:
            bent = self.generated(self.motion(self.draw))
            pairs["c_2"] = bent, self.stepped(normalised(self.draw.plant), asked)
        if self.draw.water:
            wet = self.motion(self.straight, wet=True)
            moved = self.generated(wet)
            speed = wet.load_speed / self.draw.plant.shaft_speed
            load = self.draw.water(np.arange(len(asked)) * H) * speed ** true["p"]
            pairs["water"] = moved, self.stepped(true, asked)
            pairs["driven"] = moved, self.stepped(true, asked, load=load)
        return {name: _apart(*pair) for name, pair in pairs.items()}


def _apart(generated: np.ndarray, stepped: np.ndarray) -> np.ndarray:
    count = min(generated.shape[1], stepped.shape[1])
    return (stepped[:, :count] - generated[:, :count]).std(axis=1) / generated.std(axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120.0)
    options = parser.parse_args()
    began, seed, found = time.monotonic(), FIRST, {}
    print(f"{'':22}" + "".join(f"{name:>19}" for name in COLUMNS))
    while time.monotonic() - began < options.seconds:
        family = FAMILIES[(seed - FIRST) % len(FAMILIES)]
        drawn = draw(family, seed, load=False, longest_s=250.0)
        seed += 1
        if not set(LIMITS) & set(drawn.on):
            continue
        rows, kind = Parity(drawn).differences(), "rate" if "rate" in drawn.on else "torque"
        kind += ", steps" if drawn.excitation.kind == "steps" else ", smooth"
        for name, pair in rows.items():
            found.setdefault(kind, {}).setdefault(name, []).append(pair)
        _show(f"{family} {seed - 1}", rows)
        print(f"  {drawn.excitation.kind}: {', '.join(drawn.on)}", flush=True)
    for kind, rows in sorted(found.items()):
        _show(f"median, {kind}", {name: np.median(pairs, axis=0) for name, pairs in rows.items()})
        print(f"  {len(rows['same'])} ships")


def _show(title, rows) -> None:
    cells = (f"{rows[name][0]:.1e} / {rows[name][1]:.1e}" if name in rows else "" for name in COLUMNS)
    print(f"{title:22.22}" + "".join(f"{cell:>19}" for cell in cells), end="")


if __name__ == "__main__":
    main()
