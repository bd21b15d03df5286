"""The two equations beside the stepper, at the truth and without noise.

    python -m tests.identification.parity

For each ship and set point: what is left of speed and torque, over the signal. Images are taken off records that are not
low-passed, and gaps are filled by the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

import shipfp_rs as fp
from shipfp_rs import _core
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.question import Options, question_of
from shipfp_rs.identification.ship_found import DEFAULTS
from shipfp_rs.identification.structure_fit import StructureQuestion, likelihood_of
from shipfp_rs.structures.elements import LATE_CHANNELS
from shipfp_rs.structures.ship import INDEX, KERNEL
from shipfp_rs.structures.structure import Structure

SHIP = {
    "tau_n": 1.2,
    "g": -0.5,
    "vK_p": 4.5,
    "vK_i": 10.0,
    "p": 2.15,
    "tau_prop": 0.38,
    "T_d": 0.07,
    "T_set": 0.3,
}
FINE_HZ = 1000.0
BETWEEN_S = 0.0005
"""First sample of a governor that samples [s], between those of the simulation."""
BARE = dict.fromkeys(("tau_act", "T_f", "tau_eng", "c_2", "T_M", "T_B", "T_s", "T_d", "T_set"), 0.0)


@dataclass(frozen=True)
class Case:
    """A ship, what it is driven by, and how it is recorded."""

    amplitude: float = 0.06
    own: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 300.0
    rate_hz: float = 50.0
    between: str = "band-limited"
    gap_s: float = 0.0
    gauge: bool = True
    excitation: str = "chirp"
    propeller: bool = False
    both: bool = False
    wake: float = 0.0


CASES = {
    **{f"amplitude {a:g}": Case(a) for a in (0.03, 0.15)},
    "brake": Case(gauge=False),
    "lag": Case(own={"tau_act": 0.1}),
    **{f"sampling, {T:g} s": Case(own={"T_s": T, "T_0": BETWEEN_S, "T_d": 0.4 * T}) for T in (0.01, 0.05)},
    "sampling, 0.05 s, no dead time": Case(
        own={"T_s": 0.05, "T_0": BETWEEN_S, "T_d": 0.0, "T_set": 0.0}, gauge=False
    ),
    "sampling, 0.05 s, lag": Case(own={"T_s": 0.05, "T_0": BETWEEN_S, "T_d": 0.02, "tau_act": 0.05}),
    "engine lag": Case(own={"tau_eng": 0.2, "tau_act": 0.05}),
    "engine lag, sampling": Case(
        own={"T_s": 0.05, "T_0": BETWEEN_S, "T_d": 0.02, "tau_eng": 0.1}, gauge=False
    ),
    "curvature": Case(own={"c_2": 0.4}),
    "damping": Case(own={"damping": 0.5}),
    "derivative": Case(own={"vK_d": 0.2}),
    "late torque": Case(own={"T_M": 0.02}),
    "late speed": Case(own={"T_n": 0.02}),
    "twist": Case(own={"tau_twist": 0.004, "zeta_twist": 0.5}),
    "twist, brake": Case(own={"tau_twist": 0.02, "zeta_twist": 2.0}, gauge=False),
    "propeller's speed": Case(own={"tau_twist": 0.02, "zeta_twist": 0.5}, propeller=True),
    "both torques": Case(both=True),
    "both torques, twist, lag": Case(
        both=True, own={"tau_twist": 0.02, "zeta_twist": 0.5, "tau_act": 0.1, "T_M": 0.01, "T_B": 0.01}
    ),
    "both torques, gaps of 0.2 s": Case(both=True, gap_s=0.2, own={"T_M": 0.01, "T_B": 0.01}),
    "dead times at their bounds": Case(own={"T_d": 0.6, "T_set": 2.0, "vK_p": 1.5, "vK_i": 1.0}),
    "24 s": Case(seconds=24.0),
    "steps": Case(excitation="steps"),
    "straight, 50 Hz, lag": Case(between="straight", own={"tau_act": 0.05}),
    "held, 50 Hz": Case(between="held"),
    "straight, 20 Hz": Case(between="straight", rate_hz=20.0),
    "straight, 20 Hz, lag": Case(between="straight", rate_hz=20.0, own={"tau_act": 0.05}),
    "held, 20 Hz": Case(between="held", rate_hz=20.0),
    "held, 20 Hz, lag 0.1 s": Case(between="held", rate_hz=20.0, own={"tau_act": 0.1}),
    "held, 20 Hz, brake": Case(between="held", rate_hz=20.0, gauge=False),
    **{f"gaps of {gap:g} s": Case(gap_s=gap) for gap in (0.2, 2.0)},
}


def excitation(case: Case, t: np.ndarray) -> np.ndarray:
    """Deviation of the set point."""
    if case.excitation == "steps":
        return case.amplitude * np.sign(np.sin(2 * np.pi * t / 24.0))
    first, last = max(0.004, 1.0 / case.seconds), 4.0
    growth = np.log(last / first) / case.seconds
    return case.amplitude * np.sin(2 * np.pi * first * np.expm1(growth * t) / growth)


def wake(case: Case, count: int) -> np.ndarray:
    """Load torque of moving water, 0.05 to 1.5 Hz, that no channel records."""
    hz = np.fft.rfftfreq(count, 1.0 / FINE_HZ)
    turns = np.exp(2j * np.pi * np.random.default_rng(4).random(len(hz)))
    waves = np.fft.irfft(np.where((hz > 0.05) & (hz < 1.5), turns, 0.0), count)
    return np.asarray(case.wake * waves / waves.std())


def simulated(case: Case) -> tuple[dict[str, float], fp.Experiment]:
    """Return truth and record of a case."""
    truth = {**SHIP, **case.own}
    every = round(FINE_HZ / case.rate_hz)
    count = round(case.seconds * case.rate_hz)
    fine = np.arange(count * every) / FINE_HZ
    coarse = excitation(case, np.arange(count) / case.rate_hz)
    if case.between == "band-limited":
        u = excitation(case, fine)
    elif case.between == "straight":
        u = np.interp(fine, np.arange(count) / case.rate_hz, coarse)
    else:
        u = np.repeat(coarse, every)
    hold = "zero" if case.between == "held" else "first"
    parameters = np.array(_core.SHIP_OFF)
    parameters[[INDEX["v"], INDEX["load_gain"]]] = 1.0
    for name, value in truth.items():
        if name != "T_B":  # as late as the gauge
            parameters[INDEX[KERNEL.get(name, name)]] = value
    torques = ["dM_g", "dM_b"] if case.both else ["dM_g" if case.gauge else "dM_b"]
    speed_name = "dn_prop" if case.propeller else "dn"
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in (speed_name, *torques)]
    water = wake(case, len(fine)) if case.wake else np.empty(0)
    y = _core.simulate_ship(parameters, 1.0 + u, water, 1.0 / FINE_HZ, 2, hold, outputs)
    if case.between == "band-limited" and (case.excitation != "chirp" or "T_s" in case.own):
        taps = fp_low_pass(case.rate_hz)
        u, *y = (np.convolve(np.pad(row, len(taps) // 2, mode="edge"), taps, "valid") for row in (u, *y))
        coarse = np.asarray(u)[::every]
    speed, *moments = (1.0 + np.asarray(row)[::every] for row in y)
    if case.gap_s:
        length = max(1, round(case.gap_s * case.rate_hz))
        for start in np.linspace(0.1, 0.9, 8) * count:
            for moment in moments:
                moment[int(start) : int(start) + length] = np.nan
            speed[int(start + count / 20) : int(start + count / 20) + length] = np.nan
    signals = {"n_set": (1.0 + coarse) * 1000.0, "n_e": speed * 1000.0}
    signals |= {name.removeprefix("d"): 1000.0 * row for name, row in zip(torques, moments, strict=True)}
    point = dict.fromkeys(signals, 1000.0)
    if every_s := truth.pop("T_s", 0.0):
        # Half a period is dead time, the sum that is used before it is renewed is half a period late.
        del truth["T_0"]
        truth["T_d"] += 0.5 * every_s
        truth |= {"T_s": every_s, "vK_p": truth["vK_p"] - 0.5 * every_s * truth["vK_i"]}
    return truth, fp.Experiment("parity", case.rate_hz, signals, operating_point=point, hold=hold)


def fp_low_pass(rate_hz: float) -> np.ndarray:
    """Low-pass of a record whose set point jumps."""
    from scipy.signal import firwin

    return np.asarray(firwin(1001, 0.4 * rate_hz, window=("kaiser", 9.0), fs=FINE_HZ))


def left(case: Case) -> dict[str, float]:
    """Return what the two equations leave of each output at the truth, over its signal."""
    return _left(*at_the_truth(case))


def engine_residual(case: Case) -> tuple[float, float]:
    """Return what is left of the torque, and of the engine's own equation, in moving water, over the torque's signal."""
    truth, _ = simulated(case)
    likelihood, vector = at_the_truth(case)
    record, (speed, torque) = likelihood.records[0], likelihood.residuals(vector)[0]
    s = 2j * np.pi * record.frequency_hz[1:]
    way = np.exp(-s * truth["T_d"]) / (1.0 + s * truth.get("tau_act", 0.0))
    ahead = truth["tau_n"] - truth["tau_prop"] if case.gauge else 0.0
    governed = ahead * s - truth["g"] + (truth["vK_p"] + truth["vK_i"] / s) * way
    engine, torque = torque[1:] + governed * speed[1:], torque[1:]
    kept = record.frequency_hz[1:] > 0.05
    signal = np.linalg.norm(record.spectrum[1, 1:])
    return float(np.linalg.norm(torque[kept]) / signal), float(np.linalg.norm(engine[kept]) / signal)


def at_the_truth(case: Case) -> tuple[Likelihood, np.ndarray]:
    """Return the likelihood of a case's record, and the search vector of its true parameters."""
    truth, experiment = simulated(case)
    if case.propeller:
        elements = ("dead_time_loop", "dead_time_set_point", "twist")
        structure = Structure.ship(elements, torque="gauge", propeller_speed=True)
        likelihood = likelihood_of(StructureQuestion((experiment,), structure, Options()))[1]
        (model,) = likelihood.models
        model = replace(model, record=model.record.running("band-limited"))
        return replace(likelihood, models=(model,)), likelihood.coordinates.vector(truth)
    fixed = {"damping": truth["damping"]} if "damping" in truth else {}
    question = question_of(
        [experiment],
        torque="gauge" if case.gauge else "brake",
        outputs=["dn", "M_g", "M_b"] if case.both else None,
        elements={
            name: True
            for name in ("derivative", "damping", "late_speed", "twist")
            if ELEMENT[name] & set(case.own)
        },
        fixed=fixed,
        priors={name: (0.0, 0.02) for name in LATE_CHANNELS if name in case.own},
    )
    likelihood = question.likelihood(case.between)
    vector = likelihood.coordinates.vector({**DEFAULTS, **BARE, "vK_d": 0.0, "T_n": 0.0, **truth})
    return likelihood, vector


def _left(likelihood: Likelihood, vector: np.ndarray) -> dict[str, float]:
    likelihood = likelihood.corrected(vector)
    record, residual = likelihood.records[0], likelihood.residuals(vector)[0]
    return {
        output: float(np.linalg.norm(row) / np.linalg.norm(record.spectrum[index, 1:]))
        for index, (output, row) in enumerate(zip(record.outputs, residual, strict=True))
    }


ELEMENT = {
    "derivative": {"vK_d"},
    "damping": {"damping"},
    "late_speed": {"T_n"},
    "twist": {"tau_twist"},
}


def main() -> None:
    """Print the table."""
    print(f"{'case':30} {'speed':>9} {'torque':>9} {'brake':>9}")
    for name, case in CASES.items():
        row = left(case)
        print(f"{name:30}", *(f"{value:9.1e}" for value in row.values()), flush=True)


if __name__ == "__main__":
    main()
