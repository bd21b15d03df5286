"""Which elements of a draw matter, by what they do to the signals against the noise; no fit is involved.

For an element that is on, let D be the difference of speed and torque between the trial and the same trial without the
element, both without noise at 50 Hz behind the last filter. With S(f) the spectrum of the noise that experiments of this
draw have (`sensors.Noise.spectrum`), and D(f) the discrete Fourier transform over sqrt(N), up to `BAND_HZ`:

    size^2     = sum over outputs and frequencies of |D(f)|^2 / S(f)
    distinct^2 = the same of what is left of D after a least-squares projection on what small changes of the other
                 parameters do (tau_n, g, vK_p, vK_i, p, tau_prop behind a gauge, damping, every other element that is on,
                 a dead time in the loop and one of the set point in any case) and on a constant in each output

Both are in standard deviations: `size` tells whether the record could show the element if all else were known exactly,
`distinct` whether it could show it if all else is known only from the same record, to first order. An element *matters*
where distinct >= `MATTERS` (a test at the 1 % level then sees it nearly always), is *idle* below `IDLE`, and between them
is *grey*: there it counts neither as missed nor as found. Because a dead time is always among the others, a sampling
governor or a lag that acts like a mere dead time does not matter, and a dead time that is on is held against the
sampling and the lag that are on beside it. A drifting exponent, moving water and load steps have a size only.

Raw logs have other noise than experiments (pulses, telemetry); for them the same figures are a proxy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.families import sensors
from tests.families.draw import Draw, fast_motion
from tests.families.plant import ELEMENTS, normalised, physical, without

MATTERS, IDLE = 5.0, 1.0
BAND_HZ = 18.0
LEAST_NOISE = 1e-4
"""Deviation that a channel is taken to have at least, white, over its operating point: no model is right to more."""
_STEP = 2e-3
"""Relative change for the sensitivities."""
_LEAST = {"T_d": 2e-3, "T_set": 2e-3}
"""Absolute change of a dead time [s]; of one that is off its first 2 ms."""
_FIELDS = {"water": "water", "load": "loads"}
"""Of a draw, that which holds them."""


def weighed(draw: Draw, plant=None):
    """Return speed and torque without noise as one vector in standard deviations of the noise, offsets left in."""
    other = draw if plant is None else replace(draw, plant=plant)
    _, speed, torque = (sensors.to_common(one) for one in other.clean(fast_motion(other)))
    parts = [
        _weigh(other.windowed(one) - 1.0, noise)
        for one, noise in zip((speed, torque), draw.noise, strict=True)
    ]
    return np.concatenate(parts)


def _weigh(samples, noise):
    """Real and imaginary parts of the Fourier transform over the noise's; white noise has unit variance in each."""
    f = np.fft.rfftfreq(len(samples), 1.0 / sensors.COMMON_HZ)
    use = f <= BAND_HZ
    density = np.maximum(noise.spectrum(f[use]), LEAST_NOISE**2)
    lines = np.fft.rfft(samples)[use] / np.sqrt(0.5 * len(samples) * density)
    # The mean has no imaginary part and half the lines' weight.
    lines[0] /= np.sqrt(2.0)
    return np.concatenate([lines.real, lines.imag])


def _moved(draw, relative, name):
    """Return the drive train with one parameter changed a little, and by how much."""
    step = _LEAST.get(name, _STEP * max(abs(relative[name]), 0.1))
    plant = draw.plant
    changed = physical(
        relative | {name: relative[name] + step},
        engine_speed=plant.engine_speed,
        ratio=plant.ratio,
        efficiency=plant.efficiency,
        shaft_torque=plant.shaft_torque,
        rack=plant.rack,
        v=plant.rack_slope * plant.rack / plant.brake_torque,
    )
    return changed, step


def judged(draw: Draw) -> dict[str, dict]:
    """Return for every element that is on its `size`, `distinct` and whether it "matters", is "grey" or "idle"."""
    relative = normalised(draw.plant)
    base = weighed(draw)
    names = ["tau_n", "g", "vK_p", "vK_i", "p", "T_d", "T_set"]
    names += ["tau_prop"] if draw.place == "gauge" or "tau_twist" in draw.on else []
    names += ["damping"] if relative["damping"] else []
    names += [name for name in ("T_s", "tau_act", "M_max", "rate", "c_2", "tau_twist") if name in draw.on]
    columns = {}
    for name in names:
        changed, step = _moved(draw, relative, name)
        columns[name] = (weighed(draw, changed) - base) / step
    for output in range(2):
        constant = np.zeros(len(base))
        constant[output * len(base) // 2] = 1.0
        columns[f"constant {output}"] = constant
    found = {}
    for name in draw.on:
        if name in ELEMENTS:
            difference = base - weighed(draw, without(draw.plant, name))
            others = np.column_stack([column for key, column in columns.items() if key != name])
            found[name] = _figures(difference, others)
        else:
            other = replace(
                draw, **({"plant": without(draw.plant, name)} if name == "c_2" else {_FIELDS[name]: None})
            )
            found[name] = {
                "size": float(np.linalg.norm(base - weighed(other))),
                "distinct": None,
                "verdict": None,
            }
    return found


def _figures(difference, others):
    size = np.linalg.norm(others, axis=0)
    # Behind a governor that samples, 2 ms of dead time may do nothing.
    others = others[:, size > 0.0] / size[size > 0.0]
    left = difference - others @ np.linalg.lstsq(others, difference, rcond=1e-9)[0]
    distinct = float(np.linalg.norm(left))
    verdict = "matters" if distinct >= MATTERS else ("idle" if distinct < IDLE else "grey")
    return {"size": float(np.linalg.norm(difference)), "distinct": distinct, "verdict": verdict}
