"""Plots of experiments, responses, fits and parameters; each function accepts axes or creates them.

Figures are neither shown nor saved. Colours are of medium lightness, legible on white and on black.
"""

from shipfp_rs.plot.estimates import correlogram, intervals, likelihood
from shipfp_rs.plot.frequency import bode, responses
from shipfp_rs.plot.gain_map import gains
from shipfp_rs.plot.traces import fit, held_out, log, pulse_intervals, signals

__all__ = [
    "bode",
    "correlogram",
    "fit",
    "gains",
    "held_out",
    "intervals",
    "likelihood",
    "log",
    "pulse_intervals",
    "responses",
    "signals",
]
