"""Confidence intervals of any function of the parameters (a figure), by profiles of the deviance.

A stiff additional residual holds the figure at a value while all parameters are fitted again. The interval ends where the
deviance has risen by `RISE`, a quantile of chi-squared. Profiles start from every minimum that the data do not reject.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls
from scipy.stats import chi2

from shipfp_rs.errors import IdentificationError
from shipfp_rs.identification.basins import Basin, Minima, descend
from shipfp_rs.identification.coordinates import Figure, Itself
from shipfp_rs.identification.likelihood import Likelihood, Products
from shipfp_rs.structures.names import plain_name
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.progress import tell

KnownMinima = TypeVar("KnownMinima", bound=Minima)

RISE = float(chi2.ppf(0.95, 1))
"""Rise of the deviance at the ends of a 95 % interval."""
NEAR, ABOUT = 0.1, 0.4
"""Relative excess over `RISE` up to which a point counts as inside the interval; and relative difference from `RISE` within
which the end is interpolated. The interpolation is linear in the square root of the rise, which is nearly straight."""
TRIES = 7
STEPS = 15
STIFF = 10.0
"""Standard deviation of a figure over the tolerance of the residual that holds it at a value."""
SHRINK, SHRUNK = 0.15, 0.01
"""Factor on a profile's step, each time that parameters on their bounds block it; least step, relative to the first."""
FURTHER = 1.3
"""Largest extrapolation: distance of the interval's end from the minimum, over that of the last point inside."""
REACHED = 0.9
"""A profile has reached a bound if it covers this share of the distance from the minimum to the bound."""
LOWER, RESTARTS = 0.5, 2
"""Decrease of the deviance below the minimum from which all profiles start again, and largest number of restarts."""
COMBINED_TRIES = 3
"""Largest number of iterations of a combination's profile; the parameters' profiles already cover most of its interval."""
ROUNDING, STRAIGHT = 1e-13, 1e-9
"""Least curvature of a direction relative to the largest one: in inverses (rounding errors), and for a profile's path."""


