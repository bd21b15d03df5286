"""Launches: a small diesel whose brake torque is measured at its flange, with a torque limit that may act.

M_b = N^p + tau_n dN/dt over the operating torque.
"""

from __future__ import annotations

from tests.families import recording, sensors, tug
from tests.families.draw import Ranges
from tests.families.tug import rippled

RANGES = Ranges(tau_n=(0.3, 2.5), p=(1.5, 2.4), T_s=(0.015, 0.05), twist_hz=(4.0, 10.0), longest_s=320.0)
LATEST_TORQUE_S = 0.003


law = tug.law


def scale(random):
    """Size of the launch."""
    return tug.size(random, (1100.0, 1700.0), (1.5, 3.0), (2.5, 3.1))


def place(random):
    return "brake"


def recorded(draw):
    """Record set point, torque, an engine's pick-up and one reflector on the shaft at 2 or 5 kHz."""
    random, rate, motion, shaft, engine = recording.begun(draw, 1.0)
    teeth = int(random.choice([2, 6, 12]))
    return recording.logged(
        draw,
        motion,
        random,
        every=1,
        torque=rippled(motion.brake_torque, shaft, engine, random),
        trains={
            "pickup": (engine, sensors.pick_up(random, teeth, 0.005, (5e-5, 3e-4)), "engine"),
            "shaft": (
                shaft,
                sensors.Pulses(sensors.reflectors(random, 1), width=0.1, rise_s=3e-4),
                "propeller",
            ),
        },
        telemetry=sensors.Telemetry(random.uniform(300.0, 600.0), random.uniform(300.0, 600.0), hold_hz=rate),
        found=recording.faults(random),
    )
