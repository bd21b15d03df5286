"""NumPy reference of the whole drive train: every element as it stands, steps of RK4 cut where a signal breaks."""

import bisect
import math
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from shipfp_rs._core import SHIP_DETAIL
from shipfp_rs.signals import Excitation
from shipfp_rs.vessel.drive_train import drive_train
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel
from tests.twins.plant import vectors

Array = NDArray[np.float64]
OFF = dict.fromkeys(SHIP_DETAIL, 0.0) | {
    "T_f": 0.05,
    "tau_air": 1.0,
    "margin": math.inf,
    "torque_rate": math.inf,
}
STANDING = {
    "width": 0.5,
    "engine_hz": 20.0,
    "shaft_hz": 5.0,
    "blades": 3.0,
    "drag_exponent": 1.0,
    "bollard": 1.0,
}
detail = vectors(OFF | STANDING, SHIP_DETAIL)
"""Detail of a ship, some of it changed from doing nothing."""
STATES = ["engine", "propeller", "twist", "crank", "turn", "rack", "charge", "error", "filtered", "ship"]


def simulate(vessel: Vessel, excitation: Excitation, substeps: int) -> dict[str, Array]:
    """Signals by name, in the units of an experiment, and the ship's speed."""
    point, train = steady_state(vessel), drive_train(vessel)
    values = train.values | {
        "X_0": point.X_f,
        "initial_speed": point.n_s,
        "initial_ship_speed": point.ship_speed,
    }
    n_set, dt = point.n_e + excitation.samples / 60.0, 1.0 / excitation.rate_hz
    run = SimpleNamespace(n_set=n_set, dt=dt, substeps=substeps, hold=excitation.hold, step=dt / substeps)
    rows = _Run(values, vessel.envelope(), train.strength, train.quadrants, run).rows()
    found = dict(zip(("n_e", "n_s", "M_b", "M_g", "M_s", "X_f", "E_n", "ship"), rows, strict=True))
    return {**found, "n_e": 60.0 * found["n_e"]}


