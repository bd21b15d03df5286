"""Reference of the pulse detector: its rules said sample by sample."""

import numpy as np
import numpy.typing as npt


def crossings(
    samples: npt.NDArray[np.floating | np.integer], low: float, high: float, middle: float
) -> tuple[list[float], list[tuple[int, int]]]:
    """Rising crossings of `middle` in samples, and stretches of NaN."""
    times: list[float] = []
    gaps: list[tuple[int, int]] = []
    armed, previous, crossing = False, np.nan, np.nan
    for k, x in enumerate(samples.astype(np.float64)):
        if np.isnan(x):
            armed = False
            if gaps and gaps[-1][1] == k:
                gaps[-1] = (gaps[-1][0], k + 1)
            else:
                gaps.append((k, k + 1))
        if previous < middle <= x:
            straight = np.isfinite(previous) and np.isfinite(x)
            crossing = k - (x - middle) / (x - previous) if straight else float(k)
        if x <= low:
            armed = True
        elif armed and x >= high:
            times.append(crossing)
            armed = False
        previous = x
    return times, gaps


def levels(samples: npt.NDArray[np.floating | np.integer], bins: int = 100) -> tuple[float, float]:
    """Modes of the two halves of a histogram (what MATLAB's `statelevels` does by default)."""
    finite = samples[np.isfinite(samples)].astype(np.float64)
    counts, edges = np.histogram(finite, bins)
    centres = (edges[1:] + edges[:-1]) / 2
    half = bins // 2
    return float(centres[np.argmax(counts[:half])]), float(centres[half + np.argmax(counts[half:])])
