"""The ship with sampling, limits, delays and a flexible shaft, by SciPy's DOP853 between events found by its root finder.

Written from the equations alone. Which limits hold is frozen over a stretch, and changed by events and at breaks.
Delayed commands are looked up in dense outputs.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from shipfp_rs._core import SHIP_PARAMETERS
from tests.twins.plant import vectors

Array = npt.NDArray[np.float64]
OFF = {
    "K_d": 0.0, "tau_prop": 0.0, "T_d": 0.0, "T_set": 0.0, "T_s": 0.0, "T_0": 0.0, "tau_act": 0.0, "M_max": math.inf,
    "M_max_slope": 0.0, "M_min": -math.inf, "rate_up": math.inf, "rate_down": math.inf, "X_max": math.inf,
    "X_min": -math.inf, "anti_windup": 0.0, "damping": 0.0, "load_gain": 0.0, "tau_twist": 0.0, "zeta_twist": 0.0,
    "T_n": 0.0, "T_M": 0.0, "s_u": 1.0, "s_M": 1.0, "initial_N": 1.0, "initial_F": 0.0, "update": 0.0,
    "curvature": 0.0, "initial_E": 0.0, "u_0": 0.0, "M_soft": 0.0, "hold": 0.0,
    "T_f": 0.0, "tau_eng": 0.0, "droop": 0.0,
}  # fmt: skip
SHIP = {"tau_n": 1.44, "g": -0.58, "v": 1.58, "K_p": 4.0, "K_i": 3.0, "p": 2.17, "tau_prop": 0.4}
N, P, SPRING, SUM, RACK, SEEN, BURNT = range(7)
TINY = 1e-9
"""Times closer than this [s] are one."""


vector = vectors(OFF | SHIP, SHIP_PARAMETERS)
"""Parameters of a ship for the kernel, some of them changed."""


def simulate(
    values: Mapping[str, float], u: Array, load: Array, dt: float, hold: str, outputs: tuple[str, ...]
) -> Array:
    """Return the outputs, shape (O, N)."""
    return _Simulation({**OFF, **SHIP, **values}, u, load, dt, hold).run(outputs)


class _Simulation:
    def __init__(self, v: dict[str, float], u: Array, load: Array, dt: float, hold: str) -> None:
        self.v, self.u, self.load, self.dt, self.hold = v, u, load, dt, hold
        self.sampled = v["T_s"] > 0.0
        self.limited = min(v["rate_up"], v["rate_down"]) < math.inf
        self.follows = self.limited and v["tau_act"] == 0.0
        self.window = (0.0, 0.0)
        self.kinks: list[float] = []
        self.before = v["initial_F"] / v["v"]
        self.standing = self.before - v["K_p"] * (v["s_u"] * u[0] + v["u_0"] - v["initial_N"])
        against = self.resisting(v["initial_N"], 0.0, 1)
        rate = (1.0 + v["g"] * (v["initial_N"] - 1.0) + v["initial_F"] - against) / v["tau_n"]
        self.standing += v["K_d"] * rate * (v["T_f"] == 0.0)
        self.standing += v["K_p"] * self.droop * self.before
        self.x = np.array(
            [
                v["initial_N"],
                v["initial_N"],
                against + v["tau_prop"] * rate,
                self.standing / v["K_i"] + v["initial_E"],
                self.before,
                v["initial_N"],
                v["g"] * (v["initial_N"] - 1.0) + v["initial_F"],
            ]
        )
        self.held = self.before
        self.torque_side = self.rack_side = self.rate_side = 0
        self.sum_mode = "runs"
        self.starts: list[float] = []
        self.pieces: list[tuple[float, Callable[[float], Array], tuple[int, int, int, str]]] = []

    def inside(self, t: float, side: int) -> float:
        """A time within the stretch under way, where no side is meant."""
        first, last = self.window
        return t if side else max(min(t, last - 3.0 * TINY), first + 3.0 * TINY)

    def at(self, samples: Array, t: float, late: float, side: int) -> tuple[float, float]:
        """Value and slope of a held input, to the left (-1) or the right (1) of a time or within a stretch (0)."""
        if len(samples) == 0:
            return 0.0, 0.0
        time = self.inside(t, side) - late
        place = math.floor(time / self.dt + side * TINY / self.dt)
        if place < 0:
            return samples[0], 0.0
        place = min(place, len(samples) - 1)
        if self.hold == "zero" or place == len(samples) - 1:
            return samples[place], 0.0
        slope = (samples[place + 1] - samples[place]) / self.dt
        return samples[place] + slope * (time - place * self.dt), slope

    def resisting(self, n: float, time: float, side: int) -> float:
        v = self.v
        return (
            n * abs(n) ** (v["p"] - 1.0)
            + v["damping"] * (n - 1.0)
            + v["curvature"] * (n - 1.0) ** 2
            + v["load_gain"] * self.at(self.load, time, 0.0, side)[0]
        )

    def torque(self, n: float, rack: float, burnt: float) -> float:
        v = self.v
        if self.torque_side:
            return self.torque_limit(self.torque_side, n)
        if v["tau_eng"]:
            return 1.0 + burnt
        return 1.0 + v["g"] * (n - 1.0) + v["v"] * rack

    def torque_limit(self, side: int, n: float) -> float:
        v = self.v
        return v["M_max"] + v["M_max_slope"] * (n - 1.0) if side > 0 else v["M_min"]

    def clipped(self, asked: float) -> float:
        return {0: asked, 1: self.v["X_max"], -1: self.v["X_min"]}[self.rack_side]

    def ceiling(self, side: int, n: float) -> tuple[float, float]:
        """What limits the command above (1) or below (-1), and how it rises with the speed."""
        v = self.v
        limit, slope, own = (
            (v["M_max"], v["M_max_slope"], v["X_max"]) if side > 0 else (v["M_min"], 0.0, v["X_min"])
        )
        by_torque = (limit + slope * (n - 1.0) - 1.0 - v["g"] * (n - 1.0)) / v["v"]
        return (by_torque, (slope - v["g"]) / v["v"]) if side * by_torque < side * own else (own, 0.0)

    def command(self, t: float, x: Array, side: int, rate: float) -> float:
        v = self.v
        error = v["s_u"] * self.at(self.u, t, v["T_set"], side)[0] + v["u_0"] - self.seen(x)
        rate = (x[N] - x[SEEN]) / v["T_f"] if v["T_f"] else rate
        return (v["K_p"] * error + v["K_i"] * x[SUM] - v["K_d"] * rate) / (1.0 + v["K_p"] * self.droop)

    @property
    def droop(self) -> float:
        """Decrease of the set point over the command."""
        return self.v["droop"] * self.v["v"]

    def seen(self, x: Array) -> float:
        """The speed that the governor sees."""
        return float(x[SEEN if self.v["T_f"] else N])

    def past(self, t: float, side: int) -> float:
        """The continuous governor's command T_d before a time, of a hold that of Gauss's two points."""
        return sum(self.earlier(t, side, delay) for delay in self.delays) / len(self.delays)

    @property
    def delays(self) -> tuple[float, ...]:
        delay, apart = self.v["T_d"], self.v["T_d"] * self.v["hold"] / math.sqrt(3.0)
        return (delay - apart, delay + apart) if apart else (delay,)

    def earlier(self, t: float, side: int, delay: float) -> float:
        then = self.inside(t, side) - delay
        side = side or 1
        if then + side * TINY < 0.0:
            return self.before
        place = max(bisect.bisect_right(self.starts, then + side * TINY) - 1, 0)
        _, solution, mode = self.pieces[place]
        kept = self.mode
        self.mode = mode
        x = solution(then)
        command = self.command(then, x, side, self.rates(then, x, side)[N] if self.v["K_d"] else 0.0)
        self.mode = kept
        return command

    @property
    def mode(self) -> tuple[int, int, int, str]:
        return self.torque_side, self.rack_side, self.rate_side, self.sum_mode

    @mode.setter
    def mode(self, mode: tuple[int, int, int, str]) -> None:
        self.torque_side, self.rack_side, self.rate_side, self.sum_mode = mode

    def signals(self, t: float, x: Array, side: int) -> tuple[float, float, float, float]:
        """Rate of the engine's speed, what is asked of the actuator, the rack, and the brake torque."""
        v = self.v
        flexible = v["tau_twist"] > 0.0
        against = x[SPRING] + v["zeta_twist"] * (x[N] - x[P]) if flexible else self.resisting(x[N], t, side)
        inertia = v["tau_n"] - v["tau_prop"] if flexible else v["tau_n"]
        direct = not self.sampled and v["T_d"] == 0.0
        stands = v["tau_act"] > 0.0 or self.rate_side != 0

        def outcome(rack: float) -> tuple[float, float]:
            torque = self.torque(x[N], rack, x[BURNT])
            return (torque - against) / inertia, torque

        if stands:
            rack = x[RACK]
            rate, torque = outcome(rack)
            asked = self.command(t, x, side, rate) if direct else self.asked(t, side)
        elif not direct:
            asked = self.asked(t, side)
            rack = self.clipped(asked)
            rate, torque = outcome(rack)
        else:
            asked = self.command(t, x, side, 0.0)
            if v["K_d"]:
                asked = _fixed(lambda a: self.command(t, x, side, outcome(self.clipped(a))[0]) - a, asked)
            rack = self.clipped(asked)
            rate, torque = outcome(rack)
        return rate, asked, rack, torque

    def asked(self, t: float, side: int) -> float:
        return self.held if self.sampled else self.past(t, side)

    def rates(self, t: float, x: Array, side: int = 0) -> Array:
        v = self.v
        rate, asked, rack, _ = self.signals(t, x, side)
        slip = x[N] - x[P]
        found = np.zeros(7)
        found[N] = rate
        if v["T_f"]:
            found[SEEN] = (x[N] - x[SEEN]) / v["T_f"]
        if v["tau_eng"]:
            found[BURNT] = (v["g"] * (x[N] - 1.0) + v["v"] * rack - x[BURNT]) / v["tau_eng"]
        if v["tau_twist"] > 0.0:
            found[SPRING] = slip / v["tau_twist"]
            twisting = x[SPRING] + v["zeta_twist"] * slip
            found[P] = (twisting - self.resisting(x[P], t, side)) / v["tau_prop"]
        if v["tau_act"] > 0.0:
            wanted = (self.clipped(asked) - x[RACK]) / v["tau_act"]
            found[RACK] = {0: wanted, 1: v["rate_up"], -1: -v["rate_down"]}[self.rate_side]
        elif self.rate_side:
            found[RACK] = v["rate_up"] if self.rate_side > 0 else -v["rate_down"]
        if not self.sampled:
            found[SUM] = self.sum_rate(t, x, side, rate)
        return found

    def sum_rate(self, t: float, x: Array, side: int, rate: float) -> float:
        v = self.v
        set_point, slope = self.at(self.u, t, v["T_set"], side)
        error = v["s_u"] * set_point + v["u_0"] - self.seen(x)
        if self.sum_mode == "runs":
            return error - self.droop * (self.command(t, x, side, rate) if self.droop else 0.0)
        if self.sum_mode == "stands":
            return 0.0
        # On the ceiling: K_p de/dt + K_i dI/dt is the ceiling's own rate. Only without K_d.
        above = 1 if error > 0.0 else -1
        return (self.ceiling(above, x[N])[1] * rate - v["K_p"] * (v["s_u"] * slope - rate)) / v["K_i"]

    def stops(self, outputs: tuple[str, ...]) -> list[float]:
        v, end = self.v, len(self.u) * self.dt
        times = [0.0]
        grid = np.arange(len(self.u)) * self.dt
        for output in outputs:
            times += list(grid - self.late(output))
        if len(self.load):
            times += list(grid)
        if self.sampled:
            self.samples = [v["T_0"] % v["T_s"] + k * v["T_s"] for k in range(int(end / v["T_s"]) + 1)]
            times += self.samples + [time + v["T_d"] for time in self.samples]
        else:
            breaks = list(grid + v["T_set"]) + [0.0] + (list(grid) if len(self.load) else [])
            after = {0.0}
            for _ in range(4 if v["T_d"] > 0.0 else 0):
                after |= {time + delay for time in after for delay in self.delays}
            times += [time + later for time in breaks for later in after]
            if v["T_d"] > 0.0:
                times += list(np.arange(0.0, end, 0.9 * self.delays[0]))
        ordered = sorted(time for time in times if 0.0 <= time <= end)
        return [time for k, time in enumerate(ordered) if k == 0 or time - ordered[k - 1] > TINY]

    def late(self, output: str) -> float:
        return {
            "dn": self.v["T_n"],
            "dn_prop": self.v["T_n"],
            "dM_b": self.v["T_M"],
            "dM_g": self.v["T_M"],
        }.get(output, 0.0)

    def run(self, outputs: tuple[str, ...]) -> Array:
        v = self.v
        found = np.full((len(outputs), len(self.u)), np.nan)
        still = self.outputs_before(outputs)
        arrivals: list[tuple[float, float]] = []
        taken = 0
        stops = self.stops(outputs)
        k = -1
        while k + 1 < len(stops):
            k += 1
            stop = stops[k]
            rack = self.signals(stop, self.x, -1)[2] if stop > 0.0 else self.before
            if self.sampled and taken < len(self.samples) and stop > self.samples[taken] - TINY:
                arrivals.append((stop + v["T_d"], self.sample(stop)))
                taken += 1
            while arrivals and arrivals[0][0] < stop + TINY:
                self.held = arrivals.pop(0)[1]
            self.settle(stop, rack)
            for row, output in enumerate(outputs):
                place = (stop + self.late(output)) / self.dt
                if abs(place - round(place)) * self.dt < TINY and round(place) < len(self.u):
                    found[row, round(place)] = self.output(output, stop)
            if k + 1 < len(stops):
                self.advance(stop, stops[k + 1])
                for time in (
                    event + order * one for event in self.kinks for one in self.delays for order in (1, 2)
                ):
                    place = bisect.bisect(stops, time)
                    if place < len(stops) and stops[place - 1] < time - TINY and stops[place] > time + TINY:
                        stops.insert(place, time)
                self.kinks = []
        for row in range(len(outputs)):
            found[row, np.isnan(found[row])] = still[row]
        return found

    def outputs_before(self, outputs: tuple[str, ...]) -> list[float]:
        v, n = self.v, self.v["initial_N"]
        values = {
            "dn": n - 1.0,
            "dn_prop": n - 1.0,
            "dM_b": v["s_M"] * self.torque(n, self.before, v["g"] * (n - 1.0) + v["initial_F"]) - 1.0,
            "dM_g": v["s_M"] * self.resisting(n, 0.0, 1) - 1.0,
        }
        return [values.get(output, 0.0) for output in outputs]

    def output(self, output: str, t: float) -> float:
        v = self.v
        rate, _, rack, torque = self.signals(t, self.x, 1)
        flexible = v["tau_twist"] > 0.0
        gauge = (
            self.x[SPRING] + v["zeta_twist"] * (self.x[N] - self.x[P])
            if flexible
            else self.resisting(self.x[N], t, 1) + v["tau_prop"] * rate
        )
        return {
            "dn": self.x[N] - 1.0,
            "dn_prop": self.x[P if flexible else N] - 1.0,
            "dM_b": v["s_M"] * torque - 1.0,
            "dM_g": v["s_M"] * gauge - 1.0,
            "dX": rack,
            "dE": self.x[SUM],
        }[output]

    def sample(self, t: float) -> float:
        v = self.v
        error = v["s_u"] * self.at(self.u, t, v["T_set"], 1)[0] + v["u_0"] - self.seen(self.x)
        rate = self.signals(t, self.x, -1)[0]
        rate = (self.x[N] - self.x[SEEN]) / v["T_f"] if v["T_f"] else rate
        updated = self.x[SUM] + v["T_s"] * error

        def order(total: float, more: float = 0.0) -> float:
            asked = v["K_p"] * error + v["K_i"] * total - v["K_d"] * rate
            return asked / (1.0 + (v["K_p"] + v["K_i"] * more) * self.droop)

        command = order(updated, v["T_s"]) if v["update"] else order(self.x[SUM])
        updated -= v["T_s"] * self.droop * command
        above = 1 if error > 0.0 else -1
        if v["anti_windup"] and above * (command - self.ceiling(above, self.x[N])[0]) > 0.0:
            return order(self.x[SUM])
        self.x[SUM] = updated
        return command

    def settle(self, t: float, rack: float) -> None:
        """After a break: which limits hold."""
        v = self.v
        if self.follows:
            self.x[RACK], self.rate_side = rack, 1
            self.settle_sides(t)
            rise = self.clipped(self.signals(t, self.x, 1)[1]) - rack
            self.rate_side = 0 if abs(rise) < 1e-11 else int(np.sign(rise))
        if self.follows and self.rate_side == 0:
            slope = self.asked_slope(t, self.x, 1)
            self.rate_side = int(slope > v["rate_up"]) - int(slope < -v["rate_down"])
        self.settle_sides(t)
        if self.limited and v["tau_act"] > 0.0:
            wanted = (self.clipped(self.signals(t, self.x, 1)[1]) - self.x[RACK]) / v["tau_act"]
            self.rate_side = int(wanted > v["rate_up"]) - int(wanted < -v["rate_down"])
        if v["anti_windup"] and not self.sampled:
            self.change_sum(t, 1)

    def settle_sides(self, t: float) -> None:
        """Limits of the rack and the torque, unless a sliding sum keeps them."""
        v = self.v
        if self.sum_mode == "slides":
            on_ceiling = self.beyond(t, 1) < 1e-8
            self.sum_mode = self.sum_mode_at(t, 1)
            if on_ceiling:
                if self.sum_mode == "runs":
                    self.torque_side = self.rack_side = 0
                return
        self.torque_side = self.rack_side = 0
        for _ in range(3):
            _, asked, rack, _ = self.signals(t, self.x, 1)
            self.rack_side = int(asked > v["X_max"]) - int(asked < v["X_min"])
            rack = self.signals(t, self.x, 1)[2]
            n = self.x[N]
            raw = 1.0 + v["g"] * (n - 1.0) + v["v"] * rack
            self.torque_side = int(raw > self.torque_limit(1, n)) - int(raw < self.torque_limit(-1, n))

    def change_sum(self, t: float, side: int) -> None:
        """What the sum does from now on."""
        self.sum_mode = self.sum_mode_at(t, side)

    def asked_slope(self, t: float, x: Array, side: int) -> float:
        """How fast the actuator is asked to go; by differences within a smooth stretch."""
        if self.sampled or self.rack_side:
            return 0.0
        if self.v["T_d"] > 0.0:
            step = 1e-6
            first, last = (0.0, step) if side > 0 else (-step, step) if side == 0 else (-step, 0.0)
            return (
                (self.past(t + last, side) - self.past(t + first, side)) / step / (2.0 if side == 0 else 1.0)
            )
        rates = self.rates(t, x, side)
        slope = self.at(self.u, t, self.v["T_set"], side)[1]
        return float(self.v["K_p"] * (self.v["s_u"] * slope - rates[N]) + self.v["K_i"] * rates[SUM])

    def beyond(self, t: float, side: int) -> float:
        """Distance of the command from its nearer ceiling."""
        command = self.command(t, self.x, side, self.signals(t, self.x, side)[0])
        return min(abs(command - self.ceiling(above, self.x[N])[0]) for above in (1, -1))

    def sum_mode_at(self, t: float, side: int) -> str:
        v = self.v
        rate = self.signals(t, self.x, side)[0]
        set_point, slope = self.at(self.u, t, v["T_set"], side)
        error = v["s_u"] * set_point + v["u_0"] - self.x[N]
        above = 1 if error > 0.0 else -1
        ceiling, rise = self.ceiling(above, self.x[N])
        if not math.isfinite(ceiling):
            return "runs"
        beyond = above * (self.command(t, self.x, side, rate) - ceiling)
        if abs(beyond) > 1e-8:
            return "stands" if beyond > 0.0 else "runs"
        drift = above * (v["K_p"] * (v["s_u"] * slope - rate) - rise * rate)
        if drift > 0.0:
            return "stands"
        return "slides" if drift + v["K_i"] * abs(error) > 0.0 else "runs"

    def advance(self, start: float, end: float) -> None:
        """Integrate between two stops, cut at events."""
        v = self.v
        t, self.window = start, (start, end)
        for _ in range(50):
            functions = self.events(t)
            kept = self.mode
            solution = solve_ivp(
                self.rates, (t, end), self.x, "DOP853", rtol=3e-13, atol=1e-14, dense_output=True,
                events=functions or None,
            )  # fmt: skip
            t_new = float(solution.t[-1])
            if t_new > t or not self.pieces:
                self.starts.append(t)
                self.pieces.append((t, solution.sol, kept))
            self.x, t = solution.y[:, -1].copy(), t_new
            if solution.status != 1:
                return
            which = next(k for k, times in enumerate(solution.t_events) if len(times))
            if v["T_d"] > 0.0 and not self.sampled:
                self.kinks.append(t)
            functions[which].change(t)  # type: ignore[attr-defined]
        raise AssertionError("too many events")

    def events(self, start: float) -> list[Callable[[float, Array], float]]:
        """Functions whose zeros end a stretch: where a clip begins or ends, and where a memory changes."""
        v = self.v
        found: list[Callable[[float, Array], float]] = []

        def add(
            function: Callable[[float, Array], float], change: Callable[[float], None], way: int = 0
        ) -> None:
            seen = _away(function, start)
            seen.terminal, seen.direction, seen.change = True, way, change  # type: ignore[attr-defined]
            found.append(seen)

        def raw(t: float, x: Array) -> float:
            return 1.0 + v["g"] * (x[N] - 1.0) + v["v"] * self.signals(t, x, 0)[2]

        def turn(name: str, side: int) -> Callable[[float], None]:
            return lambda t: setattr(self, name, 0 if getattr(self, name) else side)

        def turn_rack(side: int, limit: float) -> Callable[[float], None]:
            def change(t: float) -> None:
                turn("rack_side", side)(t)
                if self.follows and self.rate_side == 0:  # a rack let go may have to follow at once
                    self.x[RACK] = limit
                    slope = self.asked_slope(t, self.x, 0)
                    self.rate_side = int(slope > v["rate_up"]) - int(slope < -v["rate_down"])

            return change

        direct = v["T_d"] == 0.0 and v["tau_act"] == 0.0 and self.rate_side == 0 and not self.sampled
        if self.sum_mode != "slides" or not direct:
            for side in (1, -1):
                # Where the sum's own event is at the same time, that one turns both.
                if v["anti_windup"] and direct:
                    continue
                limit = v["M_max"] if side > 0 else v["M_min"]
                if math.isfinite(limit) and self.torque_side != -side:
                    add(
                        lambda t, x, s=side: raw(t, x) - self.torque_limit(s, x[N]),
                        turn("torque_side", side),
                    )
                limit = v["X_max"] if side > 0 else v["X_min"]
                if math.isfinite(limit) and not self.sampled and self.rack_side != -side:
                    add(lambda t, x, m=limit: self.signals(t, x, 0)[1] - m, turn_rack(side, limit))
        self.rate_events(add, turn)
        if v["anti_windup"] and not self.sampled:
            self.sum_events(start, add)
        return found

    def rate_events(
        self, add: Callable[..., None], turn: Callable[[str, int], Callable[[float], None]]
    ) -> None:
        v = self.v

        def leave(t: float, side: int) -> None:
            self.x[RACK] = self.signals(t, self.x, 0)[2]
            self.rate_side = side

        def reach(t: float) -> None:
            self.rate_side = 0
            slope = self.asked_slope(t, self.x, 0)
            self.rate_side = int(slope > v["rate_up"]) - int(slope < -v["rate_down"])

        for side, rate in ((1, v["rate_up"]), (-1, -v["rate_down"])):
            if not self.limited or self.rate_side == -side or not math.isfinite(rate):
                continue
            if v["tau_act"] > 0.0:
                add(
                    lambda t, x, r=rate: (
                        (self.clipped(self.signals(t, x, 0)[1]) - x[RACK]) / v["tau_act"] - r
                    ),
                    turn("rate_side", side),
                )
            elif self.rate_side == 0:
                add(lambda t, x, r=rate: self.asked_slope(t, x, 0) - r, lambda t, s=side: leave(t, s), side)
            else:
                add(lambda t, x: self.clipped(self.signals(t, x, 0)[1]) - x[RACK], reach, -side)

    def sum_events(self, start: float, add: Callable[..., None]) -> None:
        v = self.v

        def turned(t: float) -> None:
            command = self.command(t, self.x, 0, self.signals(t, self.x, 0)[0])
            beyond = any(s * (command - self.ceiling(s, self.x[N])[0]) > 1e-8 for s in (1, -1))
            self.sum_mode = "stands" if beyond and self.sum_mode == "runs" else "runs"

        def cross(t: float, above: int) -> None:
            before = self.torque_side or self.rack_side
            self.change_sum(t, 0)
            direct = v["T_d"] == 0.0 and v["tau_act"] == 0.0 and self.rate_side == 0
            if direct:
                holds = above if self.sum_mode != "runs" or not before else 0
                by_torque = self.ceiling(above, self.x[N])[0] != (v["X_max"] if above > 0 else v["X_min"])
                self.torque_side, self.rack_side = (holds, 0) if by_torque else (0, holds)

        def runs(t: float) -> None:
            self.sum_mode = "runs"
            if v["T_d"] == 0.0 and v["tau_act"] == 0.0 and self.rate_side == 0:
                self.torque_side = self.rack_side = 0

        def error(t: float, x: Array) -> float:
            return v["s_u"] * self.at(self.u, t, v["T_set"], 0)[0] + v["u_0"] - x[N]

        if self.sum_mode == "slides":
            add(lambda t, x: self.rates(t, x, 0)[SUM], lambda t: setattr(self, "sum_mode", "stands"))
            add(lambda t, x: error(t, x) - self.rates(t, x, 0)[SUM], runs)
            return
        for above in (1, -1):
            if math.isfinite(self.ceiling(above, self.x[N])[0]):
                add(
                    lambda t, x, s=above: (
                        self.command(t, x, 0, self.signals(t, x, 0)[0]) - self.ceiling(s, x[N])[0]
                    ),
                    lambda t, s=above: cross(t, s),
                )
        add(error, turned)


def _away(function: Callable[[float, Array], float], start: float) -> Callable[[float, Array], float]:
    """The same function, but nothing to be seen at the start where it is zero: that zero is left behind."""

    def seen(t: float, x: Array) -> float:
        value = function(t, x)
        return math.nan if t <= start and abs(value) < 1e-9 else value

    return seen


def _fixed(function: Callable[[float], float], guess: float) -> float:
    """Zero of a piecewise linear falling function."""
    for _ in range(60):
        here = function(guess)
        slope = (function(guess + 1e-3) - here) / 1e-3
        if abs(here) < 1e-15 or slope == 0.0:
            break
        guess -= here / slope
    return guess
