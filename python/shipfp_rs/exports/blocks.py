"""The ship of a fingerprint as a block diagram, and its simulation step by step.

A Functional Mock-up Unit contains this module's text, so the module imports only the standard library.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from heapq import heappop, heappush
from math import ceil, exp, inf, log1p
from typing import Any, NamedTuple


class Block(NamedTuple):
    """A block with the names of its inputs, and its value as an expression of parameters."""

    name: str
    kind: str
    inputs: tuple[str, ...]
    value: str = ""


LAGS = ("T_f", "tau_act", "tau_eng")
LONGEST_S = 1e-3
"""Longest step of the simulation [s]."""
FOLLOWS_S = 1e-4
"""Time constant with which a rate limiter follows its input below the limit [s]."""
SIDE_S = 1e-9
"""Distance before and after an instant at which its left and right limits are read [s]."""
HELD = 0.5773502691896258
"""Distance of the two Gauss points from the middle of a sampling governor's hold, over half the hold."""


def _governed(q: Mapping[str, float], add: Callable[..., str]) -> str:
    """Add the blocks of governor and actuator, and return the name of the rack's block."""
    speed, gains = "speed", {name: f"v{name}" if f"v{name}" in q else name for name in ("K_p", "K_i", "K_d")}
    asked = add("set point", "gain", add("n_set", "input", value="n_set_0"), value="1/n_set_0")
    asked = add("set point deviation", "bias", asked, value="-1")
    if "set_rate" in q:
        asked = add("set point rate", "rate", asked, value="set_rate")
    if "T_set" in q:
        asked = add("set point dead time", "delay", asked, value="T_set")
    seen = add("speed filter", "lag", speed, value="T_f") if "T_f" in q else speed
    error = add("error", "sum", asked, seen, value="+-")
    less, summed = "", error
    if "droop" in q:
        # Droop lowers the set point with the command: the gains become smaller, and the integral decays.
        droop = "droop*v" if "v" in q else "droop"
        less = f"/(1+{droop}*{gains['K_p']})"
        error = add("drooped error", "gain", error, value=f"1{less}")
        faded = add("faded", "gain", "error integral", value=f"{droop}*{gains['K_i']}{less}")
        summed = add("error that is integrated", "sum", error, faded, value="+-")
    terms = [add("proportional", "gain", error, value=gains["K_p"])]
    integral = add("error integral", "integrator", summed)
    terms.append(add("integral", "gain", integral, value=gains["K_i"] + less))
    if gains["K_d"] in q:
        slope = "acceleration"
        if "T_f" in q:
            slope = add(
                "filtered slope", "gain", add("held back", "sum", speed, seen, value="+-"), value="1/T_f"
            )
        terms.append(add("derivative", "gain", slope, value=f"-{gains['K_d']}{less}"))
    rack = add("command", "sum", *terms, value="+" * len(terms))
    if "T_d" in q and "hold" in q:
        ends = [
            add(f"dead time {k}", "delay", rack, value=f"T_d*(1{s}{HELD}*hold)")
            for k, s in enumerate("+-", 1)
        ]
        rack = add("dead time", "gain", add("dead times", "sum", *ends, value="++"), value="0.5")
    elif "T_d" in q:
        rack = add("dead time", "delay", rack, value="T_d")
    if "rate" in q and "tau_act" in q:
        gap = add("rack gap", "gain", add("rack error", "sum", rack, "rack", value="+-"), value="1/tau_act")
        rack = add("rack", "integrator", add("rack rate", "clip", gap, value="rate"))
    elif "rate" in q:
        rack = add("rack", "rate", rack, value="rate")
    elif "tau_act" in q:
        rack = add("rack", "lag", rack, value="tau_act")
    return rack


