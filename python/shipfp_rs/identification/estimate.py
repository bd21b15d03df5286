"""Estimates and identifiability of a fingerprint's parameters, and the rounding of estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from shipfp_rs.support.arrays import DEVIATIONS_95
from shipfp_rs.support.files import finite
from shipfp_rs.support.hints import Hinted
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.validation import Figure, Number, Text, Whole, validated, wrong

Status = Literal["free", "fixed", "prior", "at_bound", "unidentifiable"]

STATUS: Mapping[str, str] = {
    "free": "estimated",
    "fixed": "given",
    "prior": "estimated, with the help of an expected range",
    "at_bound": "on its bound",
    "unidentifiable": "not identifiable",
}

ALONG = "estimated, without an interval"
"""Reason given for a searched parameter that has no interval."""
ASSUMED = "assumed"
"""Reason given for a parameter that was neither given nor estimated."""

KNOWN: tuple[Status, ...] = ("free", "prior")
"""Statuses of an estimate with an interval."""

Usable = Literal["", "usable", "usable except", "not usable"]
"""Extent to which a fingerprint can be used; empty where this was not judged."""
WhyNot = Literal["", "no minimum", "nothing explained", "nothing told", "misfit"]
"""Reason why a fingerprint can't be used; empty where it can."""


def _ends(given: Any) -> Any:
    """Return the ends of an interval; null in JSON means unbounded."""
    if not isinstance(given, list | tuple) or len(given) != 2:
        raise wrong("null or two numbers")
    return [end if one is None else one for one, end in zip(given, (-math.inf, math.inf), strict=True)]


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] <= ends[1]:
        raise wrong("its lower end first")
    return ends


Interval = Annotated[tuple[Figure, Figure], BeforeValidator(_ends), AfterValidator(_ordered)]
Spread = Annotated[float, Field(strict=True, ge=0.0)]


@validated
@dataclass(frozen=True)
class Estimate(Hinted):
    """One parameter or combination: value, standard deviation, 95 % interval, unit, status.

    `value`, `std` and `ci95` are None where the data do not determine them; `reason` then says why.
    """

    value: Number | None
    std: Spread | None = None
    ci95: Interval | None = None
    unit: Text = "-"
    status: Status = "free"
    reason: Text = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return dict(finite(self))


UNKNOWN = 0.9
"""Share of the range between the bounds (logarithmic if both are positive) above which an interval has no information."""


def unidentifiable(reason: str, unit: str) -> Estimate:
    """Return the estimate of a parameter that the data do not determine."""
    return Estimate(None, unit=unit, status="unidentifiable", reason=reason)


def with_interval(
    value: float,
    interval: tuple[float, float],
    unit: str,
    status: Status = "free",
    *,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    quantile: float = DEVIATIONS_95,
) -> Estimate:
    """Return an estimate clipped to the bounds; not identifiable if its interval covers over `UNKNOWN` of their range."""
    least, most = bounds
    value = float(min(max(value, least), most))
    low, high = float(min(max(interval[0], least), value)), float(max(min(interval[1], most), value))
    width, whole = high - low, most - least
    if low > 0.0 and least > 0.0:
        width, whole = math.log(high / low), math.log(most / least)
    if not width <= UNKNOWN * whole or not math.isfinite(width):
        reason = Sentence(
            "the data allow any value between {low} and {high}", low=f"{low:.3g}", high=f"{high:.3g}"
        )
        return unidentifiable(reason, unit)
    return Estimate(value, (high - low) / (2.0 * quantile), (low, high), unit, status)


def scaled(estimate: Estimate, factor: float, unit: str) -> dict[str, Any]:
    """Return an estimate in another unit, in the form of `Fingerprint.si`."""
    assert estimate.value is not None
    interval = None if estimate.ci95 is None else [factor * end for end in estimate.ci95]
    return {
        "value": factor * estimate.value,
        "std": None if estimate.std is None else factor * estimate.std,
        "ci95": interval,
        "unit": unit,
    }


ROUGH, OPEN = 0.25, 2.0
"""Half width of an interval relative to the value, above which a parameter is rough, and above which it is unknown."""
SMALL: Mapping[str, float] = {"s": 0.05, "-": 0.5, "1/s": 0.5}
"""Small value of a ship's parameters by unit, to which an interval about a value near zero is relative."""


def roughness(estimate: Estimate) -> float:
    """Return the interval's half width over the value, or over `SMALL` if that is larger; 0 without an interval."""
    if estimate.value is None or estimate.ci95 is None:
        return 0.0
    size = max(abs(estimate.value), SMALL.get(estimate.unit, 0.0), 1e-300)
    return 0.5 * (estimate.ci95[1] - estimate.ci95[0]) / size


def is_rough(estimate: Estimate, most: float = ROUGH) -> bool:
    """Whether the `roughness` of an estimate exceeds a limit."""
    return roughness(estimate) > most


@validated
@dataclass(frozen=True)
class Identifiability:
    """Numerical rank of the sensitivities at the estimate, and the directions that the data do not determine.

    `null_space` has an entry for each direction: {"combination": text, "direction": {parameter: relative change}}.
    `closes_gap` names parameters; knowing any of them makes the others identifiable.
    """

    rank: Whole
    free: Whole
    condition: Annotated[Figure, BeforeValidator(lambda value: math.inf if value is None else value)]
    null_space: tuple[Mapping[str, Any], ...] = ()
    closes_gap: tuple[Text, ...] = ()

    def __post_init__(self) -> None:
        if self.rank > self.free:
            raise wrong(f"0 to {self.free}, the number of free parameters", self.rank, "rank")


@dataclass(frozen=True)
class Row:
    """A row of a table of estimates, rounded to the uncertainty; empty text where a value is None."""

    name: str
    value: str
    std: str
    low: str
    high: str
    unit: str
    status: str
    reason: str
    truth: str = ""
    holds_truth: bool | None = None


def rounded_rows(
    estimates: Mapping[str, Estimate], truth: Mapping[str, float] | None = None
) -> Iterator[Row]:
    """Yield a row for each estimate, with the true value and whether the interval contains it, where known."""
    for name, estimate in estimates.items():
        places = decimals(estimate.std)
        real = (truth or {}).get(name)
        low, high = estimate.ci95 if estimate.ci95 is not None else (None, None)
        yield Row(
            name=name,
            value=rounded(estimate.value, places),
            std=rounded(estimate.std, places),
            low=rounded(low, places),
            high=rounded(high, places),
            unit=estimate.unit,
            status=estimate.reason if estimate.reason in (ALONG, ASSUMED) else STATUS[estimate.status],
            reason=estimate.reason,
            truth=rounded(real, places if real else None),
            holds_truth=None if real is None or low is None or high is None else low <= real <= high,
        )


def decimals(std: float | None) -> int | None:
    """Digits after the point (before it: negative) for two significant digits of a standard deviation; None without one."""
    if not std or not math.isfinite(std):
        return None
    return min(max(1 - math.floor(math.log10(std)), -9), 9)


def rounded(value: float | None, places: int | None) -> str:
    """Format a value with `places` digits after the point, or with four significant digits if None; empty for no value."""
    if value is None:
        return ""
    if places is None or not math.isfinite(value):
        return f"{value:.4g}"
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"
