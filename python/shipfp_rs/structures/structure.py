"""Structures: parametric models of the drive train, declared by parameters, outputs and equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.structures import stored
from shipfp_rs.structures.custom import FunctionEquations, Matrices, MatrixEquations, Response, Simulate
from shipfp_rs.structures.declared import Editable
from shipfp_rs.structures.elements import QUANTITIES, chosen
from shipfp_rs.structures.parameter import (
    BRAKE,
    Torque,
    own_signals,
    require_no_rack,
    require_outputs,
    signals_of,
)
from shipfp_rs.structures.parameter import Parameter as Parameter
from shipfp_rs.structures.ship import BRAKE_SCALE, STATES, ShipEquations
from shipfp_rs.structures.state_space import LinearEquations
from shipfp_rs.structures.ties import JointEquations, PartEquations
from shipfp_rs.support.arguments import checked


def _gains(products: bool) -> tuple[Parameter, ...]:
    names = ("vK_p", "vK_i") if products else ("v", "K_p", "K_i")
    return tuple(QUANTITIES[name].parameter() for name in names)


class Structure(Editable):
    """A parametric model: parameters with unit, bounds and start, outputs, equations.

    `Structure.ship` declares the ship, `Structure.linear` its linearisation; other constructors take user equations.
    """

    @classmethod
    @checked
    def linear(
        cls,
        *,
        torque: Torque = "brake",
        products: bool = False,
        free_exponent: bool = False,
        dead_time_loop: bool = False,
        dead_time_set_point: bool = False,
        outputs: Sequence[str] = ("dn", "dM"),
        name: str | None = None,
    ) -> Structure:
        """Declare the linear drive train about an operating point, eq. 3.14 to 3.54 generalised.

        Parameters
        ----------
        torque
            "brake": the engine's torque, M_b* = p n* + tau_n dn*/dt (the thesis's structure, eq. 3.38); "gauge": a strain
            gauge with part of the inertia on its propeller side, M_g* = p n* + tau_prop dn*/dt.
        products
            Declare vK_p and vK_i instead of v, K_p and K_i, which speed and torque can't distinguish.
        free_exponent
            Estimate the propeller torque exponent p; otherwise it is 2 as in the thesis.
        dead_time_loop, dead_time_set_point
            Add the dead time T_d in the fuel path, and T_set in the path of the set point.
        outputs
            Some of "dn", "dM", "dE", "dX".
        name
            Name in reports.

        Raises
        ------
        InputError
            For an unknown output or torque, or the rack with a dead time in the loop.

        Examples
        --------
        >>> [one.name for one in Structure.linear().parameters if not one.fixed]
        ['tau_n', 'g', 'v', 'K_p', 'K_i']
        """
        require_outputs(outputs)
        require_no_rack(outputs, dead_time=dead_time_loop)
        gauge = torque == "gauge" and "dM" in outputs
        parameters = (
            Parameter("tau_n", "s", 1.2, 0.01, 10.0),
            Parameter("g", "-", -0.5, -10.0, 1.0),
            *_gains(products),
            Parameter("p", "-", 2.0, 1.0, 4.0, fixed=not free_exponent),
            *((Parameter("tau_prop", "s", 0.5, 1e-3, 10.0),) if gauge else ()),
            *((Parameter("T_d", "s", 0.05, 0.0, 0.5),) if dead_time_loop else ()),
            *((Parameter("T_set", "s", 0.05, 0.0, 2.0),) if dead_time_set_point else ()),
        )
        said = {
            "gauge-side torque": gauge,
            "free exponent": free_exponent,
            "dead time in the loop": dead_time_loop,
            "dead time of the set point": dead_time_set_point,
        }
        extras = [text for text, present in said.items() if present]
        return cls(
            name=name or ("linear" + (": " + ", ".join(extras) if extras else "")),
            parameters=parameters,
            signals=signals_of(outputs, torque),
            equations=LinearEquations(tuple(outputs), gauge=gauge),
            settings={
                "kind": "linear",
                "torque": torque,
                "products": products,
                "free_exponent": free_exponent,
                "dead_time_loop": dead_time_loop,
                "dead_time_set_point": dead_time_set_point,
            },
        )

    @classmethod
    @checked
    def ship(
        cls,
        elements: Sequence[str] = (),
        *,
        torque: Torque = "brake",
        outputs: Sequence[str] = ("dn", "dM"),
        products: bool = True,
        propeller_speed: bool = False,
        mean_sampling: bool = False,
        name: str | None = None,
    ) -> Structure:
        """Declare the ship: its nonlinear drive train in normalised terms, with optional elements.

        With N, u and M the speed, set point and torque over their operating points:

            tau_n dN/dt = M_b - N^p,                M_b = 1 + g (N - 1) + vX(t - T_d),
            vX = vK_p e + vK_i int e dt,            e = u(t - T_set) - N

        Parameters
        ----------
        elements
            Names from `structures.elements.ELEMENTS`: "dead_time_loop" (T_d), "dead_time_set_point" (T_set), "actuator_lag"
            (tau_act), "speed_filter" (T_f), "engine_lag" (tau_eng, of the torque by fuel and slope), "derivative" (vK_d, on
            the speed), "droop" (lowers the set point by droop vX), "sampling" (T_s), "torque_limit" (M_max), "rack_rate"
            (rate), "damping" (of the load), "load" (measured), "twist" (tau_twist, zeta_twist; a shaft between the engine's
            inertia and the propeller's, tau_prop).
        torque
            "brake": the engine's, M_b; "gauge": M_g = N^p + tau_prop dN/dt, with part of the inertia on its propeller side.
        outputs
            Some of "dn", "dM", "dX", "dE"; with a gauge's "dM" also the brake's torque, "dM_b".
        products
            Declare vK_p and vK_i instead of v, K_p and K_i, which speed and torque can't distinguish.
        propeller_speed
            Whether the speed is measured on the propeller's side of a torsionally flexible shaft.
        mean_sampling
            Whether a sampling governor is modelled by its mean effect, as in records that are low-passed below its sample
            rate. T_d then includes half of the period T_s.

        Raises
        ------
        InputError
            For an unknown element, output or torque, or an invalid combination.

        Notes
        -----
        Each experiment has four unknowns: initial speed and fuel torque, and relative errors of its set point and torque.
        The equations are 3.1 to 3.11 divided by the operating point; the exponent p is free, 2 in the thesis.

        Examples
        --------
        >>> [parameter.name for parameter in Structure.ship(["dead_time_loop"]).free]
        ['tau_n', 'g', 'vK_p', 'vK_i', 'p', 'T_d']
        """
        gauge = torque == "gauge" and "dM" in outputs
        require_outputs(outputs, both_torques=gauge and not propeller_speed)
        acting, behind = chosen(elements), gauge or "twist" in elements
        parameters = (
            *(QUANTITIES[one].parameter() for one in ("tau_n", "g")),
            *_gains(products),
            *(QUANTITIES[one].parameter() for one in ("p", *(["tau_prop"] if behind else []))),
            *(
                parameter
                for element in acting
                for parameter in element.parameters
                if not (mean_sampling and parameter.name == "T_0")
            ),
        )
        words = [element.words for element in acting]
        return cls(
            name=name or ("ship" + (": " + ", ".join(words) if words else "")),
            parameters=parameters,
            signals=signals_of(outputs, torque),
            equations=ShipEquations(
                tuple(outputs),
                gauge,
                propeller_speed,
                loaded=any(element.name == "load" for element in acting),
                mean_sampling=mean_sampling,
                states=(*STATES, *((BRAKE_SCALE,) if BRAKE in outputs else ())),
            ),
            settings={
                "kind": "ship",
                "elements": [element.name for element in acting],
                "torque": torque,
                "products": products,
                "propeller_speed": propeller_speed,
                "mean_sampling": mean_sampling,
            },
        )

    @classmethod
    @checked
    def from_matrices(
        cls,
        matrices: Matrices,
        parameters: Sequence[Parameter],
        outputs: Sequence[str] | Mapping[str, str],
        *,
        name: str,
    ) -> Structure:
        """Declare a structure by matrices: x' = A x + B dn_set, y = C x + D dn_set, of any order.

        The structure supports all features of `linear`: initial states, joint fits, frequency responses. A dead time must be
        approximated by states; for an exact one use `from_function`.

        Parameters
        ----------
        matrices
            Function from parameter values by name to (A, B, C, D) in continuous time [s], of shapes (n, n), (n,), (O, n),
            (O,). If it accepts complex values, as NumPy functions do, the derivatives are exact.
        parameters
            Name, unit, start, bounds of each.
        outputs
            Some of "dn", "dM", "dE", "dX", or a mapping from your output names to the signals that measure them.
        name
            Name in reports.

        Raises
        ------
        InputError
            For unknown or repeated outputs, or inconsistent shapes at the start values.

        Examples
        --------
        The rack follows the governor, and the shaft follows the rack, each with a lag:

        >>> import numpy as np
        >>> def matrices(q):
        ...     rack, shaft = 1 / q["tau_rack"], 1 / q["tau_shaft"]
        ...     A = np.array([[-rack, 0], [shaft, -shaft]])
        ...     return A, np.array([rack, 0]), np.array([[0, 1]]), np.array([0])
        >>> two_lags = Structure.from_matrices(
        ...     matrices,
        ...     [
        ...         Parameter("tau_rack", "s", 0.2, 0.01, 2),
        ...         Parameter("tau_shaft", "s", 1.0, 0.01, 10),
        ...     ],
        ...     ["dn"],
        ...     name="two lags",
        ... )
        >>> two_lags.equations.states
        ('initial x1', 'initial x2')
        """
        signals = own_signals(outputs)
        equations = MatrixEquations(matrices, tuple(parameters), tuple(signals))
        equations.states  # noqa: B018 checks the shapes here instead of during a fit
        return cls(name, tuple(parameters), signals, equations, {"kind": "matrices"})

    @classmethod
    @checked
    def from_function(
        cls,
        simulate: Simulate,
        parameters: Sequence[Parameter],
        outputs: Sequence[str] | Mapping[str, str],
        *,
        name: str,
        response: Response | None = None,
    ) -> Structure:
        """Declare a structure by a function that simulates an experiment.

        Derivatives are numerical, see `differences.Differences`. The function sets the initial state; unknown initial values
        are parameters. An offset of each output is estimated, as for other structures.

        Parameters
        ----------
        simulate
            Function from (parameter values by name, `Experiment`) to the normalised outputs, shape (O, N). If the
            function raises `SimulationError` or ArithmeticError, or returns values that are not finite, the search
            takes a shorter step.
        parameters, outputs, name
            As for `from_matrices`.
        response
            Function from (parameter values, frequencies [Hz] (F,)) to complex responses (O, F), for frequency data.

        Raises
        ------
        InputError
            For unknown or repeated outputs.

        Examples
        --------
        The torque follows the set point with a gain and a lag:

        >>> from scipy.signal import lsim
        >>> def simulate(q, experiment):
        ...     lag = [q["gain"]], [q["tau"], 1]
        ...     return lsim(lag, experiment.normalised("n_set"), experiment.time)[1][None]
        >>> lag = Structure.from_function(
        ...     simulate,
        ...     [Parameter("gain", "-", 1.0, 0.0, 10.0), Parameter("tau", "s", 1.0, 0.01, 10.0)],
        ...     {"dM": "M_b"},
        ...     name="lag of torque",
        ... )
        >>> lag.outputs
        ('dM',)
        """
        signals = own_signals(outputs)
        equations = FunctionEquations(simulate, tuple(parameters), tuple(signals), response)
        return cls(name, tuple(parameters), signals, equations, {"kind": "function"})

    @classmethod
    @checked
    def joint(
        cls, parts: Mapping[str, Structure], shared: Sequence[str], *, name: str | None = None
    ) -> Structure:
        """Declare a joint structure for trials that share parameters: a ship at two speeds, or before and after a refit.

        Parameters
        ----------
        parts
            Structure of each trial, by the name of its `Experiment` or `FrequencyResponse`; all structures have the
            same outputs.
        shared
            Names of shared parameters, with the first structure's start, bounds and prior. The names of all other
            parameters are extended by the trial's name, as in "tau_n (fast)"; `with_tied` relates parameters that are
            equal in only some of the trials.
        name
            Name in reports.

        Raises
        ------
        InputError
            For fewer than two trials, different outputs, or a shared parameter that a structure lacks.

        Examples
        --------
        >>> plain = Structure.linear(products=True, dead_time_loop=True)
        >>> both = Structure.joint({"slow": plain, "fast": plain}, shared=["p", "T_d"])
        >>> [parameter.name for parameter in both.free][:3]
        ['tau_n (slow)', 'g (slow)', 'vK_p (slow)']
        """
        if len(parts) < 2:
            raise InputError(f"joint structure: {len(parts)} parts, expected two or more")
        first = next(iter(parts.values()))
        parameters: dict[str, Parameter] = {}
        equations = {}
        for label, part in parts.items():
            if part.outputs != first.outputs or part.equations.states != first.equations.states:
                raise InputError(
                    f"joint structure: {label!r} explains {', '.join(part.outputs)} from other outputs or states than "
                    "the first part, expected the same"
                )
            if part.ties:
                raise InputError(
                    f"joint structure: {label!r} has ties, expected none; tie parameters of the joint structure"
                )
            for parameter in shared:
                _ = part[parameter]  # raises for an unknown name
            names = {own if own in shared else f"{own} ({label})": own for own in part.names}
            equations[label] = PartEquations(part.equations, names)
            for outer, own in names.items():
                parameters.setdefault(outer, replace(part[own], name=outer))
        return cls(
            name or " and ".join(f"{part.name} ({label})" for label, part in parts.items()),
            tuple(parameters.values()),
            first.signals,
            JointEquations(equations),
            {
                "kind": "joint",
                "parts": {label: part.to_dict() for label, part in parts.items()},
                "shared": list(shared),
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the structure as JSON tables for `from_dict`, as stored in a fingerprint, without user equations."""
        return stored.to_dict(self)

    @classmethod
    @checked
    def from_dict(cls, content: Mapping[str, Any]) -> Structure:
        """Return the structure that `to_dict` wrote, with its starts, bounds, fixed parameters, priors and ties.

        Raises
        ------
        InputError
            For user equations, which JSON can't hold, and for content that `to_dict` did not write.

        Examples
        --------
        >>> ship = Structure.ship(["dead_time_loop"]).with_fixed(p=2.1).with_prior(g=(-0.5, 0.1))
        >>> Structure.from_dict(ship.to_dict()) == ship
        True
        """
        made: Structure = stored.from_dict(cls, content)
        return made
