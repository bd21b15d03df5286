"""Steps: levels that stand upon each other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shipfp_rs.signals.checks import numbers, sample_times, zero_or_more
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.checks import at_most


@checked
def steps(
    sizes_rpm: npt.ArrayLike,
    hold_s: float,
    *,
    lead_s: float = 0.0,
    rate_hz: float = 100.0,
    name: str = "steps",
) -> Excitation:
    """Return steps one upon the other, each held (section 5.1.3).

    A size counts from the level before it.

    Parameters
    ----------
    sizes_rpm
        Size of each step [rpm], shape (S,), up or down from the level before.
    hold_s
        Time at each level [s].
    lead_s
        Time at the operating point before the first step [s].
    rate_hz, name
        Sample rate [Hz] and label.

    Examples
    --------
    >>> steps([65.0, -65.0], 1.0, rate_hz=2.0).samples.tolist()
    [65.0, 65.0, 0.0, 0.0]
    """
    sizes = numbers("sizes_rpm", sizes_rpm)
    zero_or_more("lead_s", lead_s)
    hold, lead = len(sample_times(hold_s, rate_hz)), at_most("lead_s", lead_s * rate_hz)
    levels = np.repeat(np.cumsum(sizes), hold)
    return Excitation(name, "steps", rate_hz, np.concatenate([np.zeros(lead), levels]), hold="zero")
