"""MATLAB's functions for bilevel waveforms and tachometers, under their MATLAB names.

Arguments and results are those of MATLAB; name-value pairs are lower-case keywords. Without a sample rate, instants are
indices, counted from zero. By default `tachorpm` smooths as much as MATLAB's: it distorts a changing speed by several
per cent. `tachorpm` neither repairs pulses nor corrects uneven reflectors; `speed_from_pulses` repairs and corrects them.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline, make_lsq_spline

from shipfp_rs._core import PulseCrossings
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import at_most, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho.tracks import require_positive

Polarity = Literal["positive", "negative"]
FitType = Literal["smooth", "linear"]


class StateLevels(NamedTuple):
    """Low and high level, shape (2,); counts and centres of the histogram's bins, shape (nbins,)."""

    levels: Array
    histogram: npt.NDArray[np.int64]
    binlevels: Array


class MidCrossings(NamedTuple):
    """Instants of all transitions through the middle level, shape (K,), and that level."""

    c: Array
    midlev: float


class PulsePeriods(NamedTuple):
    """Periods, and instants of each pulse's first, its second and the next pulse's first transition, shape (K,)."""

    p: Array
    initcross: Array
    finalcross: Array
    nextcross: Array
    midlev: float


class TachoRpm(NamedTuple):
    """Speed [rpm] and its times [s], shape (N,); centres of the pulses [s], shape (K,)."""

    rpm: Array
    t: Array
    tp: Array


@checked
def statelevels(
    x: npt.ArrayLike,
    nbins: int = 100,
    method: Literal["mode", "mean"] = "mode",
    bounds: tuple[float, float] | None = None,
) -> StateLevels:
    """Estimate the two levels of a bilevel waveform from the halves of its histogram (IEEE 181).

    Parameters
    ----------
    x
        Waveform, shape (N,).
    nbins
        Number of bins.
    method
        "mode": the fullest bin of each half of the occupied bins; "mean": the mean of each half.
    bounds
        Ends of the histogram; values outside are ignored. By default the smallest and largest value.

    Raises
    ------
    InputError
        If all values are equal.

    Examples
    --------
    >>> statelevels([0.0] * 5 + [10.0] * 5, 4).levels
    array([1.25, 8.75])
    """
    values = _waveform(x)
    finite = values[np.isfinite(values)]
    if nbins < 2:
        raise InputError(f"nbins: found {nbins}, expected 2 or more")
    low, high = bounds or ((finite.min(), finite.max()) if finite.size else (0.0, 0.0))
    counts, edges = (
        np.histogram(finite, nbins, (low, high)) if low < high else (np.zeros(0, dtype=np.int64),) * 2
    )
    if not counts.any():
        raise InputError(f"x: found no two levels from {low:g} to {high:g}, expected a bilevel waveform")
    centres = np.asarray(0.5 * (edges[1:] + edges[:-1]), dtype=np.float64)
    first, last = np.flatnonzero(counts)[[0, -1]]
    middle = first + (last - first) // 2
    levels = []
    for half in (slice(first, middle + 1), slice(middle, last + 1)):
        part, at = counts[half], centres[half]
        levels.append(at[np.argmax(part)] if method == "mode" else np.sum(part * at) / np.sum(part))
    return StateLevels(np.array(levels), counts.astype(np.int64), centres)


@checked
def midcross(
    x: npt.ArrayLike,
    t: float | npt.ArrayLike | None = None,
    *,
    midpercentreferencelevel: float = 50.0,
    statelevels: npt.ArrayLike | None = None,
    tolerance: float = 2.0,
) -> MidCrossings:
    """Return the instants at which each transition crosses the middle level.

    Parameters
    ----------
    x, t
        Waveform, shape (N,); its sample rate [Hz] or the instants of its samples, shape (N,), None: their indices.
    midpercentreferencelevel
        Middle level in per cent of the way from the low level to the high one.
    statelevels
        Low and high level; by default those of `statelevels`.
    tolerance
        A transition begins within this many per cent of the level difference from one level and ends within
        as many of the other level.
    """
    rising, falling, middle = _transitions(x, t, midpercentreferencelevel, statelevels, tolerance)
    return MidCrossings(np.sort(np.concatenate([rising, falling])), middle)


@checked
def pulseperiod(
    x: npt.ArrayLike,
    t: float | npt.ArrayLike | None = None,
    *,
    polarity: Polarity = "positive",
    midpercentreferencelevel: float = 50.0,
    statelevels: npt.ArrayLike | None = None,
    tolerance: float = 2.0,
) -> PulsePeriods:
    """Return the time from each pulse's first transition to that of the next pulse.

    Parameters
    ----------
    x, t, midpercentreferencelevel, statelevels, tolerance
        As in `midcross`.
    polarity
        "positive": pulses begin with a rising transition; "negative": with a falling one.

    Examples
    --------
    >>> pulseperiod([0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 1], 10.0).p
    array([0.5, 0.4])
    """
    rising, falling, middle = _transitions(x, t, midpercentreferencelevel, statelevels, tolerance)
    first, second = (rising, falling) if polarity == "positive" else (falling, rising)
    begins, ends, nexts = first[:-1], second[np.searchsorted(second, first[:-1])], first[1:]
    return PulsePeriods(nexts - begins, begins, ends, nexts, middle)


