"""Linear models of a vessel about a steady state (eq. 3.14-3.54), analytical and numerical."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import check_fields, checked
from shipfp_rs.support.arrays import ComplexArray
from shipfp_rs.support.derivatives import COMPLEX_STEP
from shipfp_rs.vessel.drive_train import PLANT_PARAMETERS, drive_train
from shipfp_rs.vessel.steady_state import OperatingPoint, steady_state
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
    from shipfp_rs.frequency import FrequencyResponse

Output = Literal["dn", "dE", "dM_b", "dM_g", "dX"]

SIGNALS: Mapping[Output, str] = {"dn": "n_e", "dE": "E_n", "dM_b": "M_b", "dM_g": "M_g", "dX": "X_f"}
"""Signal of each output."""
S = np.poly1d([1.0, 0.0])
"""Laplace variable."""


@dataclass(frozen=True)
class LinearModel:
    """Linear model of a drive train; its outputs are deviations relative to the operating point.

    Parameters
    ----------
    tau_n
        Integration time of the shaft [s], 2 pi I_p n_s0 / M_s0 (eq. 3.23).
    g, v
        Relative slopes of the brake torque over speed (g) and over fuel rack (v) (eq. 3.24, 3.25).
    K_p, K_i
        Gains of the governor, normalised with the operating point: K_p [-], K_i [1/s].
    p
        Exponent of the propeller torque; 2 in eq. 3.20.
    tau_prop
        Share of tau_n on the propeller's side of the torque gauge [s].
    T_d, T_set
        Dead times in the loop and in the set-point path [s].

    Notes
    -----
    With C(s) = K_p + K_i/s and without dead times, dn/dn_set = v C / (tau_n s + p - g + v C) (eq. 3.31),
    d(dE)/dt = dn_set - dn (eq. 3.15), dM_b = (p + tau_n s) dn (eq. 3.38) and, for the torque at a gauge
    between the two inertias, dM_g = (p + tau_prop s) dn.
    """

    tau_n: float
    g: float
    v: float
    K_p: float
    K_i: float
    p: float
    tau_prop: float
    T_d: float = 0.0
    T_set: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "linear model")
        if not all(map(math.isfinite, dataclasses.astuple(self))):
            raise InputError(f"linear model: {dataclasses.astuple(self)}, expected finite numbers")

    @property
    def poles(self) -> ComplexArray:
        """Poles of the closed loop [rad/s], shape (2,)."""
        self._require_no_dead_time()
        return np.asarray(self._parts(S)[1].roots, dtype=np.complex128)

    @checked
    def dc_gain(self, output: Output) -> float:
        """Static gain from the set point to `output`: dn 1, dE (p - g)/(v K_i), torques p (Table 3.4)."""
        numerators, denominator = self._parts(0.0)
        return float(numerators[output] / denominator)

    @checked
    def high_frequency_gain(self, output: Output) -> float:
        """Gain from the set point to `output` at high frequency: v K_p for the brake torque (eq. 3.40)."""
        numerators, denominator = self._parts(S)
        proper = numerators[output].order == denominator.order
        return float(numerators[output].coef[0] / denominator.coef[0]) if proper else 0.0

    @checked
    def transfer_function(self, output: Output) -> signal.TransferFunction:
        """Return the transfer function from the set point to `output`.

        Raises
        ------
        InputError
            If the model has a dead time, which is not a rational function of s; use `response` instead.
        """
        self._require_no_dead_time()
        numerators, denominator = self._parts(S)
        return signal.TransferFunction(numerators[output].coef, denominator.coef)

    @checked
    def state_space(self, outputs: Sequence[Output] = ("dn", "dM_b")) -> signal.StateSpace:
        """Return the state space with state (dn, dE), input dn_set and the given outputs (eq. 3.46-3.54).

        Raises
        ------
        InputError
            If the model has a dead time, or no output is given.
        """
        self._require_no_dead_time()
        if len(outputs) == 0:
            raise InputError(f"outputs is empty, expected at least one of {', '.join(get_args(Output))}")
        dn, dE, dn_set = np.eye(3)
        dX = self.K_p * (dn_set - dn) + self.K_i * dE
        dM_b = self.g * dn + self.v * dX
        rate = (dM_b - self.p * dn) / self.tau_n
        dM_g = self.p * dn + self.tau_prop * rate
        rows = {"dn": dn, "dE": dE, "dM_b": dM_b, "dM_g": dM_g, "dX": dX}
        AB, CD = np.array([rate, dn_set - dn]), np.array([rows[output] for output in outputs])
        return signal.StateSpace(AB[:, :2], AB[:, 2:], CD[:, :2], CD[:, 2:])

    @checked
    def response(
        self, frequency_hz: npt.ArrayLike, outputs: Sequence[Output] = ("dn", "dM_b")
    ) -> ComplexArray:
        """Return the complex response of the outputs to the set point, shape (O, F), with exact dead times.

        Parameters
        ----------
        frequency_hz
            Frequencies [Hz], shape (F,).
        outputs
            Names of the outputs, O of them.

        Raises
        ------
        InputError
            For an unknown output, or a frequency that is not finite or is negative.
        """
        frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
        bad = np.flatnonzero(~(np.isfinite(frequency) & (frequency >= 0.0)))
        if len(bad):
            raise InputError(
                f"frequency_hz[{bad[0]}]: found {frequency[bad[0]]}, expected a finite frequency of 0 Hz or more"
            )
        s = 2j * np.pi * frequency
        with np.errstate(all="ignore"):
            numerators, denominator = self._parts(s, np.exp(-s * self.T_d))
            common = np.exp(-s * self.T_set) / denominator
        if not np.isfinite(common).all():
            raise InputError("frequency_hz: at 0 Hz the response needs v K_i other than 0")
        return np.array([numerators[output] * common for output in outputs], dtype=np.complex128)

    @checked
    def frequency_response(
        self, frequency_hz: npt.ArrayLike, outputs: Sequence[Output] = ("dn", "dM_b"), *, name: str = "model"
    ) -> FrequencyResponse:
        """Return the response as an object for plots, comparisons and fits.

        Parameters
        ----------
        frequency_hz, outputs
            As for `response`; the object has the names of measured signals, such as n_e for dn.
        name
            Label.

        Examples
        --------
        >>> tug = linearise(Vessel.load("stan-tug-1205"))
        >>> tug.frequency_response([0.1, 1.0])
        FrequencyResponse('model', 2 points from 0.1 to 1 Hz: n_e, M_b)
        """
        # Import here, since `frequency` loads SciPy, which a linearisation rarely needs.
        from shipfp_rs.frequency import FrequencyResponse

        frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
        curves = self.response(frequency, outputs)
        signals = {SIGNALS[output]: curve for output, curve in zip(outputs, curves, strict=True)}
        return FrequencyResponse(name, frequency, signals, provenance={"source": "linear model"})

    def _parts(self, s: Any, late: Any = 1.0) -> tuple[dict[Output, Any], Any]:
        """Numerators of the transfer functions and their common denominator, each times s; `s` is numbers or `S`."""
        governor, shaft = (self.K_p * s + self.K_i) * late, self.tau_n * s + (self.p - self.g)
        speed = self.v * governor
        return {
            "dn": speed,
            "dE": shaft,
            "dM_b": (self.tau_n * s + self.p) * speed,
            "dM_g": (self.tau_prop * s + self.p) * speed,
            "dX": governor * shaft,
        }, s * shaft + speed

    def _require_no_dead_time(self) -> None:
        if self.T_d or self.T_set:
            raise InputError(
                f"linear model: found dead times T_d {self.T_d:g} s, T_set {self.T_set:g} s, expected none; "
                "a dead time is not a rational function, use the frequency response"
            )


@checked
def linearise(vessel: Vessel, n_e_rpm: float | None = None) -> LinearModel:
    """Linearise a vessel analytically about the steady state at a set point.

    Parameters
    ----------
    vessel, n_e_rpm
        The ship and its set point [rpm], as for `steady_state`.

    Raises
    ------
    InputError
        If the engine can't hold the set point.

    Notes
    -----
    For a vessel with elements in addition to the plant of eq. 3.1-3.11, the model describes small and slow motions. T_d is
    the sum of the mean delays between speed and torque: dead time, lag, half a period of a sampling governor, half a firing
    stroke. A drag that grows with the speed affects v and g, since these are slopes of the torque at the shaft. Limits,
    ramps, derivative gain, droop, torsional flexibility of the shaft and the ship's acceleration are not included.

    Examples
    --------
    >>> model = linearise(Vessel.load("stan-launch-804"))
    >>> round(model.tau_n, 3), round(model.g, 3), round(model.v * model.K_p, 2)
    (1.514, -0.583, 15.83)
    """
    point = steady_state(vessel, n_e_rpm)
    plant = dict(zip(PLANT_PARAMETERS, vessel.plant_parameters().tolist(), strict=True))
    time_per_inertia = 2.0 * math.pi * point.n_s / point.M_s
    drag = vessel.drag_torque(point.n_s) / point.M_s
    return LinearModel(
        tau_n=time_per_inertia * vessel.inertia,
        g=(1.0 + drag) * plant["A2"] * point.n_e / point.M_b - drag * vessel.gearbox.drag_exponent,
        v=(1.0 + drag) * plant["A1"] * point.X_f / point.M_b,
        K_p=plant["Kp_abs"] * point.n_e / point.X_f,
        K_i=plant["Ki_abs"] * point.n_e / point.X_f,
        p=drive_train(vessel).torque_exponent(point.n_s, point.ship_speed),
        tau_prop=time_per_inertia * vessel.propeller_side_inertia,
        T_d=vessel.loop_delay(point.n_e),
        T_set=vessel.governor.set_point_dead_time_s,
    )


def linearise_numerically(vessel: Vessel, n_e_rpm: float | None = None) -> LinearModel:
    """Linearise the nonlinear plant (eq. 3.1-3.11) by complex steps of its right-hand side, as a check of `linearise`."""
    if drive_train(vessel).extends_the_plant:
        raise InputError(
            f"vessel {vessel.name!r}: found elements in addition to the plant of eq. 3.1-3.11, expected none; use linearise"
        )
    point = steady_state(vessel, n_e_rpm)
    # Columns: derivatives of (dn', dX, dM_b, dM_g) by dn, dE and dn_set.
    by_n, by_E, by_n_set = (
        _right_hand_side(vessel, point, COMPLEX_STEP * axis).imag / COMPLEX_STEP for axis in 1j * np.eye(3)
    )
    K_p, K_i = by_n_set[1], by_E[1]
    v = by_E[2] / K_i
    g = by_n[2] + v * K_p
    tau_n = v * K_i / by_E[0]
    return LinearModel(
        tau_n=float(tau_n),
        g=float(g),
        v=float(v),
        K_p=float(K_p),
        K_i=float(K_i),
        p=float(g - v * K_p - tau_n * by_n[0]),
        tau_prop=float(by_n_set[3] / by_n_set[0]),
    )


def _right_hand_side(vessel: Vessel, point: OperatingPoint, deviation: ComplexArray) -> ComplexArray:
    """Normalised (dn/dt, X, M_b, M_g) of the plant, at relative deviations of (n, E, n_set) from the steady state."""
    dn, dE, dn_set = deviation
    q = dict(zip(PLANT_PARAMETERS, vessel.plant_parameters().tolist(), strict=True))
    n_s, error = point.n_s * (1.0 + dn), point.n_e * (dn_set - dn)
    X_f = point.X_f + q["Kp_abs"] * error + q["Ki_abs"] * point.n_e * dE
    M_b = q["A1"] * X_f + q["A2"] * point.n_e * (1.0 + dn) + q["A3"]
    M_p = q["torque_coefficient"] * n_s ** q["torque_exponent"]
    excess = M_b * vessel.gearbox.ratio * vessel.gearbox.efficiency - M_p
    M_g = M_p + vessel.propeller_side_inertia / vessel.inertia * excess
    rate = excess / (2.0 * math.pi * vessel.inertia * point.n_s)
    return np.array([rate, X_f / point.X_f, M_b / point.M_b, M_g / point.M_s])
