"""Structures as JSON and back: what was declared, with every start, bound, fixed value, prior and tie."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.ties import Tie, resolved, tied

LINEAR_OPTIONS = (
    "torque",
    "products",
    "free_exponent",
    "dead_time_loop",
    "dead_time_set_point",
)
SHIP_OPTIONS = ("elements", "torque", "products", "propeller_speed", "mean_sampling")


def to_dict(structure: Any) -> dict[str, Any]:
    """Return the JSON form kept in a fingerprint; a bound without end is None."""
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
    """Return the structure that `to_dict` wrote; `declare` is the class `Structure`, which imports this.

    Raises
    ------
    InputError
        For equations of a user's own, which JSON can't hold, and for what `to_dict` did not write.
    """
    ways: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
        "linear": lambda told: declare.linear(**_options(told, LINEAR_OPTIONS)),
        "ship": lambda told: declare.ship(**_options(told, SHIP_OPTIONS)),
        "joint": lambda told: declare.joint(
            {label: from_dict(declare, part) for label, part in told["parts"].items()},
            told["shared"],
            name=told["name"],
        ),
    }
    kind = str(content.get("kind"))
    if kind not in ways:
        raise InputError(
            f"structure {content.get('name')!r} of the fingerprint has equations of its own, and a file can't hold its "
            "equations; give structure=..."
        )
    try:
        made = ways[kind](content)
        rows = content["parameters"]
        settings = {
            key: value for key, value in content.items() if key not in ("name", "outputs", "parameters")
        }
        parameters = tuple(_parameter(parameter, rows[parameter.name]) for parameter in made.parameters)
        ties = resolved({one.name: one.tied for one in parameters if one.tied is not None})
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"structure {content.get('name')!r}: found no table, or no key {error}; expected what Structure.to_dict writes"
        ) from error
    return replace(made, parameters=parameters, equations=tied(made.equations, ties), settings=settings)


def _options(content: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return {name: content[name] for name in (*names, "outputs", "name") if name in content}


def _parameter(declared: Parameter, row: Mapping[str, Any]) -> Parameter:
    lower, upper = declared.lower, declared.upper
    if row.get("bounds") is not None:  # older files have none for a fixed parameter
        low, high = row["bounds"]
        lower, upper = -math.inf if low is None else float(low), math.inf if high is None else float(high)
    tie = row.get("tied")
    return replace(
        declared,
        start=float(row["start"]),
        lower=lower,
        upper=upper,
        fixed=bool(row["fixed"]),
        prior=None if row["prior"] is None else (float(row["prior"][0]), float(row["prior"][1])),
        tied=None if tie is None else Tie(str(tie["to"]), float(tie["factor"]), float(tie["offset"])),
    )
