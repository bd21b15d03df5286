"""Statistics of a sweep: bias, spread, coverage and failures, overall and by factor; necessary length of a trial.

Rows are read once and only added to sums and histograms, so memory does not grow with the number of draws.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.sweeps.draw import names_of
from shipfp_rs.sweeps.plan import Factor, Plan, Value

DURATION = "excitation.duration_s"
BINS = 6
"""Number of bins of a factor without levels; all bins have equally many draws."""
ACCURACY_PCT = 10.0
"""Default accuracy [%] for the necessary trial length: the relative error that 95 of 100 trials do not exceed."""
_SMALLEST, _LARGEST, _PER_DECADE = 1e-9, 1e6, 100
"""Range of relative errors in the histograms, whose bins are 2.3 % wide."""
_EDGES = np.geomspace(_SMALLEST, _LARGEST, 1 + round(math.log10(_LARGEST / _SMALLEST)) * _PER_DECADE)


@dataclass(frozen=True)
class Bins:
    """Bins of the draws by one factor; a factor is a value that the sweep varies."""

    key: str
    labels: tuple[Value, ...]
    """Levels, or centres of the bins."""
    edges: tuple[float, ...] | None
    """Edges between bins; None if the factor has levels."""

    @classmethod
    def of(cls, key: str, factor: Factor) -> Bins:
        """Levels of a factor, or bins of equal shares."""
        levels = factor.levels()
        if levels is not None:
            kind = str if factor.is_text else float
            return cls(key, tuple(dict.fromkeys(kind(level) for level in levels)), None)
        middles = tuple(factor.at((place + 0.5) / BINS) for place in range(BINS))
        return cls(key, middles, tuple(float(factor.at(place / BINS)) for place in range(1, BINS)))

    def place(self, batch: pa.RecordBatch) -> npt.NDArray[np.intp]:
        """Bin of each draw, shape (N,)."""
        return self.places(batch.column(f"factor.{self.key}").to_numpy(zero_copy_only=False))

    def places(self, values: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
        """Bin of each value of the factor, shape (N,)."""
        if self.edges is not None:
            return np.asarray(np.searchsorted(self.edges, values, side="right"))
        where = {label: place for place, label in enumerate(self.labels)}
        return np.array([where[value] for value in values.tolist()], dtype=np.intp)


class Tally:
    """Sums over the draws of each group; a group is a combination of bins of all given factors."""

    def __init__(self, bins: Sequence[Bins], names: Sequence[str]) -> None:
        self.bins, self.names = tuple(bins), tuple(names)
        groups = math.prod(len(each.labels) for each in bins)
        self.statuses = {
            status: np.zeros(groups, dtype=np.int64) for status in ("done", "failed", "timed_out")
        }
        shape = (groups, len(names))
        self.count, self.intervals, self.held = (np.zeros(shape, dtype=np.int64) for _ in range(3))
        self.total, self.squares = np.zeros(shape), np.zeros(shape)
        self.histogram = np.zeros((*shape, len(_EDGES) + 1), dtype=np.int64)

    def add(self, batch: pa.RecordBatch) -> None:
        """Add draws to the sums."""
        shape = tuple(len(each.labels) for each in self.bins)
        places = tuple(each.place(batch) for each in self.bins)
        group = np.ravel_multi_index(places, shape) if places else np.zeros(len(batch), dtype=np.intp)
        status = np.array(batch.column("status").to_pylist())
        for name, counts in self.statuses.items():
            np.add.at(counts, group[status == name], 1)
        for column, name in enumerate(self.names):
            truth, value, low, high = (
                batch.column(f"{figure}.{name}").to_numpy(zero_copy_only=False).astype(np.float64)
                for figure in ("truth", "estimate", "low", "high")
            )
            error = (value - truth) / np.abs(truth)
            known = np.isfinite(error)
            np.add.at(self.count[:, column], group[known], 1)
            np.add.at(self.total[:, column], group[known], error[known])
            np.add.at(self.squares[:, column], group[known], error[known] ** 2)
            bounded = np.isfinite(low) & np.isfinite(high)
            np.add.at(self.intervals[:, column], group[bounded], 1)
            np.add.at(self.held[:, column], group[bounded & (low <= truth) & (truth <= high)], 1)
            size = np.searchsorted(_EDGES, np.abs(error[known]))
            np.add.at(self.histogram[:, column], (group[known], size), 1)

    def run(self, group: int) -> int:
        """Number of completed draws of a group."""
        return int(self.statuses["done"][group] + self.statuses["failed"][group])

    def error_below(self, group: int, column: int, share: float) -> float | None:
        """Relative error that this fraction of a group's draws does not exceed; None if infinite.

        The error of a draw that failed, or did not determine the parameter, is infinite.
        """
        wanted = share * self.run(group)
        reached = np.cumsum(self.histogram[group, column])
        place = int(np.searchsorted(reached, wanted))
        if not wanted or place >= len(_EDGES):
            return None
        return float(_EDGES[place])

    def figures(self, group: int) -> dict[str, Any]:
        """Statistics of a group."""
        return {
            **{status: int(counts[group]) for status, counts in self.statuses.items()},
            "failure_rate": _ratio(int(self.statuses["failed"][group]), self.run(group)),
            "parameters": {name: self._figures_of(group, column) for column, name in enumerate(self.names)},
        }

    def _figures_of(self, group: int, column: int) -> dict[str, Any]:
        count = int(self.count[group, column])
        mean = float(self.total[group, column]) / count if count else None
        spread = None
        if mean is not None and count > 1:
            variance = (float(self.squares[group, column]) - count * mean**2) / (count - 1)
            spread = math.sqrt(max(variance, 0.0))
        return {
            "estimates": count,
            "bias": mean,
            "spread": spread,
            "median_error": self.error_below(group, column, 0.5),
            "error_95": self.error_below(group, column, 0.95),
            "coverage": _ratio(int(self.held[group, column]), int(self.intervals[group, column])),
        }

    def rows(self) -> list[dict[str, Any]]:
        """Levels of the factors, and statistics, of each group."""
        shape = tuple(len(each.labels) for each in self.bins)
        return [
            {
                "factors": {each.key: each.labels[at] for each, at in zip(self.bins, place, strict=True)},
                **self.figures(group),
            }
            for group, place in enumerate(np.ndindex(shape))
        ]


def summarise(
    plan: Plan, batches: Iterable[pa.RecordBatch], accuracy_pct: float = ACCURACY_PCT
) -> dict[str, Any]:
    """Content of `summary.json`.

    Parameters
    ----------
    plan
        The sweep.
    batches
        The sweep's rows so far.
    accuracy_pct
        Relative error [%] for which the necessary trial length is computed.

    Returns
    -------
    dict
        Errors are relative to the truth's magnitude: `bias` is their mean, `spread` their standard deviation,
        `error_95` the 95 % quantile of their magnitude, infinite for draws without an estimate; `coverage` is the
        fraction of 95 % intervals that contain the truth. `trial_length` is the shortest duration [s] with `error_95`
        within `accuracy_pct`.
    """
    names = names_of(plan.structure)
    bins = {key: Bins.of(key, factor) for key, factor in sorted(plan.factors.items())}
    overall = Tally([], names)
    single = {key: Tally([each], names) for key, each in bins.items()}
    lengths = []
    if DURATION in bins:
        others = [[each] for key, each in bins.items() if key != DURATION] or [[]]
        lengths = [Tally([*other, bins[DURATION]], names) for other in others]
    errors: Counter[str] = Counter()
    for batch in batches:
        for tally in (overall, *single.values(), *lengths):
            tally.add(batch)
        errors.update(name for name in batch.column("error").to_pylist() if name is not None)
    total = overall.figures(0)
    # A fingerprint lists a combination only if it is known much better than one of its parameters. A combination listed
    # by less than half of the draws is omitted: these draws are not representative.
    shown = {parameter.name for parameter in plan.structure.free}
    shown |= {name for name, row in total["parameters"].items() if 2 * row["estimates"] > total["done"]}
    finished = sum(total[status] for status in overall.statuses)
    return {
        "name": plan.sweep.name,
        "vessel": plan.ship.name,
        "seed": plan.sweep.seed,
        "draws": {
            "total": plan.draws,
            **{status: total[status] for status in overall.statuses},
            "not_run": plan.draws - finished,
        },
        "errors": dict(sorted(errors.items())),
        "failure_rate": total["failure_rate"],
        "parameters": _only(shown, total["parameters"]),
        "by_factor": {
            key: [row | {"parameters": _only(shown, row["parameters"])} for row in tally.rows()]
            for key, tally in single.items()
        },
        "accuracy_pct": accuracy_pct,
        "trial_length": [
            row
            for tally in lengths
            for row in _trial_lengths(tally, 0.01 * accuracy_pct)
            if row["parameter"] in shown
        ],
        "shipfp_rs": plan.record()["shipfp_rs"],
    }


def _trial_lengths(tally: Tally, accuracy: float) -> list[dict[str, Any]]:
    """For each parameter and each level of a second factor, the shortest duration with a sufficiently small error."""
    *others, duration = tally.bins
    lengths = [float(label) for label in duration.labels]
    order = np.argsort(lengths)
    rows = []
    for column, name in enumerate(tally.names):
        for other in range(math.prod(len(each.labels) for each in others)):
            errors = [tally.error_below(other * len(lengths) + int(at), column, 0.95) for at in order]
            shortest, note = _first_within([lengths[at] for at in order], errors, accuracy)
            rows.append(
                {
                    "parameter": name,
                    "factors": {each.key: each.labels[other] for each in others},
                    "duration_s": shortest,
                    "note": note,
                    "durations_s": [lengths[at] for at in order],
                    "error_95": errors,
                }
            )
    return rows


def _first_within(
    lengths: Sequence[float], errors: Sequence[float | None], accuracy: float
) -> tuple[float | None, str]:
    """Shortest sufficient length, by log-log interpolation between the last insufficient length and the next, and a note."""
    failing = [place for place, error in enumerate(errors) if error is None or error > accuracy]
    if not failing:
        return lengths[0], f"{lengths[0]:g} s or less"
    last = failing[-1]
    if last == len(lengths) - 1:
        return None, f"more than {lengths[-1]:g} s"
    before, after = errors[last], errors[last + 1]
    assert after is not None
    if before is None:
        return lengths[last + 1], f"between {lengths[last]:g} and {lengths[last + 1]:g} s"
    share = math.log(before / accuracy) / math.log(before / after)
    length = lengths[last] * (lengths[last + 1] / lengths[last]) ** share
    return length, f"{length:.3g} s"


def _only(names: Container[str], rows: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row for name, row in rows.items() if name in names}


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
