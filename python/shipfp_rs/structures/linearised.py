"""Linearisation of the drive train: open loop with exact dead times, and state space with approximated dead times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb, factorial

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.transfer import DERIVATIVE_FILTER, Place, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray, Values

Form = Array
"""Signal as a linear combination: coefficients of the states, then of the input."""

KINDS = ("linear", "ship")
"""Kinds of structures that can be linearised."""
MOST_STATES = 64
LEAST_S = 1e-6
"""Delays below this are none [s]: their poles would be too fast for double precision."""


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u, y = C x + D u, with u the set point and y the outputs in their order."""

    A: Array
    B: Array
    C: Array
    D: Array
    outputs: tuple[str, ...]

    def response(self, frequency_hz: npt.ArrayLike) -> ComplexArray:
        """Return the response (O, F) at frequencies (F,) [Hz]."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
        states = np.linalg.solve(s[:, None, None] * np.eye(len(self.A)) - self.A, self.B[:, None])[..., 0]
        return np.asarray(self.C @ states.T + self.D[:, None], dtype=np.complex128)

    def step(self, times: Array) -> Array:
        """Return the outputs (O, N) after a step of the input at time 0, at times (N,) [s]."""
        poles, modes = np.linalg.eig(self.A)
        parts = np.linalg.solve(modes, self.B)
        grown = np.expm1(np.outer(poles, times)) * (parts / poles)[:, None]
        return np.asarray((self.C @ modes @ grown).real + self.D[:, None])


def require_linear(structure: Structure) -> None:
    """Raise `InputError` for a structure that can't be linearised as a drive train."""
    if structure.settings.get("kind") not in KINDS:
        raise InputError(
            f"structure {structure.name!r} of the fingerprint is not linear, expected one of kind {', '.join(KINDS)}; "
            "other kinds have no poles"
        )


def loop_of(structure: Structure, values: Values) -> tuple[TransferFunctions, dict[str, float]]:
    """Return a structure's transfer functions about its operating point, and their parameter values."""
    require_linear(structure)
    place: Place = "engine"
    if structure.settings.get("propeller_speed"):
        place = "propeller"
    known = structure.complete(values)
    known["p"] = known["p"] + known.pop("damping", 0.0)
    if structure.settings.get("mean_sampling"):
        known["T_d"] = known.get("T_d", 0.0) - 0.5 * known.get("T_s", 0.0)
    return TransferFunctions(structure.outputs, "tau_prop" in structure.names, place), known


def open_loop(structure: Structure, values: Values, frequency_hz: npt.ArrayLike) -> ComplexArray:
    """Return the open-loop response L (F,) with exact dead times: minus the ratio of returned to injected signal."""
    equations, known = loop_of(structure, values)
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    return np.asarray(equations.return_difference(known, s) - 1.0)


