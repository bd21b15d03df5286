"""The linear drive train's equations, computed by the Rust kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs import _core
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

_INDEX = {name: index for index, name in enumerate(_core.LINEAR_PARAMETERS)}
# vK_p and vK_i are the kernel's K_p and K_i with v = 1.
_INDEX |= {"vK_p": _INDEX["K_p"], "vK_i": _INDEX["K_i"]}
# The initial state follows the parameters in the kernel's numbering.
_INDEX |= {"initial dn": len(_core.LINEAR_PARAMETERS), "initial dE": len(_core.LINEAR_PARAMETERS) + 1}


@dataclass(frozen=True)
class LinearEquations(Equations):
    """Linear structure with dead times, eq. 3.31, 3.35 and 3.38 generalised; see `Structure.linear`."""

    outputs: tuple[str, ...]
    gauge: bool
    states: tuple[str, ...] = ("initial dn", "initial dE")
    linear_in: tuple[str, ...] = ("initial dn", "initial dE")

    @property
    def _kernel_outputs(self) -> list[int]:
        torque = "dM_g" if self.gauge else "dM_b"
        return [_core.LINEAR_OUTPUTS.index(torque if output == "dM" else output) for output in self.outputs]

    @staticmethod
    def _kernel_parameters(values: Values) -> Array:
        parameters = np.zeros(len(_core.LINEAR_PARAMETERS))
        parameters[_INDEX["v"]] = 1.0
        for name, value in values.items():
            if not name.startswith("initial"):
                parameters[_INDEX[name]] = value
        return parameters

    @staticmethod
    def _initial(values: Values) -> Array:
        return np.array([values.get("initial dn", 0.0), values.get("initial dE", 0.0)])

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable: exact without dead time, with the loop's T_d as its [5/6] Pade form."""
        q = dict(zip(_core.LINEAR_PARAMETERS, self._kernel_parameters(values), strict=True))
        damping, vK_p, vK_i = q["p"] - q["g"], q["v"] * q["K_p"], q["v"] * q["K_i"]
        if q["T_d"] < 1e-9:
            return bool(damping + vK_p > 0.0 and vK_i > 0.0)
        # States n, E and the delay line of z = K_i E - K_p n (Legendre delay network, 10.1162/neco_a_01046).
        order = np.arange(6)
        sign = np.where(order[:, None] < order, -1.0, (-1.0) ** (order[:, None] - order + 1))
        odd = 2.0 * order + 1.0
        system = np.zeros((8, 8))
        system[0, 0], system[0, 2:], system[1, 0] = -damping / q["tau_n"], 1.0 / q["tau_n"], -1.0
        system[2:, 2:] = odd[:, None] * sign / q["T_d"]
        system[2:, 0] = -vK_p * odd * (-1.0) ** order / q["T_d"]
        system[2:, 1] = vK_i * odd * (-1.0) ** order / q["T_d"]
        return bool(np.linalg.eigvals(system).real.max() < 0.0)

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return _core.simulate_linear(
            self._kernel_parameters(values),
            experiment.dn_set,
            1.0 / experiment.rate_hz,
            experiment.hold,
            self._initial(values),
            self._kernel_outputs,
        )

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        return _core.linear_sensitivities(
            self._kernel_parameters(values),
            experiment.dn_set,
            1.0 / experiment.rate_hz,
            experiment.hold,
            self._initial(values),
            self._kernel_outputs,
            [_INDEX[name] for name in names],
        )

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F)."""
        return _core.linear_response_sensitivities(
            self._kernel_parameters(values),
            frequency_hz,
            self._kernel_outputs,
            [_INDEX[name] for name in names],
        )
