"""Chirps: sines of changing frequency."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.signals.checks import Bands, bands, below_nyquist, sample_times
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.checks import positive

Law = Literal["linear", "logarithmic"]


@checked
def chirp(
    start_hz: float,
    stop_hz: float,
    duration_s: float,
    amplitude_rpm: float,
    law: Law = "logarithmic",
    *,
    avoid_hz: Bands = (),
    rate_hz: float = 100.0,
    name: str = "chirp",
) -> Excitation:
    """Return a sine whose frequency changes from `start_hz` to `stop_hz` (section 5.1.2).

    It excites the whole range in one run, with the crest factor of a sine.

    Parameters
    ----------
    start_hz, stop_hz
        Frequencies at the ends [Hz], below half the sample rate.
    duration_s
        Length [s].
    amplitude_rpm
        Amplitude [rpm].
    law
        "linear": equal time for each Hz; "logarithmic": equal time for each decade.
    avoid_hz
        Bands (low, high) around resonances [Hz], which the frequency skips. The phase is continuous, and the time is spent
        on the rest of the range.
    rate_hz, name
        Sample rate [Hz] and label.
    """
    below_nyquist("start_hz", start_hz, rate_hz)
    below_nyquist("stop_hz", stop_hz, rate_hz)
    positive("amplitude_rpm", amplitude_rpm)
    time = sample_times(duration_s, rate_hz)
    pieces = _kept(start_hz, stop_hz, avoid_hz)
    measure = np.log if law == "logarithmic" else np.asarray
    shares = np.array([abs(measure(stop) - measure(start)) for start, stop in pieces])
    ends = duration_s * np.cumsum(shares) / shares.sum() if shares.sum() > 0.0 else np.array([duration_s])
    phase, turned, begun = np.empty_like(time), 0.0, 0.0
    for (start, stop), end in zip(pieces, ends, strict=True):
        # The last piece includes the last sample, in spite of rounding.
        inside = (time >= begun) & ((time < end) | (end == ends[-1]))
        phase[inside] = turned + _turns(time[inside] - begun, start, stop, end - begun, law)
        turned += float(_turns(np.array([end - begun]), start, stop, end - begun, law)[0])
        begun = end
    return Excitation(name, "chirp", rate_hz, amplitude_rpm * np.sin(2.0 * math.pi * phase))


def _kept(start_hz: float, stop_hz: float, avoid_hz: Bands) -> list[tuple[float, float]]:
    """Ranges from start to stop outside the bands, in the order of the sweep."""
    low, high = min(start_hz, stop_hz), max(start_hz, stop_hz)
    pieces, at = [], low
    for lower, upper in bands(avoid_hz):
        if upper <= low or lower > high:
            continue
        if at < lower:
            pieces.append((at, lower))
        at = max(at, upper)
    if at < high or low == high:
        pieces.append((at, high))
    if not pieces:
        raise InputError(
            f"the bands of avoid_hz {list(avoid_hz)} cover all of {low:g} to {high:g} Hz; leave some outside"
        )
    return pieces if start_hz <= stop_hz else [(upper, lower) for lower, upper in reversed(pieces)]


def _turns(time: Array, start: float, stop: float, duration: float, law: Law) -> Array:
    """Phase [turns] since the start of a sweep: the integral of its frequency."""
    if law == "linear":
        return start * time + 0.5 * (stop - start) / duration * time**2
    rate = math.log(stop / start) / duration
    return start * np.expm1(rate * time) / rate if rate != 0.0 else start * time