def ship_blocks(q: Mapping[str, float], *, gauge: bool, loaded: bool) -> list[Block]:
    """Return a ship's blocks, for the elements in `q`; their signals are deviations relative to the operating point."""
    found: list[Block] = []

    def add(name: str, kind: str, *inputs: str, value: str = "") -> str:
        found.append(Block(name, kind, inputs, value))
        return name

    speed, rack = "speed", _governed(q, add)
    fuel, slope = (
        add("fuel", "gain", rack, value="v") if "v" in q else rack,
        add("engine slope", "gain", speed, value="g"),
    )
    brake = add("engine torque", "sum", fuel, slope, value="++")
    if "tau_eng" in q:
        brake = add("engine lag", "lag", brake, value="tau_eng")
    if "M_max" in q:
        brake = add("torque limit", "limit", brake, value="M_max-1" + (", M_soft" if "M_soft" in q else ""))
    twisted = "tau_twist" in q
    turned = "propeller speed" if twisted else speed
    power = add("propeller law", "power", add("relative speed", "bias", turned, value="1"), value="p")
    loads = [add("propeller torque", "bias", power, value="-1")]
    if "c_2" in q:
        loads.append(add("curvature", "gain", add("square", "product", turned, turned), value="c_2"))
    if "damping" in q:
        loads.append(add("damping torque", "gain", turned, value="damping"))
    if loaded:
        apart = add("load deviation", "bias", add("load", "input", value="load_0"), value="-load_0")
        loads.append(add("load torque", "gain", apart, value="k_L/load_scale"))
    against, shaft = add("against", "sum", *loads, value="+" * len(loads)), "against"
    if twisted:
        slip = add("slip", "sum", speed, turned, value="+-")
        spring = add("spring", "integrator", add("twist", "gain", slip, value="1/tau_twist"))
        shaft = add(
            "shaft torque", "sum", spring, add("shaft damping", "gain", slip, value="zeta_twist"), value="++"
        )
        excess = add("propeller excess", "sum", shaft, against, value="+-")
        add(turned, "integrator", add("propeller acceleration", "gain", excess, value="1/tau_prop"))
    excess = add("excess", "sum", brake, shaft, value="+-")
    inertia = "1/(tau_n-tau_prop)" if twisted else "1/tau_n"
    add(speed, "integrator", add("acceleration", "gain", excess, value=inertia))
    if gauge and not twisted:
        more = add("propeller inertia", "gain", "acceleration", value="tau_prop")
        shaft = add("shaft torque", "sum", against, more, value="++")
    add("torque", "gain", shaft if gauge else brake, value="1")
    return found


CODE = {
    "input": "i[{value}]",
    "gain": "{value} * {0}",
    "bias": "{0} + {value}",
    "product": "{0} * {1}",
    "clip": "min(max({0}, -{value}), {value})",
    "limit": "limited({0}, {value})",
    "power": "abs({0}) ** ({value} - 1.0) * {0}",
    "integrator": "{0}",
    "lag": "({0} - {state}) / {value}",
    "rate": "min(max(({0} - {state}) / FOLLOWS_S, -{value}), {value})",
}
"""Python expression of a block's output or, for a block with a state, of the state's derivative."""
STATES = ("integrator", "lag", "rate")


def limited(torque: float, most: float, softness: float = 0.0) -> float:
    """Return a torque limited to `most`, with the corner rounded by `softness` as in the package's stepper."""
    z = (most - torque) / softness if softness else inf if torque <= most else -inf
    if abs(z) > 40.0:
        return min(torque, most)
    free = exp(z) / (1.0 + exp(z))
    return torque * free + most * (1.0 - free) + softness * (z * free - log1p(exp(z)))


class Delay:
    """Past values of a signal, including both values at each jump."""

    def __init__(self, late: float) -> None:
        self.late = late
        self.times, self.values = [-inf], [0.0]

    def keep(self, time: float, value: float) -> None:
        """Store a value."""
        self.times.append(time)
        self.values.append(value)
        if len(self.times) > 100_000:
            first = max(bisect_right(self.times, time - self.late) - 2, 0)
            del self.times[:first], self.values[:first]

    def read(self, time: float) -> float:
        """Return the delayed value; for a delay shorter than a step, it is extrapolated with the last slope."""
        time -= self.late
        after = min(bisect_right(self.times, time), len(self.times) - 1)
        t, end, since, start = (
            self.times[after],
            self.values[after],
            self.times[after - 1],
            self.values[after - 1],
        )
        if after == 0 or since == -inf or t - since < SIDE_S:
            return start if time < t else end
        return start + (end - start) * (time - since) / (t - since)


