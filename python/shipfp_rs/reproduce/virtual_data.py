"""Virtual trials of chapters 3 to 5: ships, set points, experiments and fitted structures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from shipfp_rs import signals
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.reproduce import fits_to
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation.simulate import Method, simulate
from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.vessel.linear_model import LinearModel, linearise
from shipfp_rs.vessel.vessel import Vessel

Discretisation = Literal["zoh", "euler"]

VESSEL = "stan-launch-804"
STEP_S = 0.01
"""Step of the thesis's simulation, inferred from the times in Table 5.1 (hundredths of a second) and from the bias of
its results.
"""
SMALL_RPM, LARGE_RPM = 13.0, 104.0
"""Amplitudes of cases ii to iv and of case v: 0.01 and 0.08 of 1300 rpm (section 5.1)."""
CHIRP_HZ, CHIRP_S = (0.0014, 20.0), 1500.0
"""Range and length of every chirp (section 5.1.2)."""
STEP_EVERY_S = 20.0
TAU_N_S = 1.442
"""True value of eq. 5.1."""
START = {"tau_n": 2.5, "g": -2.5, "v": 3.5, "K_p": 10.0, "K_i": 3.0, "vK_p": 35.0, "vK_i": 10.5}
"""Starting values of every search, eq. 5.2."""
BOUNDS = {
    "tau_n": (0.01, 5.0),
    "g": (-3.0, -0.01),
    "v": (0.01, 5.0),
    "K_p": (0.01, 15.0),
    "K_i": (0.01, 10.0),
    "vK_p": (1e-4, 75.0),
    "vK_i": (1e-4, 50.0),
}
"""Bounds of every search, eq. 5.3 to 5.7."""
POINT_STD = 1e-3
"""Assumed standard deviation of a settled sine, relative to its output's root mean square over the frequencies."""
ACCURATE_RATE_HZ = 50.0
"""Sample rate of accurate data; plant and model interpolate the set point between samples in the same way."""
SAMPLES_A_PERIOD = 400
"""Samples per period of accurate data; linear interpolation between them reduces a sine by 2e-5."""
SUBSTEPS = 30
"""Integration steps per sample of the fitted plant; without noise, the error of the kernel's 4 ms step would matter."""
SETTLED = 22.0
"""Settling time of a sine, in time constants of the slowest pole; the transient is then e^-22 = 3e-10."""


def launch() -> Vessel:
    """Return the virtual ship of the vessel file; with its gearbox losses, tau_n is 1.514 s."""
    return Vessel.load(VESSEL)


def launch_of_the_thesis() -> Vessel:
    """Return the ship with the true values of eq. 5.1, including tau_n 1.442 s."""
    # Without gearbox losses, M_s0 is 3 x 222.93 Nm and eq. 3.23 gives tau_n 1.438 s.
    # The thesis does not explain the remaining 0.25 %, which are added to the inertia.
    lossless = launch().replace({"gearbox.efficiency": 1.0})
    inertia = lossless.shaft.inertia_kg_m2 * TAU_N_S / linearise(lossless).tau_n
    return lossless.replace({"shaft.inertia_kg_m2": inertia})


def excitation(case: str, rate_hz: float = 1.0 / STEP_S) -> Excitation:
    """Return the set point of a fitted case of Table 5.2."""
    if case == "ii":
        return signals.published_sine_sequence(SMALL_RPM, rate_hz=rate_hz)
    amplitude_rpm = LARGE_RPM if case == "v" else SMALL_RPM
    law: signals.Law = "linear" if case == "iii" else "logarithmic"
    return signals.chirp(*CHIRP_HZ, CHIRP_S, amplitude_rpm, law, rate_hz=rate_hz)


def trial(vessel: Vessel, case: str, method: Method = "rk4", *, limits: bool = True) -> Experiment:
    """Return the data of a fitted case of Table 5.2."""
    rate_hz = 1.0 / STEP_S if method == "euler" else ACCURATE_RATE_HZ
    return run(vessel, excitation(case, rate_hz), method, limits=limits)


def run(vessel: Vessel, set_point: Excitation, method: Method = "rk4", *, limits: bool = True) -> Experiment:
    """Simulate accurately, or as the thesis does: by forward Euler with the set point held over each step."""
    held = replace(set_point, hold="zero") if method == "euler" else set_point
    return simulate(vessel, held, method=method, limits=limits)


def validation_steps(
    vessel: Vessel, method: Method = "rk4", *, size: float = 0.05, limits: bool = True
) -> Experiment:
    """Return the response to three steps of `size` times the operating speed, every 20 s from 20 s on (section 5.1.3)."""
    step_rpm = size * vessel.operating_point.n_e_rpm
    steps = signals.steps([step_rpm] * 3, STEP_EVERY_S, lead_s=STEP_EVERY_S, rate_hz=1.0 / STEP_S)
    return run(vessel, steps, method, limits=limits)


