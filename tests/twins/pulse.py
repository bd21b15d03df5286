"""Reference of the pulse detector: its rules said sample by sample."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

AROUND = 33
LEAST_APART = 0.05
STEP = 0.2


def scatter(expected, noise, grid, sample):
    """Variance, surplus of the mean, and variance of independent ends, all relative."""
    random = noise[1:] ** 2 + noise[:-1] ** 2 if len(noise) > 1 else 2.0 * noise**2
    sampled = grid[1:] ** 2 + grid[:-1] ** 2 if len(grid) > 1 else 2.0 * grid**2
    random, sampled = random / expected**2, sampled / expected**2
    if not sample > 0.0:
        return (random + sampled,) * 3
    samples = expected / sample
    whole = np.maximum(np.floor(samples), 1.0)
    past = samples - whole
    step = sampled * samples**2 > 2.0 * STEP**2
    apart = np.where(step, 6.0 * past * (1.0 - past), 1.0 - np.cos(2.0 * np.pi * past))
    few = np.where(step, samples**2 / (whole * (whole + 1.0)), 1.0)
    variance, surplus = (
        np.maximum(uniform_filter1d(apart * factor, min(AROUND, len(apart))), LEAST_APART)
        for factor in (few**2, few)
    )
    return random + sampled * variance, random + sampled * surplus, random + sampled


def interval_speeds(edges, count, fractions, relative, noise, grid, sample):
    """As `shipfp_rs._core.interval_speeds`."""
    place = np.arange(count.sum()) % len(fractions)
    whole = np.diff(edges)
    turned = np.add.reduceat(fractions[place], np.cumsum(count) - count)
    speed = np.repeat(turned / whole, count)
    duration = fractions[place] / speed
    around = min(AROUND, len(whole))
    expected = turned * uniform_filter1d(whole, around) / uniform_filter1d(turned, around)
    variance, surplus, apart = scatter(expected, noise, grid, sample)
    usual = np.repeat(turned / expected, count)
    std, ends = (
        usual * np.hypot(np.repeat(np.sqrt(np.broadcast_to(part, whole.shape)), count), relative[place])
        for part in (variance, apart)
    )
    middle = edges[0] + np.cumsum(duration) - duration / 2
    unbiased = speed * (1.0 - np.minimum(np.repeat(surplus, count), 0.5))
    return middle, unbiased, std, duration, fractions[place], ends


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