@dataclass(frozen=True)
class Interval:
    """Value at the best minimum, both ends, and the cause of each end: the data ("data") or a bound ("bound")."""

    value: float
    low: float
    high: float
    kinds: tuple[str, str]

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends."""
        return self.low, self.high


@dataclass
class Profiles:
    """Profiles of a likelihood about its minima; an interval includes every visited point that the data do not reject."""

    likelihood: Likelihood
    basins: list[Basin]
    visited: list[Basin] = field(default_factory=list)

    @property
    def best(self) -> Basin:
        """The lowest minimum."""
        return min(self.basins, key=lambda basin: basin.cost)

    def interval(
        self, figure: Figure, tries: int = TRIES, within: tuple[float, float] = (-np.inf, np.inf)
    ) -> Interval:
        """Return the interval of a figure (a number computed from the parameters), inside the bounds `within`."""
        best = self.best
        value = figure(self.likelihood.coordinates.values(best.vector))
        # Both sides run in parallel, each from the points visited before.
        jobs = [
            partial(self._end, best, figure, side, tries, most)
            for side, most in zip((-1, 1), within, strict=True)
        ]
        ends = self.likelihood.each(jobs)
        for *_, visited in ends:
            self.visited += visited
        (low, first, _), (high, last, _) = ends
        return Interval(value, min(low, value), max(high, value), (first, last))

    def symmetric(self, figure: Figure, *, surely: bool = False) -> Interval:
        """Return the interval from the curvature alone, without a profile; it may cross the bounds of parameters."""
        best = self.best
        slope, now = self.gradient(figure, best.vector), self._products(best)
        inward = self._inward(best.vector)
        held = (inward * now.downhill < 0.0) & (slope == 0.0)
        # With `surely`, a parameter that the deviance presses to its bound by less than the quantile is free, too.
        if surely:
            held &= now.downhill**2 * np.diag(scaled_inverse(now.matrix)) > RISE
        free = np.flatnonzero(~held)
        matrix, slope, inward = now.matrix[np.ix_(free, free)], slope[free], inward[free]
        down, up = (np.sqrt(RISE * _spread(matrix, side * slope, inward)) for side in (-1.0, 1.0))
        value = figure(self.likelihood.coordinates.values(best.vector))
        return Interval(value, float(value - down), float(value + up), ("data", "data"))

    def _products(self, basin: Basin) -> Products:
        return basin.products or self.likelihood.products(basin.vector)

    def _inward(self, vector: Array) -> npt.NDArray[np.int_]:
        """Return +1 for each entry of a search vector on its lower bound, -1 on its upper one, 0 between them."""
        low, high = self.likelihood.coordinates.bounds
        return (vector <= low + 1e-9).astype(int) - (vector >= high - 1e-9)

    def gradient(self, figure: Figure, vector: Array) -> Array:
        """Derivative of a figure with respect to the search vector, shape (P,)."""
        return self.likelihood.coordinates.gradient(figure, vector)

    def covariance(
        self,
        basin: Basin,
        moving: Array | None = None,
        least: float = ROUNDING,
        still: npt.NDArray[np.bool_] | None = None,
    ) -> Array:
        """Covariance (P, P) about a point; zero for `still` entries, and on bounds unless `moving` or pushed inward."""
        now, inward = self._products(basin), self._inward(basin.vector)
        held = (inward != 0) & (inward * now.downhill <= 0.0)
        if moving is not None:
            held &= moving == 0.0
        if still is not None:
            held |= still
        free = np.flatnonzero(~held)
        found = np.zeros_like(now.matrix)
        found[np.ix_(free, free)] = scaled_inverse(now.matrix[np.ix_(free, free)], least)
        return found

    def _reach(self, basin: Basin, slope: Array, side: int) -> tuple[float, Array]:
        """A figure's squared standard deviation towards one side, and the search vector's change per unit of the figure."""
        low, high = self.likelihood.coordinates.bounds
        still = np.zeros(len(slope), bool)
        while True:
            covariance = self.covariance(basin, slope, still=still)
            spread = float(slope @ covariance @ slope)
            along = covariance @ slope / spread if spread > 0.0 else 0.0 * slope
            there = basin.vector + side * np.sqrt(RISE * max(spread, 0.0)) * along
            out = ((there < low) | (there > high)) & (slope == 0.0) & ~still
            # Entries that would leave their bounds before the interval's end do not move.
            if not out.any():
                return spread, along
            still |= out

    def widened(self, figure: Figure, interval: Interval) -> Interval:
        """Return the interval widened by the points that other figures' profiles have visited since."""
        ends = [self._farthest(figure, side, interval.value)[0] for side in (-1, 1)]
        return replace(interval, low=min(interval.low, ends[0]), high=max(interval.high, ends[1]))

    def _farthest(self, figure: Figure, side: int, value: float) -> tuple[float, Basin]:
        """Return a figure's outermost value on one side, among visited points that the data do not reject, and its point."""
        c, best = self.likelihood.coordinates, self.best
        far, farthest = value, best
        for point in (*self.basins, *self.visited):
            if point.cost <= best.cost + RISE * (1.0 + NEAR):
                at = figure(point.values or c.values(point.vector))
                if side * (at - far) > 0.0:
                    far, farthest = at, point
        return far, farthest

    def _end(
        self, basin: Basin, figure: Figure, side: int, tries: int, most: float
    ) -> tuple[float, str, list[Basin]]:
        """End of the interval on one side (within `most`), its cause ("data" or "bound"), and the visited points."""
        c = self.likelihood.coordinates
        value = figure(c.values(basin.vector))
        room = side * (most - value)
        if room <= 0.0:
            return value, "bound", []
        slope = self.gradient(figure, basin.vector)
        spread, along = self._reach(basin, slope, side)
        if not spread > 0.0:
            return value, "bound", []
        scale, way = float(np.sqrt(spread)), self._way(basin, figure, along)
        far, inside = self._farthest(figure, side, value)
        x, reached, over = inside.vector, side * (far - value), np.inf
        # Largest known distance inside the interval, and the square root of the rise there, nearly linear farther out.
        known, root = 0.0, 0.0
        found = self._products(basin)
        scale = min(scale, _scale_uphill(max(-2.0 * side * float(found.downhill @ way), 0.0), spread))
        distance = max(np.sqrt(RISE) * scale, 1.2 * reached)
        visited: list[Basin] = []
        for _ in range(tries):
            distance = min(distance, room)
            end = self._at(value + side * distance, figure, scale, x, way)
            if not np.isfinite(end.cost):
                over = distance
                distance = 0.5 * (reached + over)
                continue
            found = end.products or found
            values = c.values(end.vector)
            visited.append(replace(end, products=None, values=values))
            went = side * (figure(values) - value)
            rise = end.cost - basin.cost
            if abs(rise / RISE - 1.0) < ABOUT and went > reached:
                share = (np.sqrt(RISE) - root) / max(np.sqrt(rise) - root, 0.1)
                end_at = known + min(share, FURTHER) * (went - known)
                return value + side * max(reached, end_at), "data", visited
            if rise > RISE * (1.0 + NEAR):
                over = min(over, went)
                share = (np.sqrt(RISE) - root) / max(np.sqrt(rise) - root, 1e-9)
                distance = known + float(np.clip(share, 0.1, 0.95)) * (over - known)
                distance = max(distance, reached + 0.1 * (over - reached))
            elif distance == room and went > REACHED * room:
                return most, "bound", visited
            else:
                stuck = end.settled and went < reached + 0.3 * (distance - reached)
                if went > reached:
                    reached, x = went, end.vector
                    known, root = went, np.sqrt(max(rise, 0.0))
                    way = self._way(end, figure, way)
                if stuck and scale <= SHRUNK * np.sqrt(spread):
                    return value + side * reached, "bound", visited
                if stuck:
                    # A parameter that would compensate is on its bound: the rise is steeper than the curvature predicts.
                    scale *= SHRINK
                    distance = reached + np.sqrt(RISE) * scale
                    continue
                step = reached * float(np.clip(np.sqrt(RISE / max(rise, 0.05)), 1.1, 3.0))
                distance = min(step, 0.5 * (reached + over)) if np.isfinite(over) else step
            if over - reached < 0.03 * over:
                break
        # No tries are left: the next target is closer to the interval's end than the last point inside.
        return value + side * max(reached, min(distance, FURTHER * reached)), "data", visited

    def _at(self, target: float, figure: Figure, scale: float, x: Array, way: Array) -> Basin:
        """Minimum with the figure held at `target`, searched from x; if this search fails, from the lowest minimum."""
        end = self._held(self._moved(x, way, figure, target), figure, target, scale)
        if np.isfinite(end.cost):
            return end
        return self._held(self._moved(self.best.vector, way, figure, target), figure, target, scale)

    def _moved(self, vector: Array, way: Array, figure: Figure, target: float) -> Array:
        """Move a search vector along a direction until the figure is close to the target."""
        c = self.likelihood.coordinates
        return np.clip(vector + way * (target - figure(c.values(vector))), *c.bounds)

    def _way(self, end: Basin, figure: Figure, otherwise: Array) -> Array:
        """Change of the search vector per unit change of the figure, at a point of a profile, whose path may be curved."""
        slope = self.gradient(figure, end.vector)
        # Without `STRAIGHT`, directions that the data do not determine would make this change far too long.
        covariance = self.covariance(end, slope, STRAIGHT)
        spread = float(slope @ covariance @ slope)
        return covariance @ slope / spread if spread > 0.0 else otherwise

    def _held(self, start: Array, figure: Figure, target: float, deviation: float) -> Basin:
        stiffness = STIFF / deviation

        def penalty(vector: Array) -> tuple[float, Array]:
            apart = figure(self.likelihood.coordinates.values(vector)) - target
            return apart * stiffness, self.gradient(figure, vector) * stiffness

        return descend(self.likelihood, start, steps=STEPS, settled=0.2, penalty=penalty, near=True)


