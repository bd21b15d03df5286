"""State-space equations of the linear drive train, eq. 3.14 to 3.54 generalised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.state_space import STEP, Model, StateSpaceEquations
from shipfp_rs.structures.transfer import SLOWEST
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

ORDER = 6
"""States of the loop's delay, a [5/6] Pade approximation with an error of 2.4e-6 at omega T_d = 3."""
SHORTEST = 1e-8
"""Dead time of the loop [s] up to which a first-order expansion is used, with an error below 1e-12."""
# The delay's states, orthonormal (Legendre delay network, Voelker and Eliasmith 2018, DOI 10.1162/neco_a_01046).
_ORDERS = np.arange(ORDER)
_NORM = np.sqrt(2.0 * _ORDERS + 1.0)
_INTO = (-1.0) ** _ORDERS * _NORM
_WITHIN = np.outer(_NORM, _NORM) * np.where(
    _ORDERS[:, None] < _ORDERS, -1.0, (-1.0) ** (_ORDERS[:, None] - _ORDERS + 1)
)


@dataclass(frozen=True)
class LinearEquations(StateSpaceEquations):
    """Linear structure with dead times, eq. 3.31, 3.35 and 3.38 generalised; see `Structure.linear`.

    u1 is the set point delayed by T_set, u2 is u1 delayed by T_d, and y is z = vK_i E - vK_p n delayed by T_d:

        tau_n n' = -(p - g) n + vK_p u2 + y        E' = u1 - n
    """

    outputs: tuple[str, ...]
    gauge: bool
    states: tuple[str, ...] = ("initial dn", "initial dE")
    linear_in: tuple[str, ...] = ("initial dn", "initial dE")

    def models(self, values: Values, names: Names) -> list[Model]:
        """Return the model with its derivative by each name, or without derivative if there are no names."""
        order = 2 + ORDER * (values.get("T_d", 0.0) > SHORTEST)
        moved: list[Any] = [{**values, name: values.get(name, 0.0) + 1j * STEP} for name in names] or [values]
        return [self._model(one, order) for one in moved]

    @staticmethod
    def _parameters(q: Any) -> tuple[Any, ...]:
        """Return tau_n, p, v, K_p and K_i; v K_p and v K_i may replace the last two."""
        gains = (q.get(name, q.get(f"v{name}", 0.0)) for name in ("K_p", "K_i"))
        return q["tau_n"], q["p"], q.get("v", 1.0), *gains

    def _model(self, q: Any, order: int) -> Model:
        tau_n, p, v, K_p, K_i = self._parameters(q)
        n, E = (q.get(state, 0.0) for state in self.states)
        T_d, T_set = q.get("T_d", 0.0), q.get("T_set", 0.0)
        a, b, c = (p - q["g"]) / tau_n, v * K_p / tau_n, v * K_i / tau_n
        rows, inputs = len(self.outputs), 2 + (order == 2 and "T_d" in q)
        A, B, C, D = (
            np.zeros(shape, dtype=np.complex128)
            for shape in ((order, order), (order, inputs), (rows, order), (rows, inputs))
        )
        start = np.zeros(order, dtype=np.complex128)
        A[1, 0], B[1, 0], start[:2] = -1.0, 1.0, (n, E)
        if order > 2:
            A[0, 0], A[0, 2:], B[0, 1] = -a, _NORM, b
            A[2:, 2:], A[2:, 0], A[2:, 1] = _WITHIN / T_d, -b / T_d * _INTO, c / T_d * _INTO
            start[2] = c * E - b * n
        else:
            A[0, :2], B[0, 1] = (-a - b, c), b
            if inputs > 2:
                # y = z - T_d z' to first order, with z' = c (u1 - n) - b n' just before a step.
                A[0], B[0, 2] = A[0] * (1.0 + T_d * b), T_d * (b * b - c)
                A[0, 0] += T_d * c
        for row, (output, of_states) in enumerate(zip(self.outputs, C, strict=True)):
            if output == "dM":
                inertia = q.get("tau_prop", 0.0) if self.gauge else tau_n
                of_states[:] = inertia * A[0]
                of_states[0] += p
                D[row] = inertia * B[0]
            elif output == "dX":
                of_states[:2], D[row, 0] = (-K_p, K_i), K_p
            else:
                of_states[("dn", "dE").index(output)] = 1.0
        return Model(A, B, C, D, start, np.array([T_set, T_set + T_d, T_set + SHORTEST][:inputs]))

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        found, slopes = super().sensitivities(values, experiment, names)
        if "T_d" in names and "dM" in self.outputs:
            # The record starts from rest, so that dead time does not affect its first sample.
            slopes[names.index("T_d"), self.outputs.index("dM"), 0] = 0.0
        return found, slopes

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable; exact without dead time, else with the [5/6] Pade approximation of T_d."""
        (model,) = self.models(values, ())
        return bool(np.linalg.eigvals(model.A.real).real.max() < 0.0)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F), with exact dead times."""
        tau_n, p, v, K_p, K_i = self._parameters(values)
        s = 1j * np.maximum(2.0 * np.pi * frequency_hz, SLOWEST)
        inertia, inertia_name = (values.get("tau_prop", 0.0), "tau_prop") if self.gauge else (tau_n, "tau_n")
        delay, late = np.exp(-s * values.get("T_set", 0.0)), np.exp(-s * values.get("T_d", 0.0))
        governor = (K_p + K_i / s) * late
        closed = tau_n * s + p - values["g"] + v * governor
        speed = v * governor * delay / closed
        error = delay - speed
        load = p + inertia * s
        found = {"dn": speed, "dM": load * speed, "dE": error / s, "dX": governor * error}
        by_governor = {"K_p": late, "K_i": late / s, "T_d": -s * governor}
        by_closed: dict[str, Any] = {"tau_n": s, "p": 1.0, "g": -1.0}
        by_load: dict[str, Any] = {"p": 1.0, inertia_name: s}
        slopes = np.zeros((len(names), len(self.outputs), len(s)), dtype=np.complex128)
        for slope, name in zip(slopes, names, strict=True):
            dgovernor = by_governor.get(name.removeprefix("v"), 0.0)
            dspeed: Any = 0.0
            if name in by_closed:
                dspeed = -by_closed[name] / closed * speed
            elif name == "v":
                dspeed = governor / closed * error
            elif name == "T_set":
                dspeed = -s * speed
            elif name.removeprefix("v") in by_governor:
                dspeed = v * dgovernor / closed * error
            derror = -s * delay - dspeed if name == "T_set" else -dspeed
            for row, output in zip(slope, self.outputs, strict=True):
                if output == "dn":
                    row[:] = dspeed
                elif output == "dM":
                    row[:] = load * dspeed + by_load.get(name, 0.0) * speed
                else:
                    row[:] = derror / s if output == "dE" else dgovernor * error + governor * derror
        return np.array([found[output] for output in self.outputs]), slopes
