"""How good an answer is: a fingerprint's JSON beside the truth of a draw, one draw at a time and many together.

Words, for one parameter of one fingerprint:

- known: status "free", with a finite value, standard deviation and interval.
- inside: known, and the interval holds the truth.
- gross: on a bound where the truth is not, or known and off by more than `FAR` standard deviations and by more than
  `TOLERANCE` of the truth (times: `TOLERANCE_S`; slopes that may be zero: `TOLERANCE_SLOPE`).
- as told: a fingerprint that has no sampling governor, no lag or no damping among its parameters tells their sum with
  others. `as_told` moves the truth accordingly: half a sampling period (and a lag) into T_d, half a period of the sum
  into vK_p, upwards where it is updated before use and downwards where after, the damping into
  p. What is inside only there is counted apart.

For one element: found (on, rightly), missed (off, but it matters), open, false (on, but there is none), alias (on, there
is none, but another delay that was not found acts in its place), unseen (off or open, there, but it does not matter).
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any

from scipy.stats import beta

from tests.families.plant import ELEMENTS

LATE_S = (0.0, 1.3, 3.5, 7.1)
"""When the windows begin, after the excitation does [s]."""


def apart(answers) -> list[str]:
    """Return the parameters of which one answer's value is outside another's interval; both must call it known."""
    names = dict.fromkeys(name for answer in answers for name in answer["parameters"])
    return [name for name in names if any(_outside(name, *pair) for pair in permutations(answers, 2))]


def _outside(name, one, other):
    rows = [answer["parameters"].get(name, {}) for answer in (one, other)]
    if not all(map(is_known, rows)):
        return False
    low, high = rows[1]["ci95"]
    return not low <= rows[0]["value"] <= high


def agreement(results) -> str:
    """Return a line for each ship, and on how many all answers lie within each other's intervals."""
    ships: dict[str, list] = {}
    for one in results:
        ships.setdefault(f"{one['family']} {one['seed']}", []).append(one["answer"])
    lines, agreed = [], 0
    for ship, answers in ships.items():
        missing = sum(answer is None for answer in answers)
        names = [] if missing else apart(answers)
        agreed += not missing and not names
        told = f"{missing} of {len(answers)} windows without an answer" if missing else ", ".join(names)
        lines.append(f"{ship}: {told or 'all agree'}")
    lines.append(f"all windows lie within each other's intervals: {agreed} of {len(ships)} ships")
    return "\n".join(lines)


FAR, TOLERANCE, TOLERANCE_S, TOLERANCE_SLOPE = 5.0, 0.02, 5e-3, 0.02
TIMES = ("T_d", "T_set", "T_s", "T_0", "T_n", "T_M", "tau_act")
SLOPES = ("g", "damping", "p-g")
NAMES = {
    "dead_time_loop": "T_d",
    "dead_time": "T_d",
    "dead_time_set_point": "T_set",
    "sampling": "T_s",
    "sampled_governor": "T_s",
    "actuator_lag": "tau_act",
    "actuator": "tau_act",
    "lag": "tau_act",
    "torque_limit": "M_max",
    "limit": "M_max",
    "rack_rate": "rate",
    "twist": "tau_twist",
    "shaft_twist": "tau_twist",
    "speed_filter": "T_f",
    "engine_lag": "tau_eng",
}
"""Other names that a fingerprint may give its elements."""
OF_STRANGERS = ("set_rate", "T_f", "tau_eng")
"""Elements that only `strangers` have: a ramp of the set point, a filter of the speed, a lag of the engine."""
LOOP = {"crossover": "crossover_hz", "phase margin": "phase_margin_deg", "gain margin": "gain_margin"}
"""Figures of the loop, and what a truth calls them."""
DELAYS = ("T_d", "T_s", "tau_act")
_UNSCORED = ("T_0", "k_L")
"""The first sample's instant counts from a window's begin, which the fit chooses; the load's factor is a unit."""
_OFF = ("absent", "fixed", None)