@checked
def tachorpm(
    x: npt.ArrayLike,
    fs: float,
    *,
    pulsesperrev: float = 1.0,
    statelevels: npt.ArrayLike | None = None,
    outputfs: float | None = None,
    fittype: FitType = "smooth",
    fitpoints: int = 10,
) -> TachoRpm:
    """Speed from the pulses of a tachometer.

    Parameters
    ----------
    x
        Pulses, shape (N,).
    fs
        Sample rate [Hz].
    pulsesperrev
        Pulses in a turn.
    statelevels
        Low and high level; by default those of `statelevels`.
    outputfs
        Rate of the result [Hz]; by default `fs`.
    fittype
        "smooth": a cubic spline with `fitpoints` breaks over the whole record, by least squares through the speeds at
        the middles between pulse centres; "linear": straight lines through them. Both extrapolate.
    fitpoints
        Number of breaks of the spline. More breaks follow faster changes, and more of the scatter.

    Raises
    ------
    InputError
        If there are too few pulses for the fit.
    """
    require_positive("fs", fs)
    require_positive("pulsesperrev", pulsesperrev)
    rate = fs if outputfs is None else outputfs
    require_positive("outputfs", rate)
    if fitpoints < 2:
        raise InputError(f"fitpoints: found {fitpoints}, expected 2 or more")
    values = _waveform(x)
    # MATLAB's risetime and falltime use the range from 10 to 90 %.
    rising, falling, _ = _transitions(values, fs, 50.0, statelevels, 10.0)
    after = np.searchsorted(falling, rising)
    whole = after < len(falling)
    centres = 0.5 * (rising[whole] + falling[after[whole]])
    least = fitpoints + 3 if fittype == "smooth" else 3
    if len(centres) < least:
        raise InputError(f"x: found {len(centres)} pulses, expected {least} or more for fittype {fittype!r}")
    speeds, middles = 60.0 / (pulsesperrev * np.diff(centres)), 0.5 * (centres[1:] + centres[:-1])
    at_most("outputfs", (len(values) - 1) / fs * rate)
    time = np.arange(int((len(values) - 1) / fs * rate + 1e-9) + 1) / rate
    breaks = np.linspace(middles[0], middles[-1], fitpoints)
    knots = np.concatenate([[breaks[0]] * 3, breaks, [breaks[-1]] * 3])
    try:
        smooth = fittype == "smooth"
        curve = make_lsq_spline(middles, speeds, knots) if smooth else make_interp_spline(middles, speeds, 1)
    except (ValueError, np.linalg.LinAlgError):
        raise InputError(
            f"fitpoints: found {fitpoints}, too many for the times of the {len(centres)} pulses; expected fewer"
        ) from None
    return TachoRpm(np.asarray(curve(time)), time, centres)


def _waveform(x: npt.ArrayLike) -> Array:
    values = np.ascontiguousarray(x, dtype=np.float64)
    if values.ndim != 1 or values.size < 2:
        raise InputError(f"x: found shape {values.shape}, expected one axis of two samples or more")
    return values


def _transitions(
    x: npt.ArrayLike,
    t: float | npt.ArrayLike | None,
    percent: float,
    levels: npt.ArrayLike | None,
    tolerance: float,
) -> tuple[Array, Array, float]:
    """Instants of the rising and of the falling transitions, and the middle level."""
    values = _waveform(x)
    low, high = statelevels(values).levels if levels is None else _two_levels(levels)
    if not (0.0 <= tolerance < percent < 100.0 - tolerance):
        raise InputError(
            f"midpercentreferencelevel, tolerance: found {percent}, {tolerance}, expected a tolerance below the "
            "reference level and below 100 minus it"
        )
    margin = 0.01 * tolerance * (high - low)
    bottom, top, middle = low + margin, high - margin, low + 0.01 * percent * (high - low)
    rising = PulseCrossings(bottom, top, middle).feed(values)
    falling = PulseCrossings(-top, -bottom, -middle).feed(-values)
    if t is None:
        return rising, falling, float(middle)
    instants = np.asarray(t, dtype=np.float64)
    if instants.ndim == 0:
        require_positive("t", float(instants))
        return rising / instants, falling / instants, float(middle)
    if instants.shape != values.shape or not (np.diff(instants) > 0.0).all():
        raise InputError(
            f"t: found shape {instants.shape}, expected {values.shape} ascending instants or a rate"
        )
    index = np.arange(len(values))
    return np.interp(rising, index, instants), np.interp(falling, index, instants), float(middle)


def _two_levels(levels: npt.ArrayLike) -> Array:
    found = np.asarray(levels, dtype=np.float64)
    if found.shape != (2,) or not found[0] < found[1]:
        raise InputError(f"statelevels: found {found.tolist()}, expected the low and the high level")
    return found
