"""Structures: parametric models of the drive train, declared once as parameters, outputs and equations."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures import grey_box, stored
from shipfp_rs.structures.custom import FunctionEquations, Matrices, MatrixEquations, Response, Simulate
from shipfp_rs.structures.elements import chosen
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.joint import JointEquations, PartEquations
from shipfp_rs.structures.linear import LinearEquations
from shipfp_rs.structures.linear_extended import ExtendedLinear, Place
from shipfp_rs.structures.linear_sampled import SampledGovernor
from shipfp_rs.structures.names import plain_name
from shipfp_rs.structures.parameter import Parameter as Parameter
from shipfp_rs.structures.pass_band import PassBand
from shipfp_rs.structures.plant import PlantEquations, as_built
from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.ties import Tie, bare, followed, resolved, tied
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.html import shown
from shipfp_rs.vessel.vessel import Vessel

Torque = Literal["brake", "gauge"]

OUTPUTS = ("dn", "dM", "dE", "dX")
"""Outputs of the linear structure and of the plant: speed, torque, integrated speed error, fuel rack."""


def _signals(outputs: Sequence[str], torque: Torque) -> dict[str, tuple[str, ...]]:
    """Measured signals that can stand for each output, best first; a gauge is no substitute but may be all there is."""
    candidates = {
        "dn": ("n_e", "n_s"),
        "dM": ("M_g", "M_s", "M_b") if torque == "gauge" else ("M_b", "M_s", "M_g"),
        "dE": ("E_n",),
        "dX": ("X_f",),
    }
    return {output: candidates[output] for output in outputs}


def _own_signals(outputs: Sequence[str] | Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    if isinstance(outputs, Mapping):
        signals: dict[str, tuple[str, ...]] = {output: (signal,) for output, signal in outputs.items()}
    else:
        unknown = [output for output in outputs if output not in OUTPUTS]
        if unknown:
            raise InputError(
                f"output {unknown[0]!r}, expected some of {', '.join(OUTPUTS)}, or a mapping from the outputs to the "
                "signals that measure them"
            )
        signals = _signals(outputs, "brake")
    if not signals or len(signals) != len(outputs):
        raise InputError(f"outputs {list(outputs)}, expected at least one and each once")
    return signals


@dataclass(frozen=True)
class Structure:
    """A parametric model: parameters with unit, bounds and start, outputs, equations.

    `Structure.linear` declares the linear drive train; the other constructors hang a user's own equations in.
    """

    name: str
    parameters: tuple[Parameter, ...]
    signals: Mapping[str, tuple[str, ...]]
    """Each output, in order, with the measured signals that can stand for it, the first one present being taken."""
    equations: Equations
    settings: Mapping[str, Any]

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
        actuator_lag: bool = False,
        derivative: bool = False,
        sampling: bool | Literal["exact"] = False,
        misreading: bool = False,
        twist: bool = False,
        curvature: bool = False,
        speed: Place = "engine",
        outputs: Sequence[str] = ("dn", "dM"),
        name: str | None = None,
    ) -> Structure:
        """Declare the linear drive train about an operating point, eq. 3.14 to 3.54 generalised.

        Parameters
        ----------
        torque
            "brake": the torque is the engine's, M_b* = p n* + tau_n dn*/dt (the thesis's structure, eq. 3.38);
            "gauge": it is read by a strain gauge with only part of the inertia behind it,
            M_g* = p n* + tau_prop dn*/dt.
        products
            Declare vK_p and vK_i in place of v, K_p and K_i, which speed and torque never tell apart.
        free_exponent
            Free the propeller torque exponent p; otherwise it is 2 as in the thesis.
        dead_time_loop, dead_time_set_point
            Add the dead time T_d in the fuel path, T_set in the set-point path.
        actuator_lag, derivative, sampling
            Add the fuel actuator's time constant tau_act; the governor's derivative gain K_d, on the speed alone; the
            period T_s at which it samples and holds. `sampling=True` is the hold alone, enough well below half the sample
            rate; with "exact" the governor computes at its samples only, so that it mistakes faster motion for slower
            (aliasing). T_s is then given, `with_fixed(T_s=...)`, and so is T_0, when its first sample of a record falls,
            unless bounds free it.
        misreading
            Add the share by which a governor that computes at each firing reads the speed off its mean: at rest,
            misread = (n_set - n_e) / n_e.
        twist
            Add the shaft's twist between engine and propeller, tau_twist = M_s0 / (2 pi n_s0 k) of a stiffness k
            [Nm/rad]; with gauge torque.
        curvature
            Add the second order of the propeller's torque, p (p - 1) / 2 n_s*^2: swings of 6 % make 2 % of it.
        speed
            Whose speed is measured, "engine" or "propeller"; the same unless the shaft twists.
        outputs
            Of "dn", "dM", "dE", "dX"; not "dE" with one from actuator lag to curvature.

        Raises
        ------
        InputError
            For an unknown output, torque or place of the speed, or what can't go together.

        Notes
        -----
        All from actuator lag to curvature is computed by FFT (`TransferEquations`): exact for signals that one and the
        same low-pass has passed, as those of `process`, whatever their sample rate. With `sampling="exact"` it is
        stepped from one of the governor's samples to the next (`SampledGovernor`), the set point held between the
        record's samples as the experiment says.

        Examples
        --------
        >>> [parameter.name for parameter in Structure.linear().parameters if not parameter.fixed]
        ['tau_n', 'g', 'v', 'K_p', 'K_i']
        """
        if torque not in ("brake", "gauge"):
            raise InputError(f"torque {torque!r}, expected 'brake' or 'gauge'")
        for output in outputs:
            if output not in OUTPUTS:
                raise InputError(f"output {output!r}, expected some of {', '.join(OUTPUTS)}")
        if not outputs or len(set(outputs)) != len(outputs):
            raise InputError(f"outputs {list(outputs)}, expected at least one and each once")
        if speed not in ("engine", "propeller"):
            raise InputError(f"speed {speed!r}, expected 'engine' or 'propeller'")
        gauge = torque == "gauge" and "dM" in outputs
        if twist and not gauge:
            raise InputError("twist: found no gauge torque, expected torque='gauge' and the output 'dM'")
        extended = actuator_lag or derivative or sampling or misreading or twist or curvature
        if sampling not in (False, True, "exact"):
            raise InputError(f"sampling {sampling!r}, expected False, True or 'exact'")
        exact = sampling == "exact"
        if exact and (misreading or curvature):
            raise InputError(
                "sampling: found 'exact' with misreading or curvature, expected neither; use sampling=True"
            )
        if extended and "dE" in outputs:
            raise InputError("outputs: found 'dE' with an extended drive train, expected some of dn, dM, dX")
        letter = "v" if products else ""
        governor = (
            *(() if products else (Parameter("v", "-", 1.5, 0.01, 10.0),)),
            Parameter(f"{letter}K_p", "-", 5.0, 1e-4, 1e3),
            Parameter(f"{letter}K_i", "1/s", 5.0, 1e-4, 1e3),
            *((Parameter(f"{letter}K_d", "s", 0.1, 0.0, 10.0),) if derivative else ()),
        )
        parameters = (
            Parameter("tau_n", "s", 1.2, 0.01, 10.0),
            Parameter("g", "-", -0.5, -10.0, 1.0),
            *governor,
            Parameter("p", "-", 2.0, 1.0, 4.0, fixed=not free_exponent),
            *((Parameter("tau_prop", "s", 0.5, 1e-3, 10.0),) if gauge else ()),
            *((Parameter("T_d", "s", 0.05, 0.0, 0.5),) if dead_time_loop else ()),
            *((Parameter("T_set", "s", 0.05, 0.0, 2.0),) if dead_time_set_point else ()),
            *((Parameter("tau_act", "s", 0.05, 1e-3 if exact else 0.0, 1.0),) if actuator_lag else ()),
            *((Parameter("T_s", "s", 0.02, 1e-4, 0.5, fixed=exact),) if sampling else ()),
            *((Parameter("T_0", "s", 0.0, 0.0, 0.5, fixed=True),) if exact else ()),
            *((Parameter("misread", "-", 0.0, -0.01, 0.01),) if misreading else ()),
            *((Parameter("tau_twist", "s", 1e-3, 1e-6 if exact else 0.0, 0.1),) if twist else ()),
        )
        elements = {
            "actuator_lag": actuator_lag,
            "derivative": derivative,
            "sampling": sampling,
            "misreading": misreading,
            "twist": twist,
            "curvature": curvature,
        }
        said = {
            "gauge-side torque": gauge,
            "free exponent": free_exponent,
            "dead time in the loop": dead_time_loop,
            "dead time of the set point": dead_time_set_point,
            "actuator lag": actuator_lag,
            "derivative gain": derivative,
            "sampling governor": sampling and not exact,
            "exactly sampling governor": exact,
            "misreading governor": misreading,
            "twist": twist,
            "curvature": curvature,
        }
        extras = [text for text, present in said.items() if present]
        equations: Equations = LinearEquations(tuple(outputs), gauge=gauge)
        if exact:
            equations = SampledGovernor(tuple(outputs), gauge, speed)
        elif extended:
            equations = ExtendedLinear(tuple(outputs), gauge, speed).equations(curvature=curvature)
        return cls(
            name=name or ("linear" + (": " + ", ".join(extras) if extras else "")),
            parameters=parameters,
            signals=_signals(outputs, torque),
            equations=equations,
            settings={
                "kind": "linear",
                "torque": torque,
                "products": products,
                "free_exponent": free_exponent,
                "dead_time_loop": dead_time_loop,
                "dead_time_set_point": dead_time_set_point,
                **(elements | {"speed": speed} if extended else {}),
            },
        )

    @classmethod
    @checked
    def three_parameters(
        cls,
        *,
        torque: Torque = "brake",
        free_exponent: bool = False,
        dead_time_loop: bool = False,
        dead_time_set_point: bool = False,
        outputs: Sequence[str] | None = None,
        name: str | None = None,
    ) -> Structure:
        """Declare the linear drive train without v and g (recommended in section 7.4.2 of the thesis, for simulations).

        What is left of n*/n_set* = (vK_p s + vK_i) / (tau_n s^2 + (p + vK_p) s + vK_i) are tau_n, vK_p and vK_i; with a
        gauge's torque there is tau_prop beside them, and the options add what they add to `linear`.

        Parameters
        ----------
        torque, free_exponent, dead_time_loop, dead_time_set_point, name
            As for `linear`.
        outputs
            As for `linear`; None: the speed, and the torque where it is a gauge's.

        Notes
        -----
        v never acts but in vK_p and vK_i. g is in the speed's response nowhere but in (p - g) / tau_n, vK_p / tau_n and
        vK_i / tau_n, so that g = 0 and all three times r = p / (p - g) give the same speed, exactly, dead times
        included: `LinearModel.three_parameters`. These effective values are what data of a ship with g < 0 lead to, and
        tau_n is too short for its inertia by the factor r, 0.77 for g = -0.6.

        The torque of a gauge, p n* + tau_prop dn*/dt, knows nothing of g either: nothing is lost but the names, and every
        parameter that is left can be told. The engine's torque is p n* + tau_n dn*/dt; simulated with the effective
        values it is exact for slow motions and off by (r - 1) tau_n s / (p + tau_n s) of itself for fast ones, by r - 1
        at most. Fitted along, it pulls tau_n away from the effective value to its own, and the speed suffers.

        Examples
        --------
        >>> [parameter.name for parameter in Structure.three_parameters().free]
        ['tau_n', 'vK_p', 'vK_i']
        """
        full = cls.linear(
            torque=torque,
            products=True,
            free_exponent=free_exponent,
            dead_time_loop=dead_time_loop,
            dead_time_set_point=dead_time_set_point,
            outputs=(("dn", "dM") if torque == "gauge" else ("dn",)) if outputs is None else outputs,
        )
        settings = {**full.settings, "three_parameters": True}
        three = replace(
            full, name=name or full.name.replace("linear", "three parameters", 1), settings=settings
        )
        return three.with_fixed(g=0.0)

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
        """Declare the ship: its nonlinear drive train in normalised terms, made of elements that act or do not.

        With N, u and M the speed, set point and torque over their operating points:

            tau_n dN/dt = M_b - N^p,                M_b = 1 + g (N - 1) + vX(t - T_d),
            vX = vK_p e + vK_i int e dt,            e = u(t - T_set) - N

        Parameters
        ----------
        elements
            Names of what acts beside this, of `structures.elements.ELEMENTS`: "dead_time_loop" (T_d),
            "dead_time_set_point" (T_set), "actuator_lag" (tau_act), "derivative" (vK_d, on the speed), "sampling" (T_s),
            "torque_limit" (M_max), "rack_rate" (rate), "twist" (tau_twist, zeta_twist; between
            the inertias, of which tau_prop is the propeller's), "damping" (of the load), "load" (measured).
        torque
            "brake": the engine's, M_b; "gauge": M_g = N^p + tau_prop dN/dt, with part of the inertia behind it.
        outputs
            Of "dn", "dM", "dX", "dE".
        products
            Declare vK_p and vK_i in place of v, K_p and K_i, which speed and torque never tell apart.
        propeller_speed
            The speed is measured behind a shaft that twists.
        mean_sampling
            A governor that samples acts as one that is half a given period T_s late, which is what records show that are
            low-passed below its clock.

        Raises
        ------
        InputError
            For an unknown element, output or torque, or what can't go together.

        Notes
        -----
        Each experiment has four unknowns of its own: its speed and its fuel's torque at the first sample, and by which
        part its set point and its torque are read wrong. Equations 3.1 to 3.11 divided by the operating point; the
        exponent p is free, 2 in the thesis.

        Examples
        --------
        >>> [parameter.name for parameter in Structure.ship(["dead_time_loop"]).free]
        ['tau_n', 'g', 'vK_p', 'vK_i', 'p', 'T_d']
        """
        if torque not in ("brake", "gauge"):
            raise InputError(f"torque {torque!r}, expected 'brake' or 'gauge'")
        for output in outputs:
            if output not in OUTPUTS:
                raise InputError(f"output {output!r}, expected some of {', '.join(OUTPUTS)}")
        if not outputs or len(set(outputs)) != len(outputs):
            raise InputError(f"outputs {list(outputs)}, expected at least one and each once")
        gauge = torque == "gauge" and "dM" in outputs
        acting = chosen(elements)
        letter = "v" if products else ""
        parameters = (
            Parameter("tau_n", "s", 1.2, 0.01, 20.0),
            Parameter("g", "-", -0.5, -10.0, 3.0),
            *(() if products else (Parameter("v", "-", 1.5, 0.01, 10.0),)),
            Parameter(f"{letter}K_p", "-", 5.0, 1e-4, 1e3),
            Parameter(f"{letter}K_i", "1/s", 5.0, 1e-4, 1e3),
            Parameter("p", "-", 2.0, -1.0, 5.0),
            *((Parameter("tau_prop", "s", 0.5, 1e-3, 20.0),) if gauge or "twist" in elements else ()),
            *(
                replace(parameter, fixed=True) if mean_sampling and element.name == "sampling" else parameter
                for element in acting
                for parameter in element.parameters
                if not (mean_sampling and parameter.name == "T_0")
            ),
        )
        words = [element.words for element in acting]
        return cls(
            name=name or ("ship" + (": " + ", ".join(words) if words else "")),
            parameters=parameters,
            signals=_signals(outputs, torque),
            equations=ShipEquations(
                tuple(outputs),
                gauge,
                propeller_speed,
                loaded=any(element.name == "load" for element in acting),
                mean_sampling=mean_sampling,
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
    def plant(
        cls,
        vessel: Vessel,
        *,
        torque: Torque = "brake",
        products: bool = True,
        free_exponent: bool = False,
        free_limit: bool = False,
        dead_time_set_point: bool = False,
        outputs: Sequence[str] = ("dn", "dM"),
        name: str | None = None,
    ) -> Structure:
        """Declare the nonlinear plant of a vessel, its torque envelope included (eq. 3.1 to 3.11).

        The parameters are those of `linear`, at the vessel's operating point; where the data cross the engine's limit
        or bend with the propeller curve, they are not biased by it as the linear structure's are. `grey_box` has the
        same plant in the vessel's own terms.

        Parameters
        ----------
        vessel
            Gives what is not searched for: operating point, gearbox, envelope, rate limits of torque and rack.
        torque, products, free_exponent, outputs
            As for `linear`; with "dX" among the outputs, v, K_p and K_i are told apart.
        free_limit
            Free the factor `limit` on the vessel's torque envelope.
        dead_time_set_point
            Free the dead time T_set; otherwise it is the vessel's.
        """
        linear = cls.linear(
            torque=torque,
            products=products,
            free_exponent=free_exponent,
            dead_time_set_point=dead_time_set_point,
            outputs=outputs,
        )
        limit = Parameter("limit", "-", 1.0, 0.5, 2.0, fixed=not free_limit)
        return cls(
            name=name or f"plant of {vessel.name}",
            parameters=(*linear.parameters, limit),
            signals=linear.signals,
            equations=PlantEquations(vessel, linear.outputs, gauge="tau_prop" in linear.names),
            settings={
                "kind": "plant",
                "vessel": vessel.model_dump(mode="json"),
                "torque": torque,
                "products": products,
                "free_exponent": free_exponent,
                "free_limit": free_limit,
                "dead_time_set_point": dead_time_set_point,
            },
        )

    @classmethod
    @checked
    def grey_box(
        cls,
        vessel: Vessel,
        free: Sequence[str],
        *,
        torque: Torque = "brake",
        outputs: Sequence[str] = ("dn", "dM"),
        pass_hz: float | None = None,
        name: str | None = None,
    ) -> Structure:
        """Declare the whole drive train of a vessel in its own terms: eq. 3.1 to 3.11 and all elements that it has.

        Parameters
        ----------
        vessel
            Gives every parameter's start, and the value of those that are not free.
        free
            Names of what is searched for, of "inertia", "propeller_inertia" [kg m2], "A1" [Nm/mm],
            "A2" [Nm/(rev/s)], "A3" [Nm], "X_0" [mm], "Kp_abs" [mm/(rev/s)], "Ki_abs" [mm/rev],
            "propeller_torque" [Nm] (at the vessel's operating speed), "torque_exponent", "gear_ratio",
            "transmission_efficiency", "limit" (factor on the torque envelope), "minimum_torque" [Nm],
            "rack_rate" [mm/s], "torque_rate" [Nm/s], "T_set" [s] (dead time of the set
            point); "fuel_dead_time", "fuel_lag" [s], "shaft_stiffness" [Nm/rad], "shaft_damping" [Nm s/rad],
            "drag_coefficient" [Nm/(rev/s)^q], "drag_exponent", "Kd_abs" [mm s/(rev/s)], "derivative_filter" [s],
            "minimum_rack", "maximum_rack", "smoke_margin" [mm], "turbocharger_lag" [s], "shaft_ripple", "blade_ripple".
            Elements need a vessel that has them.
        torque, outputs
            As for `linear`.
        pass_hz
            Compare measured and simulated outputs below this frequency [Hz]: both go through one zero-phase low-pass,
            the set point does not. Single firings, blades and the swinging shaft have phases that no fit can match.

        Raises
        ------
        InputError
            For an unknown name or output, an element that the vessel does not have, or a ship that moves.

        Notes
        -----
        Speed and torque alone do not tell A1, Kp_abs and Ki_abs apart (only the products A1 Kp_abs and A1 Ki_abs), nor
        A3 and X_0 from each other and from the initial integrated error: free one of each, or measure the fuel rack
        ("dX"). Gauge torque tells the propeller's inertia and not the total one. A limit that the data never meet has
        no influence: `identify` reports it as not identifiable. The same holds for a start so far off that it never
        acts there.

        Examples
        --------
        >>> from shipfp_rs import Vessel
        >>> launch = Vessel.load("stan-launch-804")
        >>> [parameter.name for parameter in Structure.grey_box(launch, ["inertia", "Kp_abs"]).free]
        ['inertia', 'Kp_abs']
        """
        grey_box.require_modelled(vessel)
        if pass_hz is not None and not (math.isfinite(pass_hz) and pass_hz > 0.0):
            raise InputError(f"pass_hz is {pass_hz}, expected a positive frequency [Hz], or None")
        linear = cls.linear(torque=torque, outputs=outputs)
        equations: Equations = PlantEquations(
            vessel, linear.outputs, gauge="tau_prop" in linear.names, place=as_built, whole=True
        )
        if pass_hz is not None:
            equations = PassBand(equations, pass_hz)
        return cls(
            name=name or f"grey box of {vessel.name}",
            parameters=grey_box.parameters(vessel, free),
            signals=linear.signals,
            equations=equations,
            settings={
                "kind": "grey box",
                "torque": torque,
                "vessel": vessel.model_dump(mode="json"),
                **({} if pass_hz is None else {"pass_hz": pass_hz}),
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
        """Declare a structure of one's own as x' = A x + B dn_set, y = C x + D dn_set, of any order.

        Everything that works with `linear` works with it: initial states, joint fits, frequency responses. A dead time
        needs an approximation by states, or `from_function`.

        Parameters
        ----------
        matrices
            Parameter values by name to (A, B, C, D) in continuous time [s], of shapes (n, n), (n,), (O, n), (O,).
            Written with NumPy they take complex numbers too, which makes the derivatives exact.
        parameters
            Name, unit, start, bounds of each.
        outputs
            Some of "dn", "dM", "dE", "dX", or a mapping from names of one's own to the signals that measure them.
        name
            For reports.

        Raises
        ------
        InputError
            For outputs, or shapes at the start values, that do not fit.

        Examples
        --------
        The rack follows the governor, and the shaft the rack, each with a lag of its own:

        >>> import numpy as np
        >>> def matrices(q):
        ...     A = np.array([[-1 / q["tau_rack"], 0], [1 / q["tau_shaft"], -1 / q["tau_shaft"]]])
        ...     return A, np.array([1 / q["tau_rack"], 0]), np.array([[0, 1]]), np.array([0])
        >>> two_lags = Structure.from_matrices(
        ...     matrices,
        ...     [Parameter("tau_rack", "s", 0.2, 0.01, 2), Parameter("tau_shaft", "s", 1.0, 0.01, 10)],
        ...     ["dn"],
        ...     name="two lags",
        ... )
        >>> two_lags.equations.states
        ('initial x1', 'initial x2')
        """
        signals = _own_signals(outputs)
        equations = MatrixEquations(matrices, tuple(parameters), tuple(signals))
        equations.states  # noqa: B018 the shapes are checked here, not in the middle of a fit
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
        """Declare a structure of one's own as a function that simulates an experiment.

        Derivatives are taken numerically, see `differences.Differences`. The function has the initial state in its own
        hands: what is unknown of it is a parameter. An offset of each output is estimated along as always.

        Parameters
        ----------
        simulate
            (parameter values by name, `Experiment`) to the normalised outputs, shape (O, N). Where it can't, it raises
            `SimulationError` or an ArithmeticError, or returns what is not finite, and the search turns back.
        parameters, outputs, name
            As for `from_matrices`.
        response
            (parameter values, frequencies [Hz] (F,)) to complex responses (O, F), for frequency data.

        Raises
        ------
        InputError
            For outputs that do not fit.

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
        signals = _own_signals(outputs)
        equations = FunctionEquations(simulate, tuple(parameters), tuple(signals), response)
        return cls(name, tuple(parameters), signals, equations, {"kind": "function"})

    @classmethod
    @checked
    def joint(
        cls, parts: Mapping[str, Structure], shared: Sequence[str], *, name: str | None = None
    ) -> Structure:
        """Declare one structure for trials that share some parameters: a ship at two speeds, or after a refit.

        Parameters
        ----------
        parts
            The name of an `Experiment` or `FrequencyResponse` to its structure; all with the same outputs.
        shared
            Names of the parameters that are the same for all; start, bounds and prior are the first part's. The others
            are called by their part, "tau_n (fast)"; `with_tied` relates those that are alike in some of the parts.
        name
            For reports.

        Raises
        ------
        InputError
            For fewer than two parts, other outputs, or a shared parameter that a part has not.

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
                    f"joint structure: {label!r} has ties, expected none; tie the joint structure's own"
                )
            for parameter in shared:
                _ = part[parameter]  # an unknown name is refused
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

    def part(self, name: str) -> Structure:
        """Return the structure for data of this name: itself, or of a joint one the part's, in the joint names."""
        parts = bare(self.equations)
        if self.settings["kind"] != "joint":
            return self
        return replace(self, equations=tied(parts.part(name), self.ties))  # type: ignore[attr-defined]

    def __getitem__(self, name: str) -> Parameter:
        """Return a parameter by name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise InputError(
            f"structure {self.name!r} has no parameter {name!r}; it has {', '.join(self.names)}"
            f"{hints.nearest(name, self.names)}"
        )

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.signals)

    def signal_for(self, output: str, available: Container[str], data: str) -> str:
        """Return the first signal in `available` that can stand for an output; `data` names the data in the error."""
        for candidate in self.signals[output]:
            if candidate in available:
                return candidate
        expected = ", ".join(self.signals[output])
        raise InputError(f"{data!r}: no signal for output {output!r}, expected one of {expected}")

    def measured(self, experiment: Experiment) -> Array:
        """Return the measured outputs as the equations' are to be compared with them, normalised, shape (O, N)."""
        chosen = (self.signal_for(output, experiment.signals, experiment.name) for output in self.outputs)
        rows = np.array([experiment.normalised(name) for name in chosen])
        return self.equations.passed(rows, experiment)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are estimated, those with a prior included, within bounds that suit all that follow them."""
        return tuple(
            self._within_ties(parameter)
            for parameter in self.parameters
            if not parameter.fixed and parameter.tied is None
        )

    @property
    def ties(self) -> dict[str, Tie]:
        """Tied parameters, each with what it is of one that is not."""
        return resolved({p.name: p.tied for p in self.parameters if p.tied is not None})

    def complete(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values by name in which the tied parameters follow the others."""
        return followed(values, self.ties)

    def _within_ties(self, parameter: Parameter) -> Parameter:
        lower, upper = parameter.lower, parameter.upper
        for name, tie in self.ties.items():
            if tie.to == parameter.name:
                ends = sorted((tie.inverse(self[name].lower), tie.inverse(self[name].upper)))
                lower, upper = max(lower, ends[0]), min(upper, ends[1])
        narrowed = (lower, upper) != (parameter.lower, parameter.upper)
        return replace(parameter, lower=lower, upper=upper) if narrowed else parameter

    def _with(self, name: str, **changes: Any) -> Structure:
        changed = replace(self[name], **changes)
        parameters = [changed if parameter.name == name else parameter for parameter in self.parameters]
        structure = replace(self, parameters=tuple(parameters))
        ties = structure.ties
        if not ties and not self.ties:
            return structure
        starts = structure.complete({parameter.name: parameter.start for parameter in parameters})
        for follower, tie in ties.items():
            declared = structure[follower]
            if not declared.lower <= starts[follower] <= declared.upper:
                raise InputError(
                    f"parameter {follower}: tied as {tie} it starts at {starts[follower]:g}, outside its bounds "
                    f"{declared.lower:g} to {declared.upper:g}; move the start of {tie.to} or widen the bounds first"
                )
        return replace(
            structure,
            parameters=tuple(replace(parameter, start=starts[parameter.name]) for parameter in parameters),
            equations=tied(self.equations, ties),
        )

    @checked
    def with_fixed(self, **values: float) -> Structure:
        """Return a copy with parameters held at the given values."""
        structure = self
        for name, value in values.items():
            declared = structure[name]
            too_large = declared.unit == "s" and value > 10.0 * declared.upper
            if too_large or value < 0.0 <= declared.lower:
                unit = "" if declared.unit == "-" else f" {declared.unit}"
                hint = (
                    hints.likely(value, declared.lower, declared.upper, hints.TIME_S, "s")
                    if too_large
                    else ""
                )
                raise InputError(
                    f"parameter {name}: fixed at {value:g}{unit}, expected {declared.lower:g} to {declared.upper:g}{unit}"
                    f"{hint or '; widen its bounds first'}"
                )
            structure = structure._with(name, start=float(value), fixed=True, prior=None, tied=None)
        return structure

    @checked
    def with_prior(self, **priors: tuple[float, float]) -> Structure:
        """Return a copy with Gaussian priors, each (mean, standard deviation)."""
        structure = self
        for name, (mean, std) in priors.items():
            structure = structure._with(
                name, start=float(mean), fixed=False, prior=(float(mean), float(std)), tied=None
            )
        return structure

    @checked
    def with_tied(self, **ties: tuple[str, float] | tuple[str, float, float]) -> Structure:
        """Return a copy in which parameters follow others: each (name of the other, factor) or with an offset, too.

        What is known as a ratio, such as the reset time K_p/K_i from a governor's manual, is a tie. The tied parameter is
        no unknown any more; it has the value, the interval and the status that the other one's make of it, and its
        bounds count for the other one.

        Raises
        ------
        InputError
            For an unknown name, a factor of zero, ties in a circle, or a start that the bounds do not allow.

        Examples
        --------
        >>> structure = Structure.linear(products=True).with_tied(vK_i=("vK_p", 1 / 0.42))
        >>> [parameter.name for parameter in structure.free]
        ['tau_n', 'g', 'vK_p']
        """
        structure = self
        for name, given in ties.items():
            if len(given) not in (2, 3) or not isinstance(given[0], str):
                raise InputError(
                    f"tied {name}: found {given}, expected (name, factor) or (name, factor, offset)"
                )
            tie = Tie(given[0], *map(float, given[1:]))
            if not (np.isfinite(tie.factor) and np.isfinite(tie.offset)) or tie.factor == 0.0:
                raise InputError(f"tied {name}: found {tie}, expected a finite factor that is not 0")
            _ = structure[tie.to]  # an unknown name is refused
            structure = structure._with(name, fixed=False, prior=None, tied=tie)
        return structure

    @checked
    def with_start(self, **values: float) -> Structure:
        """Return a copy with other start values."""
        structure = self
        for name, value in values.items():
            if (tie := structure[name].tied) is not None:
                raise InputError(f"parameter {name}: tied as {tie}, expected no start; give one to {tie.to}")
            structure = structure._with(name, start=float(value))
        return structure

    @checked
    def with_bounds(self, **bounds: tuple[float, ...]) -> Structure:
        """Return a copy with other bounds, each (lower, upper) or (lower, start, upper); they must hold the start."""
        structure = self
        for name, limits in bounds.items():
            if len(limits) not in (2, 3):
                raise InputError(
                    f"bounds of {name}: {limits}, expected (lower, upper) or (lower, start, upper)"
                )
            start = {"start": float(limits[1])} if len(limits) == 3 else {}
            structure = structure._with(
                name, lower=float(limits[0]), upper=float(limits[-1]), fixed=False, tied=None, **start
            )
        return structure

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form kept in a fingerprint: all that `from_dict` needs, but equations of a user's own."""
        return stored.to_dict(self)

    @classmethod
    @checked
    def from_dict(cls, content: Mapping[str, Any]) -> Structure:
        """Return the structure that `to_dict` wrote, with its starts, bounds, fixed parameters, priors and ties.

        Raises
        ------
        InputError
            For equations of a user's own, which JSON can't hold, and for what `to_dict` did not write.

        Examples
        --------
        >>> ship = Structure.ship(["dead_time_loop"]).with_fixed(p=2.1).with_prior(g=(-0.5, 0.1))
        >>> Structure.from_dict(ship.to_dict()) == ship
        True
        """
        made: Structure = stored.from_dict(cls, content)
        return made

    def __repr__(self) -> str:
        free = [parameter.name for parameter in self.free]
        names = ", ".join(free) if len(free) <= 12 else f"{', '.join(free[:10])} and {len(free) - 10} more"
        name = self.name if len(self.name) <= 60 else f"{self.name[:57]}..."
        return f"Structure({name!r}, free: {names}; outputs: {', '.join(self.outputs)})"

    def _repr_html_(self) -> str:
        return shown(
            f"Structure {self.name}",
            ["parameter", "name", "start", "from", "to", "unit", "status"],
            [
                [
                    one.name,
                    plain_name(one.name),
                    f"{one.start:.4g}",
                    *(["", ""] if one.fixed else [f"{one.lower:.4g}", f"{one.upper:.4g}"]),
                    one.unit,
                    _status(one),
                ]
                for one in self.parameters
            ],
            [f"Outputs: {', '.join(self.outputs)}"],
        )


def _status(parameter: Parameter) -> str:
    if parameter.tied is not None:
        return f"tied: {parameter.tied}"
    if parameter.prior is not None:
        return f"prior {parameter.prior[0]:.4g} ± {parameter.prior[1]:.4g}"
    return "fixed" if parameter.fixed else "free"
