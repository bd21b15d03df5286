"""The filters of long channels, said plainly in NumPy."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


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
