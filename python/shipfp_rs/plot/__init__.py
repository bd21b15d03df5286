"""Pictures of experiments, responses, fits and parameters; each function takes axes or makes them.

Nothing here shows or saves a figure. Colours are of middle lightness: they read on white and on black.
"""

from shipfp_rs.plot.estimates import correlogram, intervals, likelihood
from shipfp_rs.plot.frequency import bode, responses
from shipfp_rs.plot.pulses import pulse_intervals
from shipfp_rs.plot.signals import fit, log, time_series

__all__ = [
    "bode",
    "correlogram",
    "fit",
    "intervals",
    "likelihood",
    "log",
    "pulse_intervals",
    "responses",
    "time_series",
]
