"""One-step prediction with an estimated Kalman gain: the linear drive train with disturbances, in innovations form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.linear import LinearEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import bare, tied
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

STATES = ("dn", "dE")


def with_innovations(structure: Structure, *, offsets: bool) -> Structure:
    """Return the structure with equations that predict one sample ahead.

    Raises
    ------
    InputError
        Where the structure is not linear, or has a dead time in the loop, which is no state.
    """
    linear = bare(structure.equations)
    if not isinstance(linear, LinearEquations) or "T_d" in structure.names:
        raise InputError(
            f"noise 'innovations': structure {structure.name!r}, expected a linear one without dead time in the loop; "
            "use noise 'ar'"
        )
    predictor = InnovationsEquations(linear, structure.signals, offsets)
    return replace(structure, equations=tied(predictor, structure.ties))


@dataclass(frozen=True)
class InnovationsEquations(Equations):
    """x[k+1] = Phi x + Gamma u + K e, y = C x + D u + offset + e, with e the error of the one-step prediction.

    Each experiment has a gain K (2, outputs), initial states and offsets of its own. The prediction is the simulation
    of the linear structure plus C d, where d[k+1] = (Phi - K C) d[k] + K (y - simulation - offset)[k].
    """

    linear: LinearEquations
    signals: Mapping[str, tuple[str, ...]]
    offsets: bool = True

    @property
    def _offsets(self) -> tuple[str, ...]:
        return tuple(f"offset {output}" for output in self.signals)

    @property
    def _gains(self) -> tuple[str, ...]:
        return tuple(f"gain {state} {output}" for state in STATES for output in self.signals)

    @property
    def states(self) -> tuple[str, ...]:
        """Unknowns of each experiment: initial states, offsets and the gain."""
        return (*self.linear_in, *self._gains)

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Those in which the prediction is linear."""
        return (*self.linear.states, *(self._offsets if self.offsets else ()))

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable."""
        return self.linear.stable(self._own(values))

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the predicted normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the predicted outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N).

        Raises
        ------
        InputError
            Where a sample is masked: the predictor needs them all.
        SimulationError
            Where the predictor is unstable.
        """
        own = [name for name in names if name not in self._offsets + self._gains]
        simulated, slopes = self.linear.sensitivities(self._own(values), experiment, own)
        transition, observed, slopes_of_model = self._model(values, experiment, own)
        gain = np.array([values.get(name, 0.0) for name in self._gains]).reshape(len(STATES), -1)
        offset = np.array([[values.get(name, 0.0)] for name in self._offsets])
        closed = transition - gain @ observed
        if not np.abs(np.linalg.eigvals(closed)).max() < 1.0:
            raise SimulationError("the predictor is unstable")
        rest = self._measured(experiment) - simulated - offset
        correction = _propagated(closed, gain @ rest)
        innovation = rest - observed @ correction
        forcing = np.empty((len(names), len(STATES), len(experiment)))
        direct = np.zeros((len(names), *simulated.shape))
        for row, name in enumerate(names):
            if name in self._offsets:
                output = self._offsets.index(name)
                forcing[row], direct[row, output] = -gain[:, output, None], 1.0
            elif name in self._gains:
                state, output = divmod(self._gains.index(name), len(self.signals))
                forcing[row] = np.eye(len(STATES))[state][:, None] * innovation[output]
            else:
                by_transition, by_observed = slopes_of_model[own.index(name)]
                slope = slopes[own.index(name)]
                forcing[row] = (by_transition - gain @ by_observed) @ correction - gain @ slope
                direct[row] = slope + by_observed @ correction
        return simulated + offset + observed @ correction, direct + observed @ _propagated(closed, forcing)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response of the linear structure; the gains of the predictor do not enter it."""
        return self.linear.response(self._own(values), frequency_hz, names)

    def _own(self, values: Values) -> dict[str, float]:
        foreign = {*self._offsets, *self._gains}
        return {name: value for name, value in values.items() if name not in foreign}

    def _measured(self, experiment: Experiment) -> Array:
        chosen = [
            next(signal for signal in candidates if signal in experiment.signals)
            for candidates in self.signals.values()
        ]
        measured = np.array([experiment.normalised(signal) for signal in chosen])
        if not np.isfinite(measured).all():
            count = int(np.sum(~np.isfinite(measured).all(axis=0)))
            raise InputError(
                f"{experiment.name!r}: {count} masked samples, noise 'innovations' needs them all; use noise 'ar' or "
                "cut a window without gaps"
            )
        return measured

    def _model(
        self, values: Values, experiment: Experiment, names: Names
    ) -> tuple[Array, Array, list[tuple[Array, Array]]]:
        """Phi (2, 2), C (O, 2) and their derivatives: what a unit initial state becomes, without a set point."""
        still = Experiment(
            experiment.name,
            experiment.rate_hz,
            {"n_set": np.full(2, experiment.operating_point["n_set"])},
            experiment.operating_point,
            experiment.hold,
        )
        everything = replace(self.linear, outputs=(*self.linear.outputs, *STATES))
        parameters = [name for name in names if name not in self.linear.states]
        columns, slopes = [], []
        for state in self.linear.states:
            start = {**self._own(values), **dict.fromkeys(self.linear.states, 0.0), state: 1.0}
            column, slope = everything.sensitivities(start, still, parameters)
            columns.append(column)
            slopes.append(slope)
        whole, by_parameter = np.stack(columns, axis=-1), np.stack(slopes, axis=-1)
        outputs = len(self.signals)
        derivatives = []
        for name in names:
            slope = by_parameter[parameters.index(name)] if name in parameters else np.zeros_like(whole)
            derivatives.append((slope[outputs:, 1], slope[:outputs, 0]))
        return whole[outputs:, 1], whole[:outputs, 0], derivatives


def _propagated(transition: Array, forcing: Array) -> Array:
    """Solve x[k+1] = A x[k] + f[k] from zero for f (..., 2, N), by the resolvent of a 2 x 2 matrix."""
    if not forcing.size:
        return forcing
    (a, b), (c, d) = transition
    now = lfilter([0.0, 1.0], [1.0, -(a + d), a * d - b * c], forcing, axis=-1)
    before = np.zeros_like(now)
    before[..., 1:] = now[..., :-1]
    state: Array = np.empty_like(now)
    state[..., 0, :] = now[..., 0, :] - d * before[..., 0, :] + b * before[..., 1, :]
    state[..., 1, :] = now[..., 1, :] - a * before[..., 1, :] + c * before[..., 0, :]
    return state