def score(
    answer: Mapping[str, Any], truth: Mapping[str, Any], verdicts: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Score one fingerprint.

    Parameters
    ----------
    answer
        The fingerprint's JSON: `parameters` and `derived` {name: {value, std, ci95, status}}, `elements` {name: {state}}.
    truth
        As `Draw.truth` returns it.
    verdicts
        As `matters.judged` returns them; None: every element that is on is taken to matter.
    """
    true = {"T_f": 0.0, "tau_eng": 0.0} | {
        name: value
        for name, value in truth["parameters"].items()
        if value is not None and name not in _UNSCORED
    }
    told = as_told(answer, true)
    rows = {}
    for name, estimate in answer.get("parameters", {}).items():
        if name in true and estimate.get("status") not in ("fixed", "prior"):
            rows[name] = _row(name, estimate, true[name], told[name])
    for name, estimate in answer.get("derived", {}).items():
        values = [evaluated(name, source) for source in (true, told)]
        if name not in rows and None not in values:
            rows[name] = _row(name, {"status": "free", **estimate}, *values) | {"derived": True}
    return {
        "parameters": rows,
        "elements": _elements(answer, truth["on"], verdicts),
        "adequate": (answer.get("adequate") or {}).get("stands"),
    }


def as_told(answer: Mapping[str, Any], true: Mapping[str, float]) -> dict[str, float]:
    """Return the truth in the words of a fingerprint that leaves sampling, lag or damping out."""
    there = {
        name
        for name, estimate in answer.get("parameters", {}).items()
        if estimate.get("status") != "fixed" and estimate.get("value") not in (None, 0.0)
    }
    told = dict(true)
    if "T_s" not in there and true.get("T_s"):
        told["T_d"] += 0.5 * true["T_s"]
        told["vK_p"] += (true.get("update", 0.0) - 0.5) * true["T_s"] * true["vK_i"]
    if "tau_act" not in there and true.get("tau_act"):
        told["T_d"] += true["tau_act"]
    if "damping" not in there and true.get("damping"):
        told["p"] += true["damping"]
    if "vK_i" in told:
        told["K_p/K_i"] = told["vK_p"] / told["vK_i"]
    return told


def loop_inside(told: Mapping[str, Any] | None, true: Mapping[str, float]) -> dict[str, bool]:
    """Whether the intervals of crossover, phase margin and gain margin hold the truth; what is not told does not."""
    found = {}
    for name, key in LOOP.items():
        interval = ((told or {}).get(name) or {}).get("ci95")
        low, high = interval or (math.nan, math.nan)
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        found[name] = bool(low <= true[key] <= high)
    return found


def is_known(estimate: Mapping[str, Any]) -> bool:
    """Whether a fingerprint gives a value with a finite interval."""
    interval = estimate.get("ci95")
    numbers = [estimate.get("value"), estimate.get("std"), *(interval if interval else [None])]
    finite = all(number is not None and math.isfinite(number) for number in numbers)
    return finite and estimate.get("status", "free") == "free"


def _row(name, estimate, true, told):
    known = is_known(estimate)
    value, deviation, interval = estimate.get("value"), estimate.get("std"), estimate.get("ci95")
    row = {"status": estimate.get("status"), "truth": true, "value": value, "known": known}
    tolerance = TOLERANCE_S if name in TIMES else TOLERANCE_SLOPE if name in SLOPES else TOLERANCE * abs(true)
    if known:
        low, high = interval
        row["inside"] = bool(low <= true <= high)
        row["inside_as_told"] = bool(low <= told <= high)
        row["deviations"] = (value - true) / deviation if deviation else None
        far, far_told = (
            abs(value - one) > FAR * deviation and abs(value - one) > tolerance for one in (true, told)
        )
        row["gross"], row["gross_as_told"] = bool(far), bool(far and far_told)
        row["half_width"] = 0.5 * (high - low)
    else:
        bound = estimate.get("status") == "at_bound" and value is not None
        row["gross"] = bool(bound and abs(value - true) > max(tolerance, 1e-12))
        row["gross_as_told"] = bool(row["gross"] and abs(value - told) > max(tolerance, 1e-12))
    return row


_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
}


def evaluated(expression: str, values: Mapping[str, float]) -> float | None:
    """Return the value of a combination such as "(p-g)/tau_n"; None where it holds a name without a value."""
    if expression in values:
        return values[expression]

    def of(node):
        if isinstance(node, ast.Expression):
            return of(node.body)
        if isinstance(node, ast.BinOp):
            return _OPERATORS[type(node.op)](of(node.left), of(node.right))
        if isinstance(node, ast.UnaryOp):
            return _OPERATORS[type(node.op)](of(node.operand))
        return float(node.value) if isinstance(node, ast.Constant) else values[node.id]

    try:
        return float(of(ast.parse(expression, mode="eval")))
    except (SyntaxError, KeyError, AttributeError, ZeroDivisionError, TypeError, ValueError):
        return None


def _states(answer):
    """State of each element; of a fingerprint without `elements` by which parameters are free."""
    if answer.get("elements"):
        return {NAMES.get(name, name): one.get("state") for name, one in answer["elements"].items()}
    parameters = answer.get("parameters", {})
    return {
        name: "off" if parameters.get(name, {}).get("status", "absent") in _OFF else "on"
        for name in (*ELEMENTS, *OF_STRANGERS)
    }


def _elements(answer, on: Sequence[str], verdicts):
    states = _states(answer)
    unfound = [name for name in DELAYS if name in on and states.get(name, "off") != "on"]
    rows = {}
    for name in (*ELEMENTS, *(name for name in OF_STRANGERS if name in states or name in on)):
        state = states.get(name, "off")
        verdict = ((verdicts or {}).get(name) or {}).get("verdict", "matters") if name in on else None
        if name not in on:
            kind = ("alias" if name in DELAYS and unfound else "false") if state == "on" else "rightly not on"
        elif state == "on":
            kind = "found"
        elif verdict != "matters":
            kind = "unseen"
        else:
            kind = "open" if state == "open" else "missed"
        rows[name] = {"state": state, "there": name in on, "verdict": verdict, "kind": kind}
    return rows


def binomial(count: int, of: int, level: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a share."""
    tail = 0.5 * (1.0 - level)
    low = 0.0 if count == 0 else float(beta.ppf(tail, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(1.0 - tail, count + 1, of - count))
    return low, high


def summary(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return counts over many draws: per parameter, and per element."""
    parameters: dict[str, dict[str, Any]] = {}
    elements: dict[str, dict[str, int]] = {}
    for one in scores:
        for name, row in one["parameters"].items():
            counts = parameters.setdefault(
                name,
                {"told": 0, "known": 0, "inside": 0, "inside_as_told": 0, "gross": 0, "gross_as_told": 0},
            )
            counts["told"] += 1
            for key in ("known", "inside", "inside_as_told", "gross", "gross_as_told"):
                counts[key] += bool(row.get(key))
        for name, row in one["elements"].items():
            kinds = elements.setdefault(name, {})
            kinds[row["kind"]] = kinds.get(row["kind"], 0) + 1
    for counts in parameters.values():
        counts["inside_interval"] = binomial(counts["inside"], counts["known"]) if counts["known"] else None
        counts["gross_interval"] = binomial(counts["gross"], counts["told"])
    return {"draws": len(scores), "parameters": parameters, "elements": elements}


def table(counts: Mapping[str, Any]) -> str:
    """Return a summary as text."""
    lines = [
        f"{'parameter':18}{'told':>6}{'known':>7}{'inside':>8}{'95 % of it':>16}{'as told':>9}"
        f"{'gross':>7}{'95 % of it':>16}{'as told':>9}"
    ]
    for name, row in counts["parameters"].items():
        inside = _share(row["inside_interval"])
        lines.append(
            f"{name:18}{row['told']:6}{row['known']:7}{row['inside']:8}{inside:>16}{row['inside_as_told']:9}"
            f"{row['gross']:7}{_share(row['gross_interval']):>16}{row['gross_as_told']:9}"
        )
    kinds = ("found", "missed", "open", "unseen", "false", "alias", "rightly not on")
    lines += ["", f"{'element':18}" + "".join(f"{kind:>16}" for kind in kinds)]
    for name, row in counts["elements"].items():
        lines.append(f"{name:18}" + "".join(f"{row.get(kind, 0):16}" for kind in kinds))
    return "\n".join(lines)


def _share(interval):
    return "" if interval is None else f"{100 * interval[0]:.0f} to {100 * interval[1]:.0f} %"