def state_space(
    structure: Structure,
    values: Values,
    order: int = 3,
) -> StateSpace:
    """Return the linearisation as a state space from the set point to the outputs.

    Parameters
    ----------
    structure
        A linear structure or the ship.
    values
        Parameters by name.
    order
        Order of each dead time's Pade approximation; a sampling governor is a delay of half its period.

    Raises
    ------
    InputError
        For another kind of structure.

    Notes
    -----
    With a stiff shaft tau_n dn/dt = M_b - p n and M_g = p n + tau_prop dn/dt. With a flexible shaft, the engine's side
    is (tau_n - tau_prop) dn_e/dt = M_b - M_g, the shaft M_g = M_k + zeta_twist (n_e - n_s) with
    tau_twist dM_k/dt = n_e - n_s, and the propeller's side tau_prop dn_s/dt = M_g - p n_s.
    """
    equations, q = loop_of(structure, values)
    wiring = _Wiring(order)
    set_point = wiring.delayed(wiring.input, q.get("T_set", 0.0))
    n_e, error = wiring.state(), wiring.state()
    v = q.get("v", 1.0)
    gains = {name: q.get(f"v{name}", v * q.get(name, 0.0)) for name in ("K_p", "K_i", "K_d")}
    seen = wiring.lagged(wiring.form(n_e), q.get("T_f", 0.0))
    wiring.rates[error] = set_point - seen
    command = gains["K_p"] * (set_point - seen) + gains["K_i"] * wiring.form(error)
    if gains["K_d"]:
        command -= wiring.differentiated(seen, gains["K_d"], gains["K_p"])
    fuel = wiring.delayed(command, q.get("T_d", 0.0) + 0.5 * q.get("T_s", 0.0))
    fuel = wiring.lagged(fuel, q.get("tau_act", 0.0))
    brake = wiring.lagged(q["g"] * wiring.form(n_e) + fuel, q.get("tau_eng", 0.0))
    tau_prop = q.get("tau_prop", 0.0)
    if q.get("tau_twist"):
        n_s, twist = wiring.state(), wiring.state()
        propeller = wiring.form(n_s)
        slip = wiring.form(n_e) - propeller
        gauge = wiring.form(twist) + q.get("zeta_twist", 0.0) * slip
        wiring.rates[n_e] = (brake - gauge) / (q["tau_n"] - tau_prop)
        wiring.rates[twist] = slip / q["tau_twist"]
        wiring.rates[n_s] = (gauge - q["p"] * propeller) / tau_prop
    else:
        propeller = wiring.form(n_e)
        wiring.rates[n_e] = (brake - q["p"] * propeller) / q["tau_n"]
        gauge = q["p"] * propeller + tau_prop * wiring.rates[n_e]
    speed = wiring.form(n_e) if equations.speed == "engine" else propeller
    rows = {
        "dn": wiring.delayed(speed, q.get("T_n", 0.0)),
        "dM": wiring.delayed(gauge if equations.gauge else brake, q.get("T_M", 0.0)),
        "dM_b": wiring.delayed(brake, q.get("T_B", 0.0)),
        "dE": wiring.form(error),
        "dX": fuel / v,
    }
    return wiring.built({output: rows[output] for output in equations.outputs})


class _Wiring:
    """Builder of the state space: signals are linear combinations of states and input, and each element adds its states."""

    def __init__(self, order: int) -> None:
        self.order = order
        self.count = 0
        self.rates: dict[int, Form] = {}
        self.input = np.zeros(MOST_STATES + 1)
        self.input[-1] = 1.0

    def state(self) -> int:
        self.count += 1
        return self.count - 1

    def form(self, state: int) -> Form:
        row = np.zeros(MOST_STATES + 1)
        row[state] = 1.0
        return row

    def lagged(self, signal: Form, time_constant: float) -> Form:
        """Return a signal filtered by 1 / (1 + time_constant s)."""
        if time_constant < LEAST_S:
            return signal
        state = self.state()
        self.rates[state] = (signal - self.form(state)) / time_constant
        return self.form(state)

    def differentiated(self, signal: Form, gain: float, proportional: float) -> Form:
        """Return a signal filtered by gain s / (1 + filter s), with the filter of `TransferFunctions`."""
        filter_s = DERIVATIVE_FILTER * gain / proportional
        return np.asarray(gain / filter_s * (signal - self.lagged(signal, filter_s)))

    def delayed(self, signal: Form, dead_time: float) -> Form:
        """Return a signal delayed by a dead time, as a Pade approximation."""
        if dead_time < LEAST_S:
            return signal
        m = self.order
        # Coefficients from the highest power. The numerator's order is lower, which avoids a direct feedthrough.
        late = np.array([comb(m, k) * factorial(2 * m - 1 - k) for k in range(m, -1, -1)], dtype=np.float64)
        early = [(-1) ** k * comb(m - 1, k) * factorial(2 * m - 1 - k) for k in range(m - 1, -1, -1)]
        late, early = late / late[0], np.array(early) / late[0]
        states = [self.state() for _ in range(m)]
        first = signal - sum((part * self.form(one) for part, one in zip(late[1:], states, strict=True)), 0.0)
        self.rates[states[0]] = np.asarray(first / dead_time)
        for one, before in zip(states[1:], states, strict=False):
            self.rates[one] = self.form(before) / dead_time
        return np.asarray(sum((part * self.form(one) for part, one in zip(early, states, strict=True)), 0.0))

    def built(self, outputs: Mapping[str, Form]) -> StateSpace:
        """Return the state space with these outputs."""
        rates = np.array([self.rates[state] for state in range(self.count)])
        rows = np.array([*outputs.values()])
        return StateSpace(
            rates[:, : self.count], rates[:, -1], rows[:, : self.count], rows[:, -1], tuple(outputs)
        )
