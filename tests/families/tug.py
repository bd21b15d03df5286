"""Tugs: a diesel, a gearbox, a propeller in bollard pull; torque by strain gauge between the inertias, pulses of reflectors.

M_g = N^p + tau_prop dN/dt over the operating torque.
"""

from __future__ import annotations

import numpy as np

from tests.families import recording, sensors
from tests.families.draw import Ranges

RANGES = Ranges(tau_n=(0.5, 3.0), p=(1.7, 2.5))
LATEST_TORQUE_S = 0.005


def law(random, ranges):
    """Inertia, load and engine slope."""
    return {
        "tau_n": float(np.exp(random.uniform(*np.log(ranges.tau_n)))),
        "p": random.uniform(*ranges.p),
        "g": random.uniform(*ranges.g),
    }


def size(random, rpm, ratio, decades):
    """Draw speed, gear and torque of a geared engine, the torque by its power of ten."""
    return {
        "engine_speed": random.uniform(*rpm) / 60.0,
        "ratio": round(random.uniform(*ratio), 2),
        "efficiency": random.uniform(0.94, 0.98),
        "shaft_torque": 10.0 ** random.uniform(*decades),
    }


def scale(random):
    """Size of the ship: what the relative numbers are relative to."""
    drawn = size(random, (1000.0, 1500.0), (2.5, 4.5), (2.9, 3.7))
    return {**drawn, "rack": random.uniform(6.0, 15.0), "v": random.uniform(0.9, 1.6)}


def place(random):
    return "gauge"


def recorded(draw):
    """Record set point, torque, and three pulse trains at 2 or 5 kHz, with the faults of such logs."""
    random, _, motion, shaft, engine = recording.begun(draw, 0.5)
    shown = int(random.choice([4, 8]))

    def train(count):
        return sensors.Pulses(
            sensors.reflectors(random, count),
            width=random.uniform(0.15, 0.4),
            rise_s=random.uniform(1e-4, 6e-4),
            double=random.choice([0.0, 0.002]),
            broken=random.choice([0.0, 0.001]),
        )

    return recording.logged(
        draw,
        motion,
        random,
        every=2,
        torque=rippled(motion.gauge_torque, shaft, engine, random),
        trains={
            "PTM_1": (shaft, train(1), "propeller"),
            f"PTM_{shown}": (shaft, train(shown), "propeller"),
            "PTM_e": (engine, train(1), "engine"),
        },
        telemetry=sensors.Telemetry(random.uniform(200.0, 400.0), random.uniform(200.0, 400.0)),
        found=recording.faults(random),
    )


def rippled(torque, shaft_turns, engine_turns, random, blades=None, firings=3.0):
    """Add ripple of shaft, blades and firing to a torque."""
    blades = int(random.integers(3, 6)) if blades is None else blades
    ripple = np.zeros(len(torque))
    for turns, share in (
        (shaft_turns, 0.01),
        (blades * shaft_turns, 0.015),
        (engine_turns, 0.005),
        (firings * engine_turns, 0.02),
    ):
        ripple += share * random.uniform(0.3, 1.0) * np.sin(2.0 * np.pi * turns + random.uniform(0.0, 6.28))
    return torque * (1.0 + ripple)
