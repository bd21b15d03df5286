"""Pulse trains to shaft speed: crossing times, repair, reflector angles, speed per interval, uniform grids."""

from shipfp_rs.tacho.angles import ReflectorAngles, reflector_angles
from shipfp_rs.tacho.crossings import PulseTimes, pulse_times
from shipfp_rs.tacho.speed import IntervalSpeed, interval_gain, resample, speed_from_pulses
from shipfp_rs.tacho.tracks import PulseFlag

__all__ = [
    "IntervalSpeed",
    "PulseFlag",
    "PulseTimes",
    "ReflectorAngles",
    "interval_gain",
    "pulse_times",
    "reflector_angles",
    "resample",
    "speed_from_pulses",
]