def profiled(
    fit: KnownMinima,
    figures: Mapping[str, Figure],
    refine: Callable[[KnownMinima], KnownMinima],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[KnownMinima, Profiles, dict[str, Interval]]:
    """Return the fit, its profiles and each figure's interval, after `refine` if a profile finds a lower minimum."""
    possible: list[Array] = []
    for restarts in reversed(range(RESTARTS + 1)):
        likelihood, intervals = fit.likelihood, dict[str, Interval]()
        profiles = Profiles(likelihood, [descend(likelihood, one.vector) for one in fit.basins])
        # Points that profiles accepted before a restart remain candidates.
        profiles.visited += [Basin(likelihood.cost(vector), vector) for vector in possible]
        for place, (name, figure) in enumerate(figures.items()):
            tell(f"interval: {plain_name(name) or name}", place / len(figures))
            tries = TRIES if name in likelihood.coordinates.names else COMBINED_TRIES
            intervals[name] = profiles.interval(figure, tries, bounds.get(name, (-np.inf, np.inf)))
            lower = min(profiles.visited, key=lambda point: point.cost, default=profiles.best)
            if restarts and lower.cost < profiles.best.cost - LOWER:
                points = (*profiles.basins, *profiles.visited)
                possible = [point.vector for point in points if point.cost < lower.cost + RISE]
                try:
                    fit = refine(replace(fit, basins=(descend(likelihood, lower.vector),)))
                except IdentificationError:  # no minimum under the re-estimated noise
                    continue
                break
        else:
            break
    return fit, profiles, intervals


def _scale_uphill(uphill: float, spread: float) -> float:
    """Effective standard deviation of a figure on a bound where the deviance has a slope."""
    # At a distance d the deviance rises by `uphill` d + d^2 / `spread`; the interval ends where the rise is `RISE`.
    half = 0.5 * uphill * spread
    straight = np.sqrt(half**2 + RISE * spread) - half
    return max(float(straight / np.sqrt(RISE)), 1e-12)


def _spread(matrix: Array, slope: Array, inward: npt.NDArray[np.int_]) -> float:
    """Squared change of a figure per unit rise of the deviance, if entries on bounds only move inward."""
    scale, cut = np.sqrt(np.maximum(np.diag(matrix), 1e-30)), inward != 0
    matrix, slope = matrix / np.outer(scale, scale), slope / scale
    inverse = scaled_inverse(matrix[np.ix_(~cut, ~cut)])
    found = max(float(slope[~cut] @ inverse @ slope[~cut]), 0.0)
    if not cut.any():
        return found
    # Entries off their bounds are eliminated. Those on bounds can only step inward, so their steps have one sign.
    across = matrix[np.ix_(cut, ~cut)] @ inverse
    rest = matrix[np.ix_(cut, cut)] - across @ matrix[np.ix_(~cut, cut)]
    gain, ways = (slope[cut] - across @ slope[~cut]) * inward[cut], inward[cut]
    sizes, turned = np.linalg.eigh(rest * np.outer(ways, ways))
    root = np.sqrt(np.maximum(sizes, ROUNDING))
    steps, _ = nnls(root[:, None] * turned.T, turned.T @ gain / root)
    return found + max(float(gain @ steps), 0.0)


def scaled_inverse(matrix: Array, least: float = ROUNDING) -> Array:
    """Inverse of a symmetric matrix through its correlations; relative curvatures below `least` count as `least`."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    sizes, turned = np.linalg.eigh(matrix / np.outer(scale, scale))
    inverse = (turned / np.maximum(sizes, least)) @ turned.T
    return np.asarray(inverse / np.outer(scale, scale))


def figures_of(names: Sequence[str]) -> dict[str, Figure]:
    """Return figures that are the parameters themselves."""
    return {name: Itself(name) for name in names}
