"""Combinations of the linear parameters, which data may determine where they do not determine the parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from shipfp_rs.support.arrays import Values

COMBINATIONS: Mapping[str, tuple[str, Callable[[Mapping[str, float]], float]]] = {
    "vK_p": ("-", lambda q: q["v"] * q["K_p"]),
    "vK_i": ("1/s", lambda q: q["v"] * q["K_i"]),
    "K_p/K_i": ("s", lambda q: q["K_p"] / q["K_i"]),
    "p-g": ("-", lambda q: q["p"] - q["g"]),
    "(p-g)/tau_n": ("1/s", lambda q: (q["p"] - q["g"]) / q["tau_n"]),
    "vK_p/tau_n": ("1/s", lambda q: _product(q, "p") / q["tau_n"]),
    "vK_i/tau_n": ("1/s2", lambda q: _product(q, "i") / q["tau_n"]),
    "tau_prop/tau_n": ("-", lambda q: q["tau_prop"] / q["tau_n"]),
    "(p-g)/(vK_i)": ("s", lambda q: (q["p"] - q["g"]) / _product(q, "i")),
    "(p-g)/(vK_i)+T_set": ("s", lambda q: (q["p"] - q["g"]) / _product(q, "i") + q["T_set"]),
}
"""Unit and value of each tried combination of the linear structure's parameters. A KeyError means not applicable."""


def _product(values: Values, letter: str) -> float:
    name = f"vK_{letter}"
    return values[name] if name in values else values["v"] * values[f"K_{letter}"]


def true_values(linear: Mapping[str, float]) -> dict[str, float]:
    """Return the linear parameters and all applicable combinations of them."""
    values = dict(linear)
    for name, (_, combine) in COMBINATIONS.items():
        values.setdefault(name, combine(linear))
    return values


def slope_of(name: str, values: Mapping[str, float | None], shift: Mapping[str, float]) -> float:
    """Directional derivative of a combination along a shift of the parameters."""
    _, function = COMBINATIONS[name]
    known = {key: value for key, value in values.items() if value is not None}
    try:
        step = 1e-6
        moved = {key: value + step * shift.get(key, 0.0) for key, value in known.items()}
        return (function(moved) - function(known)) / step
    except (KeyError, ZeroDivisionError):
        return 0.0
