"""Excitations: deviations of the set point of the engine speed from the operating point.

All functions raise `InputError` if an argument is out of range.
"""

from shipfp_rs.signals.chirps import Law, chirp, multisine, published_sine_sequence, sine_sequence
from shipfp_rs.signals.excitation import Excitation, Segment, join
from shipfp_rs.signals.noise import band_limited_noise, prbs, steps
from shipfp_rs.signals.standard import standard

__all__ = [
    "Excitation",
    "Law",
    "Segment",
    "band_limited_noise",
    "chirp",
    "join",
    "multisine",
    "prbs",
    "published_sine_sequence",
    "sine_sequence",
    "standard",
    "steps",
]