def settled_response(vessel: Vessel, method: Method = "rk4", *, limits: bool = True) -> FrequencyResponse:
    """Return the plant's response to each sine of Table 5.1, from one whole period after the transient."""
    # Equal relative standard deviations give speed and torque equal influence, like the "Output Weight" of section 5.2.
    sequence = signals.published_sine_sequence()
    frequency = np.array([segment.frequency_hz for segment in sequence.segments])
    settling_s = SETTLED / np.abs(linearise(vessel).poles).min()
    names = ("n_set", "n_e", "M_b", "E_n")
    lines: list[list[complex]] = []
    for value in frequency:
        # Euler's step is fixed; the periods of Table 5.1 are multiples of it.
        samples = round(1.0 / (value * STEP_S)) if method == "euler" else SAMPLES_A_PERIOD
        periods = math.ceil(settling_s * value) + 1
        sine = signals.sine_sequence([value], periods, SMALL_RPM, rate_hz=samples * value)
        experiment = run(vessel, sine, method, limits=limits)
        # A sine fit over a whole period equals a line of the Fourier transform.
        lines.append([np.fft.rfft(experiment.normalised(name)[-samples:])[1] for name in names])
    set_point, *answers = np.array(lines).T
    response = {name: answer / set_point for name, answer in zip(names[1:], answers, strict=True)}
    deviation = {
        name: POINT_STD * np.sqrt(np.mean(np.abs(points) ** 2)) / np.abs(points)
        for name, points in response.items()
    }
    return FrequencyResponse("settled sines", frequency, response, deviation, deviation)


def searched_as_printed(structure: Structure) -> Structure:
    """Return the structure with the start and bounds of section 5.4."""
    names = [parameter.name for parameter in structure.free]
    # Start and bounds are set in one call, since new bounds might exclude the old start.
    return structure.with_bounds(**{name: (BOUNDS[name][0], START[name], BOUNDS[name][1]) for name in names})


def thesis_structure() -> Structure:
    """Return the structure of section 5.3."""
    return searched_as_printed(Structure.linear(name="linear"))


def sampled_structure(discretisation: Discretisation) -> Structure:
    """Return the structure of section 5.3 with the frequency response of its exact or forward Euler discretisation."""
    linear = thesis_structure()

    def response(values: Mapping[str, Any], frequency_hz: Array) -> ComplexArray:
        sampled = LinearModel(**values, tau_prop=0.0).state_space().to_discrete(STEP_S, discretisation)
        z = np.exp(2j * np.pi * frequency_hz * STEP_S)[:, None, None]
        states = np.linalg.solve(z * np.eye(2) - sampled.A, sampled.B)
        return np.asarray((sampled.C @ states + sampled.D)[:, :, 0].T, dtype=np.complex128)

    name = {"zoh": "linear, sampled exactly", "euler": "linear, sampled by Euler"}[discretisation]
    outputs = {"dn": "n_e", "dM": "M_b"}
    return Structure.from_function(
        linear.equations.simulate, linear.parameters, outputs, name=name, response=response
    )


def plant_structure(vessel: Vessel) -> Structure:
    """Return the nonlinear plant with a vessel's torque envelope and the linear structure's parameters (eq. 3.1 to 3.11)."""
    ship = Structure.ship(name="plant").with_fixed(p=2.0)
    assert isinstance(ship.equations, ShipEquations)
    speed, torque = vessel.envelope()
    points = np.stack([speed / vessel.nominal_engine_speed, torque / vessel.nominal_brake_torque], axis=1)
    envelope = tuple((n, M) for n, M in points.tolist())
    return replace(
        ship,
        equations=replace(ship.equations, envelope=envelope, substeps=SUBSTEPS),
        settings={"kind": "plant"},
    )


def shown(values: Mapping[str, float]) -> dict[str, float]:
    """Return the four parameters of Table 5.2 from the parameters of a structure or a model."""
    vK_p, vK_i = (values[f"vK_{k}"] if f"vK_{k}" in values else values["v"] * values[f"K_{k}"] for k in "pi")
    return {"tau_n": values["tau_n"], "g": values["g"], "K_p/K_i": vK_p / vK_i, "vK_p": vK_p}


def model_of(figures: Mapping[str, float | None]) -> LinearModel:
    """Return the linear model of the four parameters of Table 5.2; v is 1, since only its products with the gains matter."""
    tau_n, g, vK_p, ratio = (float(figures[name] or 0.0) for name in ("tau_n", "g", "vK_p", "K_p/K_i"))
    return LinearModel(tau_n=tau_n, g=g, v=1.0, K_p=vK_p, K_i=vK_p / ratio, p=2.0, tau_prop=0.0)


def fit_pct(structure: Structure, values: Mapping[str, float], experiment: Experiment) -> dict[str, float]:
    """Return the fit of a structure, simulated from rest, to an experiment: "dn" and "dM" [%] (eq. 4.9)."""
    rows = structure.equations.simulate(values, experiment)
    names = {out: structure.signal_for(out, experiment.signals, experiment.name) for out in structure.outputs}
    fits = fits_to(experiment, dict(zip(names.values(), rows, strict=True)))
    return {output: fits[name] for output, name in names.items()}


def euler_bias(model: LinearModel, step_s: float = STEP_S) -> float:
    """Return the tau_n that an exact model estimates from forward Euler data: tau h a / -ln(1 - h a)."""
    # a = (p - g + v K_p)/tau_n is approximately the fast pole.
    # Per step h, Euler multiplies the fast mode by 1 - h a; an exact model reads this as exp(-h a'), with a' tau' = a tau.
    a = (model.p - model.g + model.v * model.K_p) / model.tau_n
    return float(model.tau_n * step_s * a / -math.log1p(-step_s * a))