class Model:
    """Simulation of a block diagram from rest by the fourth-order Runge-Kutta method; steps end exactly at jumps."""

    def __init__(self, blocks: Sequence[Block], parameters: Mapping[str, float]) -> None:
        """Raise `ValueError` for an algebraic loop."""
        known = {name: float(value) for name, value in parameters.items()}
        self.inputs = {one.name: known[one.value] for one in blocks if one.kind == "input"}
        self.delays = {
            one.name: Delay(eval(one.value, {"__builtins__": {}}, known))
            for one in blocks
            if one.kind == "delay"
        }
        names = {one.name: f"x{place}" for place, one in enumerate(blocks)}
        kept = [one for one in blocks if one.kind in STATES]
        table = {one.name: one for one in blocks}
        inside = {one.name: () if one in kept or one.kind == "delay" else one.inputs for one in blocks}
        try:
            order = [*TopologicalSorter(inside).static_order()]
        except CycleError as error:
            raise ValueError(f"{error.args[1][0]} depends on itself without a lag or dead time") from error

        def code(one: Block, **more: str) -> str:
            if one.kind == "sum":
                return " ".join(
                    f"{sign} {names[name]}" for sign, name in zip(one.value, one.inputs, strict=True)
                )
            value = repr(one.name) if one.kind == "input" else f"({one.value})"
            value = one.value if one.kind == "limit" else value
            return CODE[one.kind].format(*(names[name] for name in one.inputs), value=value, **more)

        lines = [f"{names[one.name]} = s[{place}]" for place, one in enumerate(kept)]
        lines += [f"{names[name]} = d[{place}]" for place, name in enumerate(self.delays)]
        done = {one.name for one in kept} | {*self.delays}
        lines += [f"{names[name]} = {code(table[name])}" for name in order if name not in done]
        slopes = ", ".join(code(one, state=names[one.name]) for one in kept)
        late = ", ".join(names[table[name].inputs[0]] for name in self.delays)
        shown = ", ".join(f"{name!r}: {names[name]}" for name in table)
        body = "\n ".join(lines)
        space: dict[str, Any] = {**known, "limited": limited, "FOLLOWS_S": FOLLOWS_S}
        exec(
            f"def rates(s, i, d):\n {body}\n return [{slopes}], [{late}]\n"
            f"def signals(s, i, d):\n {body}\n return {{{shown}}}",
            space,
        )
        self._rates, self._signals = space["rates"], space["signals"]
        self.time, self.state = 0.0, [0.0] * len(kept)
        limits = FOLLOWS_S if any(one.kind == "rate" for one in blocks) else LONGEST_S
        self.step = min([limits, *(1.0 / rate for rate in _rates(known) if rate > 0.0)])
        self.stops: list[float] = []
        for delay, value in zip(self.delays.values(), self._at(0.0)[1], strict=True):
            delay.keep(0.0, value)

    def _late(self, time: float) -> list[float]:
        return [delay.read(time) for delay in self.delays.values()]

    def _at(self, side: float) -> tuple[list[float], list[float]]:
        found: tuple[list[float], list[float]] = self._rates(
            self.state, self.inputs, self._late(self.time + side)
        )
        return found

    def _jump(self, before: list[float]) -> None:
        """Store the delays' inputs just before and after the present time, and add a stop where a jump will arrive."""
        after = self._at(SIDE_S)[1]
        for delay, start, end in zip(self.delays.values(), before, after, strict=True):
            delay.keep(self.time, start)
            delay.keep(self.time, end)
            if abs(end - start) > 1e-9:
                heappush(self.stops, self.time + delay.late)

    def feed(self, **inputs: float) -> None:
        """Set inputs from the present time on."""
        before = self._at(-SIDE_S)[1]
        self.inputs.update(inputs)
        self._jump(before)

    def advance(self, duration: float) -> None:
        """Advance by a duration [s]."""
        end = self.time + duration
        while self.time < end - SIDE_S:
            arrives = bool(self.stops) and self.stops[0] < end
            stop = max(self.stops[0], self.time) if arrives else end
            steps = ceil((stop - self.time) / self.step - SIDE_S)
            begun = self.time
            for step in range(steps):
                self._step((stop - begun) / steps)
                self.time = begun + (stop - begun) * (step + 1) / steps
            self.time = stop
            if arrives:
                heappop(self.stops)
                self._jump(self._at(-SIDE_S)[1])

    def _step(self, h: float) -> None:
        s, i, late = self.state, self.inputs, self._late(self.time + SIDE_S)
        first, kept = self._rates(s, i, late)
        for delay, value in zip(self.delays.values(), kept, strict=True):
            delay.keep(self.time, value)
        middle, last = self._late(self.time + 0.5 * h), self._late(self.time + h - SIDE_S)
        second = self._rates([x + 0.5 * h * k for x, k in zip(s, first, strict=True)], i, middle)[0]
        third = self._rates([x + 0.5 * h * k for x, k in zip(s, second, strict=True)], i, middle)[0]
        fourth = self._rates([x + h * k for x, k in zip(s, third, strict=True)], i, last)[0]
        slopes = zip(s, first, second, third, fourth, strict=True)
        self.state = [x + h / 6.0 * (a + 2.0 * (b + c) + d) for x, a, b, c, d in slopes]

    def signals(self) -> dict[str, float]:
        """Return every block's output at the present time."""
        found: dict[str, float] = self._signals(self.state, self.inputs, self._late(self.time - SIDE_S))
        return found


def _rates(q: Mapping[str, float]) -> list[float]:
    """Return the rates of a ship's fast elements [1/s], which limit the step."""
    rates = [1.0 / q[name] for name in LAGS if name in q]
    if "tau_twist" in q:
        light = 1.0 / (q["tau_n"] - q["tau_prop"]) + 1.0 / q["tau_prop"]
        rates += [2.0 * (light / q["tau_twist"]) ** 0.5, light * q.get("zeta_twist", 0.0)]
    return rates
