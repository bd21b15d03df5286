"""Transfer functions of the drive train about its operating point: eq. 3.14 to 3.54, lags, sampling, flexible shaft."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

Place = Literal["engine", "propeller"]
Spectrum = npt.NDArray[Any]
Part = Spectrum | float

DERIVATIVE_FILTER = 0.1
"""Time constant of the derivative's filter over the derivative time K_d / K_p, a customary value
(Astrom, Hagglund, "Advanced PID Control", 2006, section 3.3)."""
SLOWEST = 1e-6
"""Frequency used for zero, where an integrator has a pole [rad/s]."""
GAINS = ("K_p", "K_i", "K_d")


@dataclass(frozen=True)
class TransferFunctions:
    """Transfer functions from the set point to the outputs; an element acts if its parameters are given.

    The governor is C = (K_p + K_i/s + K_d s/(1 + 0.1 K_d/K_p s)) / (1 + T_f s); on the set point K_p + K_i/s alone act.
    The path to the rack is A = exp(-s T_d) / (1 + tau_act s), times (1 - exp(-s T_s)) / (s T_s) for a governor that
    samples every T_s and holds. The loop is L = v C A. The propeller's torque is M_g* = (p + tau_prop s) n_s*.
    The shaft twists by n_e* = (1 + Y (p + tau_prop s)) n_s*, with Y = tau_twist s / (1 + zeta_twist tau_twist s) and
    tau_twist = M_s0 / (2 pi n_s0 k) for a stiffness k [Nm/rad]. The governor acts on the engine's side, where
    (tau_n - tau_prop) s n_e* = (g - L) n_e* + v (K_p + K_i/s) A n_set* - M_g*.
    Without these elements: eq. 3.31 and 3.38.
    """

    outputs: tuple[str, ...]
    gauge: bool
    speed: Place
    """Side of the shaft on which the speed is measured."""

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) to the set point, and its derivatives by `names`, shape (W, O, F)."""
        s = 1j * np.maximum(2.0 * np.pi * frequency_hz, SLOWEST)
        loop = _Loop.of(values, s)
        v, C, A, W = loop.v, loop.governor, loop.path, loop.twisted
        delay = np.exp(-s * values.get("T_set", 0.0))
        command = loop.asked * delay
        engine_side = loop.engine + v * C * A
        closed = engine_side * W + loop.propeller
        n_s = v * A * command / closed
        n_e = W * n_s
        rack = A * (command - C * n_e)

        slopes = np.empty((len(names), len(self.outputs), len(s)), dtype=np.complex128)
        for slope, name in zip(slopes, names, strict=True):
            d = loop.change(name)
            dcommand = d.asked * delay - (name == "T_set") * s * command
            dengine_side = d.engine + d.v * C * A + v * (d.governor * A + C * d.path)
            dclosed = dengine_side * W + engine_side * d.twisted + d.propeller
            dn_s = ((d.v * A + v * d.path) * command + v * A * dcommand - n_s * dclosed) / closed
            dn_e = d.twisted * n_s + W * dn_s
            drack = d.path * (command - C * n_e) + A * (dcommand - d.governor * n_e - C * dn_e)
            dM_b = d.g * n_e + loop.g * dn_e + d.v * rack + v * drack
            dM_g = d.propeller * n_s + loop.propeller * dn_s
            slope[:] = self._measured(dn_e, dn_s, dM_b, dM_g, drack)
        return self._measured(n_e, n_s, loop.g * n_e + v * rack, loop.propeller * n_s, rack), slopes

    def _measured(self, n_e: Spectrum, n_s: Spectrum, M_b: Spectrum, M_g: Spectrum, X: Spectrum) -> Spectrum:
        rows = {
            "dn": n_e if self.speed == "engine" else n_s,
            "dM": M_g if self.gauge else M_b,
            "dM_b": M_b,
            "dX": X,
        }
        return np.array([rows[output] for output in self.outputs])

    def answer_to_torque(self, values: Values, s: Spectrum) -> ComplexArray:
        """Return the response (O, F) of the outputs to an engine torque that the governor did not command."""
        loop = _Loop.of(values, s)
        fuel = loop.v * loop.governor * loop.path
        n_s = np.asarray(1.0 / ((loop.engine + fuel) * loop.twisted + loop.propeller))
        n_e, M_g = np.asarray(loop.twisted * n_s), np.asarray(loop.propeller * n_s)
        M_b = np.asarray((loop.engine + loop.g) * n_e + M_g)
        return self._measured(n_e, n_s, M_b, M_g, np.asarray(-loop.governor * loop.path * n_e))

    def torque_over_speed(self, values: Values, s: Spectrum, names: Names) -> tuple[Spectrum, ComplexArray]:
        """Return the torque over the speed (F,) that a load disturbance causes, and its derivatives by `names`, (W, F).

        The engine's side alone decides this ratio: M_g = -((tau_n - tau_prop) s - g + L) n_e, M_b = (g - L) n_e.
        """
        loop = _Loop.of(values, s)
        fuel = loop.v * loop.governor * loop.path
        slip = np.asarray(_yield(values, s) if self.speed == "propeller" else 0.0 * s)
        side = loop.engine + fuel
        seen, under = side if self.gauge else fuel - loop.g, 1.0 + slip * side
        slopes = np.zeros((len(names), len(s)), dtype=np.complex128)
        for slope, name in zip(slopes, names, strict=True):
            d = loop.change(name)
            dfuel = d.v * loop.governor * loop.path + loop.v * (
                d.governor * loop.path + loop.governor * d.path
            )
            dside, dslip = d.engine + dfuel, np.asarray(0.0 * s)
            if self.speed == "propeller" and name in ("tau_twist", "zeta_twist"):
                dslip = np.asarray(d.twisted / loop.propeller)
            dunder = dslip * side + slip * dside
            slope[:] = (seen * dunder / under - (dside if self.gauge else dfuel - d.g)) / under
        return np.asarray(-seen / under), slopes

    def return_difference(self, values: Values, s: Spectrum) -> Spectrum:
        """Return 1 + L n_e*/M_b* (F,)."""
        loop = _Loop.of(values, s)
        turned = 1.0 + loop.v * loop.governor * loop.path * loop.twisted / (
            loop.engine * loop.twisted + loop.propeller
        )
        return np.asarray(turned)

    def characteristic(self, values: Values, s: Spectrum) -> Spectrum:
        """Return the characteristic function (F,) at s: its zeros are the closed loop's poles, its pole the actuator's."""
        loop = _Loop.of(values, s)
        shaft = loop.engine * loop.twisted + loop.propeller
        return np.asarray(s * (shaft + loop.v * loop.governor * loop.path * loop.twisted))


