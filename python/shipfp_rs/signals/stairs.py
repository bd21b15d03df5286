"""Steps: successive levels of the set point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.signals.checks import numbers, sample_times, zero_or_more
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.checks import at_most


@checked
def steps(
    sizes_rpm: npt.ArrayLike,
    hold_s: float | None = None,
    *,
    duration_s: float | None = None,
    lead_s: float = 0.0,
    rate_hz: float = 100.0,
    name: str = "steps",
) -> Excitation:
    """Return successive steps, each held (section 5.1.3).

    Parameters
    ----------
    sizes_rpm
        Size of each step [rpm], shape (S,), relative to the previous level.
    hold_s
        Time at each level [s].
    duration_s
        Instead of `hold_s`: duration of the whole signal including `lead_s` [s]; all levels are held equally long.
    lead_s
        Time at the operating point before the first step [s].
    rate_hz, name
        Sample rate [Hz] and label.

    Raises
    ------
    InputError
        Unless exactly one of `hold_s` and `duration_s` is given, or if a time is too short or too long.

    Examples
    --------
    >>> steps([65.0, -65.0], 1.0, rate_hz=2.0).samples.tolist()
    [65.0, 65.0, 0.0, 0.0]
    >>> steps([65.0, -65.0], duration_s=3.0, lead_s=1.0, rate_hz=2.0).samples.tolist()
    [0.0, 0.0, 65.0, 65.0, 0.0, 0.0]
    """
    sizes = numbers("sizes_rpm", sizes_rpm)
    zero_or_more("lead_s", lead_s)
    if (hold_s is None) == (duration_s is None):
        found = "neither" if hold_s is None else "both"
        raise InputError(f"steps: found {found} of hold_s and duration_s, expected one of them")
    if hold_s is None:
        assert duration_s is not None
        if not duration_s > lead_s:
            raise InputError(f"duration_s is {duration_s:g} with lead_s = {lead_s:g}, expected longer")
        hold_s = (duration_s - lead_s) / max(len(sizes), 1)
    hold, lead = len(sample_times(hold_s, rate_hz)), at_most("lead_s", lead_s * rate_hz)
    levels = np.repeat(np.cumsum(sizes), hold)
    return Excitation(name, "steps", rate_hz, np.concatenate([np.zeros(lead), levels]), hold="zero")
