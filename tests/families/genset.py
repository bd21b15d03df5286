"""Generating sets: engine and alternator on one shaft, and steps of the electric load.

The load goes with N^p, p from 0 to 1, or stands constant with a damping beside: L = 1 + damping (N - 1). Steps of the
electric load come on top and are measured, as torque in experiments and as power in logs.
"""

from __future__ import annotations

import numpy as np

from tests.families import recording, sensors
from tests.families.draw import Loads, Ranges
from tests.families.tug import rippled

RANGES = Ranges(tau_n=(0.3, 2.0), p=(0.0, 1.0), g=(-1.5, 0.3))
LATEST_TORQUE_S = 0.002


def law(random, ranges):
    """Inertia, load and engine slope."""
    tau = float(np.exp(random.uniform(*np.log(ranges.tau_n))))
    if random.random() < 0.5:
        return {"tau_n": tau, "p": random.uniform(0.1, ranges.p[1]), "g": random.uniform(*ranges.g)}
    return {"tau_n": tau, "p": 0.0, "damping": random.uniform(0.1, 1.5), "g": random.uniform(*ranges.g)}


def scale(random):
    """Size of the set."""
    return {
        "engine_speed": random.choice([1000.0, 1500.0, 1800.0]) / 60.0,
        "shaft_torque": 10.0 ** random.uniform(2.0, 3.7),
    }


def place(random):
    return str(random.choice(["gauge", "brake"]))


def loads(random, excitation, plant):
    """Draw steps of the electric load: every 10 to 40 s another level within 30 per cent."""
    rows, at = [], excitation.start_s + random.uniform(3.0, 20.0)
    while at < excitation.stop_s - 3.0:
        rows.append((at, random.uniform(-0.3, 0.3)))
        at += random.uniform(10.0, 40.0)
    return Loads(np.array(rows), plant.shaft_torque)


LOAD_TABLE = (
    '[channels.load]\ncolumn = "P_load"\nunit = "kW"\ncalibration = { scale = 1000.0 }\nquantity = "power"'
)
"""Of a trial file that knows a measured load."""


def recorded(draw):
    """Record set point, torque, a pick-up on the flywheel and, with load steps, the electric power, at 2 or 5 kHz."""
    random, rate, motion, shaft, engine = recording.begun(draw, 0.5)
    teeth = int(random.choice([4, 8, 12]))
    extra = []
    if draw.loads:
        power = 2e-3 * np.pi * motion.load_speed * (draw.plant.shaft_torque + motion.load_torque)
        power = power * (1.0 + 2e-3 * random.standard_normal(len(power)))
        extra = [("P_load", "kW", power, LOAD_TABLE)]
    torque = motion.gauge_torque if draw.place == "gauge" else motion.brake_torque
    return recording.logged(
        draw,
        motion,
        random,
        every=2,
        torque=rippled(torque, shaft, engine, random, blades=1),
        trains={"pickup": (engine, sensors.pick_up(random, teeth, 0.005, (5e-5, 2e-4)), "engine")},
        telemetry=sensors.Telemetry(random.uniform(300.0, 600.0), random.uniform(300.0, 600.0), hold_hz=rate),
        found=recording.faults(random),
        extra=extra,
    )
