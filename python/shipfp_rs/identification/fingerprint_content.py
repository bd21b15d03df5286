"""The fields of a fingerprint, validated by pydantic, and checks of their consistency when a file is read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NotRequired

from pydantic import ConfigDict, Field, InstanceOf, with_config
from typing_extensions import TypedDict  # pydantic does not support the `TypedDict` of older Pythons

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.estimate import KNOWN, Estimate, Identifiability, Usable, WhyNot
from shipfp_rs.identification.question import Intervals, NoiseModel
from shipfp_rs.identification.sampling import Between
from shipfp_rs.structures.stored import Stored
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import expect
from shipfp_rs.support.validation import Ends, Figure, Flag, Number, Shape, Text, Whole, validated

ALARM = 0.01
"""Probability of a false alarm of each residual test, over all outputs."""
WHOLE, LAWLESS = 0.8, 0.5
"""A measured load is all the torque of a shaft from this share of that torque, if the exponent p of the remaining load is
smaller than the second number."""
open_table = with_config(ConfigDict(extra="allow"))


@open_table
class Quantity(TypedDict):
    """A quantity in SI units."""

    value: Number | None
    unit: Text
    std: NotRequired[Figure | None]
    ci95: NotRequired[Ends | None]


@open_table
class Element(TypedDict):
    """What is known about an element of the ship model."""

    state: Literal["on", "off", "open"]


@open_table
class Adequate(TypedDict, total=False):
    """Whether the model describes the data."""

    stands: Flag
    misses_pct: Mapping[str, Annotated[Figure, Field(ge=0.0)] | None]
    sides: Mapping[str, Flag]
    engine: Mapping[str, Mapping[str, Figure]]
    limit: Mapping[str, Figure]
    engine_curves: Mapping[str, Mapping[str, Sequence[Figure]]]


@open_table
class Settings(TypedDict, total=False):
    """Settings of a fit, and results of its search."""

    starts: Annotated[Whole, Field(ge=1)]
    time_limit_s: Annotated[Figure, Field(gt=0.0)] | None
    structure: Text
    noise: NoiseModel
    intervals: Intervals
    set_point: Between | Literal["straight lines"]
    set_point_noise: Literal["left out", "taken for signal"]
    optimum: Mapping[str, Figure]
    criterion: Figure | None
    converged: Flag
    message: Text
    minima: Sequence[Mapping[str, Any]]
    possible: Sequence[Mapping[str, Figure]]
    priors: Mapping[str, Sequence[Figure]]


@open_table
class Covariance(TypedDict):
    """Covariance of the searched parameters."""

    names: list[Text]
    matrix: list[list[Figure]]


@validated
@dataclass(frozen=True)
class Content:
    """The fields of a `Fingerprint`, whose docstring describes them."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    fit: Mapping[str, Mapping[str, Figure | None]]
    structure: Annotated[Mapping[str, Any], Shape(Stored)]
    vessel: Text | None = None
    data: tuple[Mapping[str, Any], ...] = ()
    settings: Annotated[Mapping[str, Any], Shape(Settings)] = field(default_factory=dict)
    seed: Whole | None = None
    versions: Mapping[str, Text] = field(default_factory=dict)
    verdict: tuple[Text, ...] = ()
    covariance: Annotated[Mapping[str, Any], Shape(Covariance)] = field(
        default_factory=lambda: {"names": [], "matrix": []}
    )
    residuals: Mapping[str, Mapping[str, Mapping[str, Any]]] = field(default_factory=dict)
    elements: Annotated[Mapping[str, Mapping[str, Any]], Shape(dict[str, Element])] = field(
        default_factory=dict
    )
    adequate: Annotated[Mapping[str, Any], Shape(Adequate)] = field(default_factory=dict)
    load_side: Mapping[str, Estimate] = field(default_factory=dict)
    behind_meter: Mapping[str, Estimate] = field(default_factory=dict)
    usable: Text = ""
    usability: Usable = ""
    why_not: WhyNot = ""
    si: Annotated[Mapping[str, Mapping[str, Any]], Shape(dict[str, Quantity])] = field(default_factory=dict)
    held_out: Mapping[str, Mapping[str, Mapping[str, Figure | None]]] = field(default_factory=dict)
    experiments: tuple[InstanceOf[Experiment], ...] = field(default=(), compare=False)

    @property
    def model_adequate(self) -> bool | None:
        """Whether the residuals are consistent with the model, by a test of structure or by `adequate`; None without either.

        A correct structure is rejected in one fit of a hundred.
        """
        p = self.fit.get("overall", {}).get("structure_p")
        return self.adequate.get("stands") if p is None else p >= ALARM

    @property
    def ends_at_meter(self) -> bool:
        """Whether the model ends at a torque meter: the measured load is then all the torque of a shaft, law included."""
        loads, p = [row.get("load", {}) for row in self.data], self.parameters.get("p")
        return (
            "load" in self.structure.get("elements", ())
            and all(one.get("quantity") == "torque" and one["share"] >= WHOLE for one in loads)
            and (p is None or p.value is None or abs(p.value) < LAWLESS)
        )

    @property
    def engine_described(self) -> bool:
        """Whether the model describes drive and governor (true if not tested); if not, only the load is reported."""
        return bool(self.adequate.get("sides", {}).get("engine", True))

    @property
    def optimum(self) -> Mapping[str, float]:
        """Value of every parameter at the minimum, whether the data determine it or not; `InputError` without a search."""
        expect("optimum" in self.settings, "settings.optimum", None, "every parameter's value")
        return dict(self.settings["optimum"])