class _Run:
    def __init__(self, q, envelope, strength, quadrants, run):
        self.q, self.envelope, self.strength, self.quadrants, self.run = q, envelope, strength, quadrants, run
        n_s = q["initial_speed"]
        n_e = n_s * q["gear_ratio"]
        rack = q["X_0"]
        load, _ = self.propeller(n_s, q["initial_ship_speed"])
        twist = load / (2 * np.pi * q["shaft_stiffness"])
        start = [n_s, n_s, twist, 0.0, 0.0, rack, rack, 0.0, n_e]
        self.x = np.array([*start, q["initial_ship_speed"]])
        self.held, self.rack = rack, rack
        self.torque = q["A1"] * rack + q["A2"] * n_e + q["A3"]
        self.fuelled, self.fired = self.torque * strength, -1
        self.filtered, self.samples = n_e, 0
        period = q["governor_period"]
        self.period = q["firing_interval"] / n_e if math.isinf(period) else period
        self.sampled = None
        self.past = [(-1e300, rack), (0.0, rack)]
        self.breaks = [q["fuel_dead_time"]]

    def set_speed(self, time, side):
        """Set point behind its dead time; `side` of a break: just before, at, just after."""
        run, late = self.run, time - self.q["set_dead_time"]
        piece = math.floor((late + side * 1e-6 * run.step) / run.dt)
        if piece < 0:
            return self.q["initial_speed"] * self.q["gear_ratio"]
        if piece >= len(run.n_set) - 1:
            return run.n_set[-1]
        slope = run.n_set[piece + 1] - run.n_set[piece] if run.hold == "first" else 0.0
        return run.n_set[piece] + slope * (late / run.dt - piece)

    def arriving(self, time, side):
        """Command of the governor behind the actuator's dead time."""
        late = time - self.q["fuel_dead_time"]
        after = bisect.bisect_right(self.past, late + side * 1e-6 * self.run.step, key=lambda entry: entry[0])
        if after == len(self.past):
            return self.past[-1][1]
        (t0, v0), (t1, v1) = self.past[after - 1], self.past[after]
        return v0 + (v1 - v0) * (late - t0) / (t1 - t0)

    def limits(self, n_e, charge):
        """Highest rack, and the rack at which the engine meets its envelope."""
        q = self.q
        rack = min(charge + q["smoke_margin"], q["maximum_rack"])
        if not q["anti_windup"]:
            return rack, math.inf
        return rack, (self.envelope_torque(n_e) - q["A2"] * n_e - q["A3"]) / q["A1"]

    def envelope_torque(self, n_e):
        return float(np.interp(n_e, *self.envelope)) if self.envelope[0].size else math.inf

    def command(self, miss, integrated, pace, highest):
        """Rack that the governor orders at a rate of the filtered speed, and whether its integral may go on."""
        q = self.q
        X = q["X_0"] + q["Kp_abs"] * miss + q["Ki_abs"] * integrated
        if q["Kd_abs"]:
            X -= q["Kd_abs"] * pace
        above = min(highest) < X and miss > 0
        below = q["minimum_rack"] > X and miss < 0
        return X, not (q["anti_windup"] and (above or below))

    def sample(self, time):
        q, n_e = self.q, self.q["gear_ratio"] * self.x[0]
        miss, lead = self.set_speed(time, 1) - n_e, n_e - self.filtered
        # Between firings as much time goes by as the engine takes.
        at_firings = math.isinf(q["governor_period"]) and self.sampled is not None
        elapsed = time - self.sampled if at_firings else self.period
        self.sampled = time
        pace = lead / (q["derivative_filter"] + elapsed)
        self.filtered += elapsed * pace
        highest, integrated = self.limits(n_e, self.x[6]), self.x[7] + elapsed * miss
        # By trapezoids: half of the last error's share is yet to come.
        half = self.period * miss / 2
        self.held, free = self.command(miss, integrated - half, pace, highest)
        if free:
            self.x[7] = integrated
        else:
            self.held, _ = self.command(miss, self.x[7] - half, pace, highest)
        self.breaks.append(time + q["fuel_dead_time"])

    def propeller(self, n_s, speed):
        q, p = self.q, self.q["torque_exponent"]
        if not self.quadrants.size:
            torque = q["torque_coefficient"] * math.copysign(abs(n_s) ** p, n_s)
            return torque, q["thrust_coefficient"] * n_s * abs(n_s)
        along, across = q["blade_path"] * n_s, q["inflow"] * speed
        flow, at = math.hypot(along, across) / q["blade_path"], math.atan2(across, along)
        C_Q, C_T = (float(np.interp(at, self.quadrants[0], row)) for row in self.quadrants[1:])
        return C_Q * q["torque_coefficient"] * flow**p, C_T * q["thrust_coefficient"] * flow**2

    def firing_torque(self, crank):
        """Sum of the raised cosines of the cylinders that work."""
        q, cylinders, total = self.q, len(self.strength), 0.0
        for firing in range(self.fired, self.fired - cylinders, -1):
            age = crank - firing * q["firing_interval"]
            if age < q["firing_width"]:
                share = q["firing_interval"] / q["firing_width"]
                share *= 1 - math.cos(2 * np.pi * age / q["firing_width"])
                total += share * self.fuelled[firing % cylinders]
        return total

    def due(self):
        interval = self.q["firing_interval"]
        return interval and (self.fired + 1) * interval - self.x[3] <= 1e-6

    def flow(self, time, elapsed, side, x):
        """Signals and rates at a state."""
        q = self.q
        s = dict(zip(STATES, x, strict=True))
        n_e = q["gear_ratio"] * s["engine"]
        rates = dict.fromkeys(STATES, 0.0)
        if q["governor_period"]:
            command = self.held
        else:
            miss, lead = self.set_speed(time, side) - n_e, n_e - s["filtered"]
            highest = self.limits(n_e, s["charge"])
            command, free = self.command(miss, s["error"], lead / q["derivative_filter"], highest)
            rates["error"] = miss if free else 0.0
            rates["filtered"] = lead / q["derivative_filter"] if q["Kd_abs"] else 0.0
        fuel = self.arriving(time, side) if q["fuel_dead_time"] else command
        if q["fuel_lag"]:
            rates["rack"] = np.clip((fuel - s["rack"]) / q["fuel_lag"], -q["rack_rate"], q["rack_rate"])
            rack = s["rack"]
        else:
            rack = _within(self.rack, fuel, q["rack_rate"], elapsed)
        rack = max(min(rack, self.limits(n_e, s["charge"])[0]), q["minimum_rack"])
        if math.isfinite(q["smoke_margin"]):
            rates["charge"] = (rack - s["charge"]) / q["turbocharger_lag"]
        demand = min(q["A1"] * rack + q["A2"] * n_e + q["A3"], self.envelope_torque(n_e))
        demand = max(demand, q["minimum_torque"])
        mean = _within(self.torque, demand, q["torque_rate"], elapsed)
        M_b = self.firing_torque(s["crank"]) if q["firing_interval"] else mean
        M_s = M_b * q["gear_ratio"] * q["transmission_efficiency"]
        if q["drag_coefficient"]:
            M_s -= q["drag_coefficient"] * math.copysign(abs(s["engine"]) ** q["drag_exponent"], s["engine"])
        load, thrust = self.propeller(s["propeller"], s["ship"])
        for amplitude, order in ((q["shaft_ripple"], 1), (q["blade_ripple"], q["blades"])):
            load += (
                self.propeller(s["propeller"], s["ship"])[0]
                * amplitude
                * math.cos(2 * np.pi * order * s["turn"])
            )
        slip, J, J_2 = s["engine"] - s["propeller"], q["inertia"], q["propeller_inertia"]
        if math.isfinite(q["shaft_stiffness"]):
            M_g = 2 * np.pi * (q["shaft_stiffness"] * s["twist"] + q["shaft_damping"] * slip)
            rates["engine"] = (M_s - M_g) / (2 * np.pi * (J - J_2))
            rates["propeller"] = (M_g - load) / (2 * np.pi * J_2)
        else:
            rates["engine"] = rates["propeller"] = (M_s - load) / (2 * np.pi * J)
            M_g = load + 2 * np.pi * J_2 * rates["propeller"]
        rates |= {"twist": slip, "crank": n_e, "turn": s["propeller"]}
        rates["ship"] = (thrust - q["ship_resistance"] * s["ship"] * abs(s["ship"])) / q["ship_mass"]
        row = [n_e, s["propeller"], M_b, M_g, M_s, rack, s["error"], s["ship"]]
        return SimpleNamespace(
            rates=np.array(list(rates.values())),
            row=row,
            command=command,
            rack=rack,
            demand=demand,
            mean=mean,
        )

    def begin(self, time):
        """What is due at a time is done; return the signals after it."""
        period, step = self.q["governor_period"], self.run.step
        fires = self.due()
        if math.isinf(period):
            if fires:
                self.sample(time)
        elif period and time >= self.samples * period - 1e-8 * step:
            self.samples += 1
            self.sample(time)
        flow = self.flow(time, 0.0, 1, self.x)
        while self.due():
            self.fired += 1
            cylinder = self.fired % len(self.strength)
            self.fuelled[cylinder] = flow.mean * self.strength[cylinder]
        flow = self.flow(time, 0.0, 1, self.x)
        self.past.append((time, flow.command))
        return flow

    def advance(self, time, h, begin):
        """One step of the classical Runge-Kutta method."""
        x = self.x
        k1 = begin.rates
        k2 = self.flow(time + h / 2, h / 2, 0, x + h / 2 * k1).rates
        k3 = self.flow(time + h / 2, h / 2, 0, x + h / 2 * k2).rates
        k4 = self.flow(time + h, h, -1, x + h * k3).rates
        self.x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        end = self.flow(time + h, h, -1, self.x)
        self.rack = self.x[5] = end.rack
        self.torque = _within(self.torque, end.demand, self.q["torque_rate"], h)
        self.past.append((time + h, end.command))
        since = (time + h - self.q["set_dead_time"]) / self.run.dt
        if abs(since - round(since)) * self.run.dt < 1e-8 * self.run.step:
            self.breaks.append(time + h + self.q["fuel_dead_time"])

    def next_cut(self, time, begin):
        """The next time at which a step must end."""
        q, soon = self.q, time + 1e-8 * self.run.step
        self.breaks = [at for at in self.breaks if at > soon] if q["fuel_dead_time"] else []
        cuts = list(self.breaks)
        if 0.0 < q["governor_period"] < math.inf:
            cuts.append(self.samples * q["governor_period"])
        if q["set_dead_time"]:
            late = math.floor((soon - q["set_dead_time"]) / self.run.dt)
            cuts.append((max(late, -1) + 1) * self.run.dt + q["set_dead_time"])
        if q["firing_interval"]:
            cuts.append(self.next_firing(time, begin))
        return min((cut for cut in cuts if cut > soon), default=math.inf)

    def next_firing(self, time, begin):
        """When the crank reaches the next firing at the present speed and acceleration."""
        speed, acceleration = begin.rates[3], self.q["gear_ratio"] * begin.rates[0]
        wait = ((self.fired + 1) * self.q["firing_interval"] - self.x[3]) / speed
        if not 0.0 < wait < 2.0 * self.run.step:
            return math.inf
        return time + wait / (1.0 + 0.5 * acceleration * wait / speed)

    def rows(self):
        run, rows = self.run, []
        for k in range(len(run.n_set)):
            time = k * run.dt
            flow = self.begin(time)
            rows.append(flow.row)
            if k + 1 == len(run.n_set):
                break
            for j in range(1, run.substeps + 1):
                border = (k + j / run.substeps) * run.dt
                while time < border:
                    flow = flow or self.begin(time)
                    end = min(self.next_cut(time, flow), border)
                    end = border if border - end < 1e-8 * run.step else end
                    self.advance(time, end - time, flow)
                    time, flow = end, None
        return np.array(rows).T


def _within(value, demand, rate, elapsed):
    """What of a demand is reached from a value at a rate."""
    if math.isinf(rate):
        return demand
    return min(max(demand, value - rate * elapsed), value + rate * elapsed)
