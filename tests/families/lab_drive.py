"""Drive lines of a laboratory: an electric motor, its torque measured, an encoder or 60 teeth, a fan or a brake as load."""

from __future__ import annotations

import numpy as np

from tests.families import recording, sensors
from tests.families.draw import Ranges

RANGES = Ranges(tau_n=(0.3, 1.5), p=(0.0, 2.3), twist_hz=(5.0, 15.0))
LATEST_TORQUE_S = 0.002


def law(random, ranges):
    """A fan (p near 2) or a brake (p from 0 to 1), before a motor with or without a slope of its own."""
    p = random.uniform(1.7, 2.3) if random.random() < 0.5 else random.uniform(0.0, 1.0)
    return {
        "tau_n": float(np.exp(random.uniform(*np.log(ranges.tau_n)))),
        "p": p,
        "g": random.uniform(*ranges.g) if random.random() < 0.7 else random.uniform(-0.05, 0.05),
    }


def scale(random):
    """Size of the line."""
    return {
        "engine_speed": random.uniform(600.0, 1500.0) / 60.0,
        "shaft_torque": 10.0 ** random.uniform(0.7, 2.0),
    }


def place(random):
    return "brake"


def recorded(draw):
    """Record set point, torque and 60 teeth or an encoder of 16 pulses, at 5 kHz."""
    random = draw.random(3)
    motion = draw.motion(1e-4)
    _, engine = recording.angles(draw, motion)
    teeth = 60 if random.random() < 0.5 and draw.plant.engine_speed < 14.0 else 16
    error = 0.01 if teeth == 60 else 1e-4
    torque = motion.brake_torque * (1.0 + 0.005 * np.sin(2.0 * np.pi * 4.0 * engine))
    return recording.logged(
        draw,
        motion,
        random,
        every=2,
        torque=torque,
        trains={"teeth": (engine, sensors.pick_up(random, teeth, error, (2e-5, 1e-4), 0.5), "engine")},
        telemetry=sensors.Telemetry(
            random.uniform(500.0, 1000.0), random.uniform(500.0, 1000.0), hold_hz=5000.0
        ),
        found=sensors.Faults(hum_V=float(random.choice([0.0, 0.005]))),
    )