REBUILT = ("linear", "ship", "commanded", "joint")
"""Kinds of structures that a file describes completely."""
LEAST_STD = 1e-100
"""Least standard deviation other than zero: the square of a smaller one underflows double precision."""
OF_A_SEARCH = ("optimum", "criterion", "converged", "message", "minima")
"""Settings that occur only together."""


def require_agreement(found: Content) -> None:
    """Raise an `InputError` that names a key, where parts of a fingerprint contradict each other."""
    for key in ("parameters", "derived", "load_side", "behind_meter"):
        for name, one in getattr(found, key).items():
            _require_estimate(f"{key}.{name}", one.value, one.std, one.ci95)
    for name, row in found.si.items():
        _require_estimate(f"si.{name}", row["value"], row.get("std"), row.get("ci95"))
    for output, figures in found.fit.items():
        for figure, value in figures.items():
            most = 1.0 if figure.endswith("_p") else 100.0 if figure.endswith("_pct") else math.inf
            expect(value is None or value <= most, f"fit.{output}.{figure}", value, f"{most:g} or less")
    if found.structure.get("kind") in REBUILT:
        Structure.from_dict(found.structure)
    names, matrix = found.covariance["names"], found.covariance["matrix"]
    expect({*names} <= {*found.parameters}, "covariance.names", names, "names of parameters")
    square = [len(row) for row in matrix] == [len(names)] * len(names)
    expect(square, "covariance.matrix", matrix, f"{len(names)} rows of as many numbers")
    for place, row in enumerate(matrix):
        expect(row[place] >= 0.0, f"covariance.matrix[{place}][{place}]", row[place], "a variance, 0 or more")
    for name in OF_A_SEARCH if any(name in found.settings for name in OF_A_SEARCH) else ():
        expect(name in found.settings, f"settings.{name}", None, "a value, as of every search")
    if "optimum" in found.settings:
        _require_optimum(found)


def _require_estimate(
    key: str, value: float | None, std: float | None, ends: Sequence[float | None] | None
) -> None:
    expect(not std or std >= LEAST_STD, f"{key}.std", std, f"null, 0 or a number of {LEAST_STD:g} or more")
    has_value = std is None or value is not None
    expect(has_value, f"{key}.value", None, "a number, since there is a standard deviation")
    low, high = ends or (None, None)
    if value is not None and low is not None and high is not None and math.isfinite(high - low):
        near = 2.0 * low - high <= value <= 2.0 * high - low
        expect(near, f"{key}.ci95", ends, f"an interval about the value, {value:.4g}")


def _require_optimum(found: Content) -> None:
    """Refuse an optimum that no search can reach: it is outside the bounds, or a fixed parameter differs."""
    values = {f"settings.optimum.{name}": (name, value) for name, value in found.optimum.items()}
    for name, one in found.parameters.items():
        expect(name in found.optimum, f"settings.optimum.{name}", None, "a number")
        if one.status in KNOWN and one.value is not None:
            values[f"parameters.{name}.value"] = name, one.value
    for key, (name, value) in values.items():
        row = found.structure.get("parameters", {}).get(name, {})
        low, high = row.get("bounds") or (None, None)
        if row.get("fixed"):
            low = high = row["start"]
        slack = 1e-9 * max(abs(value), 1.0)
        within = (low is None or value >= low - slack) and (high is None or value <= high + slack)
        expect(within, key, value, f"a number within what is declared, {low} to {high}")