@dataclass(frozen=True)
class _Part:
    """Terms of governor, path to the rack and shaft, or their derivatives by a parameter, each (F,)."""

    v: Part = 0.0
    """Rack to torque, the engine's lag included."""
    g: Part = 0.0
    integral: float = 0.0
    governor: Part = 0.0
    asked: Part = 0.0
    """Governor's response to the set point, without derivative and filter, which act only on the speed."""
    path: Part = 0.0
    propeller: Part = 0.0
    twisted: Part = 0.0
    """Engine speed over propeller speed."""
    engine: Part = 0.0
    """Torque on the engine's side without fuel, divided by its speed."""


@dataclass(frozen=True)
class _Loop(_Part):
    """Terms of the loop, and the values from which their derivatives are computed."""

    q: Values = field(default_factory=dict)
    s: Spectrum = field(default_factory=lambda: np.empty(0, dtype=np.complex128))

    @classmethod
    def of(cls, q: Values, s: Spectrum) -> _Loop:
        gains = [q.get(f"v{name}", q.get(name, 0.0)) for name in GAINS]
        proportional, integral, derivative = gains
        asked = proportional + integral / s
        governor = asked
        if derivative:
            governor = asked + derivative * s / (1.0 + DERIVATIVE_FILTER * derivative / proportional * s)
        governor = governor / (1.0 + q.get("T_f", 0.0) * s)
        path = np.exp(-s * q.get("T_d", 0.0)) / (1.0 + q.get("tau_act", 0.0) * s)
        if q.get("T_s"):
            path = path * -np.expm1(-s * q["T_s"]) / (s * q["T_s"])
        propeller = q["p"] + q.get("tau_prop", 0.0) * s
        twisted = 1.0 + _yield(q, s) * propeller
        charged = 1.0 / (1.0 + q.get("tau_eng", 0.0) * s)
        v, g = q.get("v", 1.0) * charged, q["g"] * charged
        engine = (q["tau_n"] - q.get("tau_prop", 0.0)) * s - g
        return cls(v, g, integral, governor, asked, path, propeller, twisted, engine, q, s)

    def change(self, name: str) -> _Part:
        """Return the derivatives of the terms by a parameter."""
        q, s = self.q, self.s
        if name.removeprefix("v") in GAINS:
            return self._change_of_governor(name.removeprefix("v"))
        if name == "T_f":
            return _Part(governor=-s / (1.0 + q.get("T_f", 0.0) * s) * self.governor)
        if name in ("T_d", "tau_act", "T_s"):
            return _Part(path=self.path * self._relative_change_of_path(name))
        propeller = {"p": 1.0 + 0.0 * s, "tau_prop": s}.get(name, 0.0 * s)
        twisted = _yield(q, s) * propeller
        if name == "tau_twist":
            twisted = s * self.propeller / (1.0 + q.get("zeta_twist", 0.0) * q[name] * s) ** 2
        elif name == "zeta_twist":
            twisted = -(_yield(q, s) ** 2) * self.propeller
        inertia = {"tau_n": 1.0, "tau_prop": -1.0}.get(name, 0.0)
        charged = 1.0 / (1.0 + q.get("tau_eng", 0.0) * s)
        v, g = charged * (name == "v"), charged * (name == "g")
        if name == "tau_eng":
            v, g = -s * charged * self.v, -s * charged * self.g
        return _Part(v=v, g=g, propeller=propeller, twisted=twisted, engine=inertia * s - g)

    def _relative_change_of_path(self, name: str) -> Spectrum:
        q, s = self.q, self.s
        if name == "T_d":
            return -s
        if name == "tau_act":
            return np.asarray(-s / (1.0 + q["tau_act"] * s))
        if not q["T_s"]:
            return -0.5 * s
        return np.asarray(s / np.expm1(s * q["T_s"]) - 1.0 / q["T_s"])

    def _change_of_governor(self, gain: str) -> _Part:
        proportional, derivative = (self.q.get(f"v{name}", self.q.get(name, 0.0)) for name in ("K_p", "K_d"))
        seen = 1.0 / (1.0 + self.q.get("T_f", 0.0) * self.s)
        if gain == "K_i":
            return _Part(integral=1.0, governor=seen / self.s, asked=1.0 / self.s)
        lag = DERIVATIVE_FILTER * derivative / proportional
        filtered = self.s / (1.0 + lag * self.s)
        if gain == "K_d":
            return _Part(governor=seen * filtered * (1.0 - lag * filtered))
        return _Part(governor=seen * (1.0 + derivative * lag / proportional * filtered**2), asked=1.0)


def _yield(q: Values, s: Spectrum) -> Part:
    """Speed difference across the flexible shaft, divided by its torque."""
    twist = q.get("tau_twist", 0.0) * s
    return twist / (1.0 + q.get("zeta_twist", 0.0) * twist)
