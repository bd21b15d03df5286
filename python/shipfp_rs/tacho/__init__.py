"""Pulse trains to shaft speed: crossing times, repair, angles of reflectors, speeds of intervals, uniform grids, fusion."""

from shipfp_rs.tacho.angles import ReflectorAngles, reflector_angles
from shipfp_rs.tacho.crossings import PulseTimes, pulse_times
from shipfp_rs.tacho.fusion import FusedSpeed, TrainReport, fuse
from shipfp_rs.tacho.speed import IntervalSpeed, Train, interval_gain, resample, speed_from_pulses
from shipfp_rs.tacho.tracks import PulseFlag

__all__ = [
    "FusedSpeed",
    "IntervalSpeed",
    "PulseFlag",
    "PulseTimes",
    "ReflectorAngles",
    "Train",
    "TrainReport",
    "fuse",
    "interval_gain",
    "pulse_times",
    "reflector_angles",
    "resample",
    "speed_from_pulses",
]
