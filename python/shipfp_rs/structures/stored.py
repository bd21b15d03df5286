"""Structures as JSON, with starts, bounds, fixed values, priors and ties."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any, NotRequired

from pydantic import ConfigDict, with_config
from typing_extensions import TypedDict  # pydantic requires this one before Python 3.12

from shipfp_rs.errors import InputError
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.ship import KIND, commanded
from shipfp_rs.structures.ties import Tie, resolved, tied
from shipfp_rs.support.arguments import expect
from shipfp_rs.support.hints import suggestion
from shipfp_rs.support.validation import Ends, Figure, Flag, Text, require

LINEAR_OPTIONS = (
    "torque",
    "products",
    "free_exponent",
    "dead_time_loop",
    "dead_time_set_point",
)
SHIP_OPTIONS = ("elements", "torque", "products", "propeller_speed", "mean_sampling")


class StoredTie(TypedDict):
    """Tie of a parameter to another one: value = factor * value of `to` + offset."""

    to: Text
    factor: Figure
    offset: Figure


class StoredParameter(TypedDict):
    """Declaration of a parameter; in older files a fixed parameter has no bounds."""

    start: Figure
    fixed: Flag
    bounds: NotRequired[Ends | None]
    prior: NotRequired[Ends | None]
    tied: NotRequired[StoredTie | None]


@with_config(ConfigDict(extra="allow"))
class Stored(TypedDict, total=False):
    """Keys that every structure's tables have; further keys depend on its kind."""

    name: Text
    outputs: list[Text]
    parameters: Mapping[str, StoredParameter]


def to_dict(structure: Any) -> dict[str, Any]:
    """Return the structure as JSON tables, as stored in a fingerprint; an infinite bound is None."""
    return {
        "name": structure.name,
        **dict(structure.settings),
        "outputs": list(structure.outputs),
        "parameters": {parameter.name: _row(parameter) for parameter in structure.parameters},
    }


def _row(parameter: Parameter) -> dict[str, Any]:
    bounds = [end if math.isfinite(end) else None for end in (parameter.lower, parameter.upper)]
    return {
        "start": parameter.start,
        "bounds": bounds,
        "fixed": parameter.fixed,
        "prior": None if parameter.prior is None else list(parameter.prior),
        **({} if parameter.tied is None else {"tied": asdict(parameter.tied)}),
    }


def from_dict(declare: Any, content: Mapping[str, Any]) -> Any:
    """Return the structure of `to_dict`; `declare` is the class `Structure`, which imports this module."""
    ways: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
        "linear": lambda told: declare.linear(**_options(told, LINEAR_OPTIONS)),
        "ship": lambda told: declare.ship(**_options(told, SHIP_OPTIONS)),
        KIND: lambda told: commanded(declare, **_options(told, ("elements", "torque"))),
        "joint": lambda told: declare.joint(
            {label: from_dict(declare, part) for label, part in told["parts"].items()},
            told["shared"],
            name=told["name"],
        ),
    }
    require(content, Stored, "structure")
    kind = str(content.get("kind"))
    if kind not in ways:
        raise InputError(
            f"structure {content.get('name')!r} of the fingerprint has user equations, which a file can't hold; "
            "give structure=..."
        )
    try:
        made = ways[kind](content)
        rows = content["parameters"]
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"structure {content.get('name')!r}: found no table, or no key {error}; expected what Structure.to_dict writes"
        ) from error
    except InputError as error:
        raise InputError(f"structure: {error}") from error
    known = {parameter.name: parameter for parameter in made.parameters}
    for name in (*rows, *known):
        if name not in known:
            raise InputError(
                f"structure.parameters: no parameter {name!r} in {made.name!r}, {suggestion(name, list(known))}"
            )
        if name not in rows:
            raise InputError(
                f"structure.parameters: found no {name!r}, expected a table of its start and bounds"
            )
    parameters = tuple(_parameter(parameter, rows[name]) for name, parameter in known.items())
    for parameter in parameters:
        if parameter.tied is not None and parameter.tied.to not in known:
            raise InputError(
                f"structure.parameters.{parameter.name}.tied.to: no parameter {parameter.tied.to!r}, "
                f"{suggestion(parameter.tied.to, list(known))}"
            )
    ties = resolved({one.name: one.tied for one in parameters if one.tied is not None})
    return replace(made, parameters=parameters, equations=tied(made.equations, ties))


def _options(content: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return {name: content[name] for name in (*names, "outputs", "name") if name in content}


def _parameter(declared: Parameter, row: Mapping[str, Any]) -> Parameter:
    key = f"structure.parameters.{declared.name}"
    lower, upper = declared.lower, declared.upper
    if row.get("bounds") is not None:
        low, high = row["bounds"]
        lower, upper = -math.inf if low is None else float(low), math.inf if high is None else float(high)
    prior, tie = row.get("prior"), row.get("tied")
    if tie is not None:
        expect(tie["factor"] != 0.0, f"{key}.tied.factor", tie["factor"], "a number that is not 0")
    try:
        return replace(
            declared,
            start=float(row["start"]),
            lower=lower,
            upper=upper,
            fixed=row["fixed"],
            prior=None if prior is None else (float(prior[0]), float(prior[1])),
            tied=None if tie is None else Tie(tie["to"], float(tie["factor"]), float(tie["offset"])),
        )
    except InputError as error:
        raise InputError(f"structure.parameters: {error}") from error
