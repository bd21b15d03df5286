"""The filters of long channels, said plainly in NumPy."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from shipfp_rs.support.arrays import joined, runs


def running_median(samples: np.ndarray, window: int) -> np.ndarray:
    """Sort every window of the signal reflected at its ends."""
    if not len(samples):
        return samples
    return np.median(sliding_window_view(np.pad(samples, window // 2, mode="symmetric"), window), axis=1)


def decimated(samples: np.ndarray, taps: np.ndarray, up: int, down: int, total: int) -> np.ndarray:
    """Put zeros between the samples, convolve, and take every `down`-th; the signal stands still outside."""
    half = len(taps) // 2
    ahead = half // up + 1
    behind = (total * down + half) // up + 2
    stuffed = np.zeros((ahead + len(samples) + behind) * up)
    stuffed[::up] = np.pad(samples, (ahead, behind), mode="edge")
    return up * np.convolve(stuffed, taps, mode="same")[ahead * up :: down][:total]


def spikes(
    samples: np.ndarray, longest: int, stride: int, scale_window: int, threshold: float, least: float
) -> np.ndarray:
    """Hampel's rule sample by sample, then a look at every run of suspects, and at its ends from the levels beside it."""
    baseline = running_median(samples, 2 * longest + 1)
    distance = np.abs(samples - baseline)
    spread = 1.4826 * np.repeat(running_median(distance[::stride], scale_window), stride)[: len(samples)]
    limit = np.maximum(threshold * spread, least * np.median(np.abs(baseline[::stride])))
    nearby = max(longest // 2, 1)

    def is_spike(start: int, stop: int) -> bool:
        peak = start + int(np.argmax(distance[start:stop]))
        before, after = samples[max(start - nearby, 0) : start], samples[stop : stop + nearby]
        tall = np.flatnonzero(distance[start:stop] > 0.25 * distance[peak])
        if np.ptp(tall) >= longest or stop - start > 2 * longest or distance[peak] <= limit[peak]:
            return False
        if not (before.size and after.size):
            return True
        left = np.median(before)
        return bool(abs(np.median(after) - left) < 0.3 * abs(samples[peak] - left))

    def trimmed(start: int, stop: int) -> tuple[int, int]:
        before, after = samples[max(start - nearby, 0) : start], samples[stop : stop + nearby]
        if not (before.size or after.size):
            return start, stop
        left, right = (
            np.median(one if one.size else other) for one, other in ((before, after), (after, before))
        )
        way = (np.arange(stop - start) + 0.5 * len(before)) / (
            stop - start + 0.5 * (len(before) + len(after))
        )
        level = left + (right - left) * way
        beyond = np.flatnonzero(np.abs(samples[start:stop] - level) > 0.5 * limit[start:stop])
        return (start + int(beyond[0]), start + int(beyond[-1]) + 1) if beyond.size else (start, stop)

    suspects = joined([runs(distance > 0.5 * limit)], gap=max(longest // 10, 1))
    found = [trimmed(*span) for span in suspects.tolist() if is_spike(*span)]
    return np.array(found, dtype=np.int64).reshape(-1, 2)
