"""NumPy reference of the whole drive train: every element as it stands, steps of RK4 cut where a signal breaks."""

import math
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from shipfp_rs._core import DRIVE_TRAIN_PARAMETERS
from shipfp_rs.vessel.drive_train import OFF
from tests.twins.vectors import vectors

from .plant import LAUNCH, N_E

Array = NDArray[np.float64]
STATES = ["engine", "propeller", "twist", "crank", "turn", "rack", "charge", "error", "filtered", "ship"]
NO_QUADRANTS = np.empty((3, 0))

DEFAULTS = {
    **LAUNCH,
    **OFF,
    "propeller_inertia": 2.81,
    "drag_exponent": 1.0,
    "derivative_filter": 0.05,
    "turbocharger_lag": 1.0,
    "firing_width": 0.5,
    "blades": 3.0,
    "blade_path": 0.7 * math.pi * 0.77,
    "inflow": 1.0,
    "thrust_coefficient": 144.0,
    "ship_resistance": 500.0,
    "initial_speed": N_E / 3.0,
    "initial_error": 0.0,
    "initial_ship_speed": 0.0,
    "set_point_before": N_E,
    "crank_angle": 0.0,
}
"""Stan Launch 804, everything that can be added to the plant off."""


vector = vectors(DEFAULTS, DRIVE_TRAIN_PARAMETERS)
"""Parameters of the launch, some of them changed."""


def simulate(
    parameters: Array,
    limit_speed: Array,
    limit_torque: Array,
    strength: Array,
    quadrants: Array,
    n_set: Array,
    dt: float,
    substeps: int,
    hold: str,
) -> Array:
    """Rows n_e, n_s, M_b, M_g, M_s, X_f, E_n, ship speed."""
    values = dict(zip(DRIVE_TRAIN_PARAMETERS, parameters.tolist(), strict=True))
    run = SimpleNamespace(n_set=n_set, dt=dt, substeps=substeps, hold=hold, step=dt / substeps)
    return _Run(values, (limit_speed, limit_torque), strength, quadrants, run).rows()


class _Run:
    def __init__(self, q, envelope, strength, quadrants, run):
        self.q, self.envelope, self.strength, self.quadrants, self.run = q, envelope, strength, quadrants, run
        n_s = q["initial_speed"]
        n_e = n_s * q["gear_ratio"]
        rack = q["X_0"] + q["Kp_abs"] * (q["set_point_before"] - n_e) + q["Ki_abs"] * q["initial_error"]
        load, _ = self.propeller(n_s, q["initial_ship_speed"])
        twist = load / (2 * np.pi * q["shaft_stiffness"])
        start = [n_s, n_s, twist, q["crank_angle"], 0.0, rack, rack, q["initial_error"], n_e]
        self.x = np.array([*start, q["initial_ship_speed"]])
        self.held, self.rack = rack, rack
        self.torque = q["A1"] * rack + q["A2"] * n_e + q["A3"]
        self.fuelled, self.fired = self.torque * strength, -1
        self.integrated, self.filtered, self.miss = q["initial_error"], n_e, q["set_point_before"] - n_e
        self.sampled_at, self.samples = 0.0, 0
        self.past = [(-1e300, rack), (0.0, rack)]
        self.breaks = [q["fuel_dead_time"]]

    def set_speed(self, time, side):
        """Set point behind its dead time; `side` of a break: just before, at, just after."""
        run, late = self.run, time - self.q["set_dead_time"]
        piece = math.floor((late + side * 1e-6 * run.step) / run.dt)
        if piece < 0:
            return self.q["set_point_before"]
        if piece >= len(run.n_set) - 1:
            return run.n_set[-1]
        slope = run.n_set[piece + 1] - run.n_set[piece] if run.hold == "first" else 0.0
        return run.n_set[piece] + slope * (late / run.dt - piece)

    def arriving(self, time, side):
        """Command of the governor behind the actuator's dead time."""
        late = time - self.q["fuel_dead_time"]
        after = next((i for i, p in enumerate(self.past) if late + side * 1e-6 * self.run.step < p[0]), None)
        if after is None:
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

    def command(self, miss, integrated, lead, filter_s, highest):
        """Rack that the governor orders, and whether its integral may go on."""
        q = self.q
        X = q["X_0"] + q["Kp_abs"] * miss + q["Ki_abs"] * integrated
        if q["Kd_abs"]:
            X -= q["Kd_abs"] * lead / filter_s
        above = min(highest) < X and miss > 0
        below = q["minimum_rack"] > X and miss < 0
        return max(min(X, highest[0]), q["minimum_rack"]), not (q["anti_windup"] and (above or below))

    def sample(self, time):
        q, n_e = self.q, self.q["gear_ratio"] * self.x[0]
        elapsed, miss, lead = time - self.sampled_at, self.set_speed(time, 1) - n_e, n_e - self.filtered
        filter_s, highest = q["derivative_filter"] + elapsed, self.limits(n_e, self.x[6])
        integrated = self.integrated + elapsed * (miss + self.miss) / 2
        rack, free = self.command(miss, integrated, lead, filter_s, highest)
        if free:
            self.integrated = integrated
        else:
            rack, _ = self.command(miss, self.integrated, lead, filter_s, highest)
        if q["Kd_abs"]:
            self.filtered += elapsed / filter_s * lead
        self.held, self.miss, self.sampled_at, self.x[7] = rack, miss, time, self.integrated
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
            command, free = self.command(miss, s["error"], lead, q["derivative_filter"], highest)
            rates["error"] = miss if free else 0.0
            rates["filtered"] = lead / q["derivative_filter"] if q["Kd_abs"] else 0.0
        fuel = self.arriving(time, side) if q["fuel_dead_time"] else command
        rack = _within(self.rack, fuel, q["rack_rate"], elapsed)
        if q["fuel_lag"]:
            rates["rack"] = (rack - s["rack"]) / q["fuel_lag"]
            rack = s["rack"]
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
            fuel=fuel,
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
        self.rack = _within(self.rack, end.fuel, self.q["rack_rate"], h)
        self.torque = _within(self.torque, end.demand, self.q["torque_rate"], h)
        self.past.append((time + h, end.command))
        since = (time + h - self.q["set_dead_time"]) / self.run.dt
        if abs(since - round(since)) * self.run.dt < 1e-8 * self.run.step:
            self.breaks.append(time + h + self.q["fuel_dead_time"])

    def next_cut(self, time, begin):
        """The next time at which a step must end."""
        q, soon = self.q, time + 1e-8 * self.run.step
        cuts = [at for at in self.breaks if at > soon] if q["fuel_dead_time"] else []
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
