"""Design of a trial: the most informative set point within limits, its expected accuracy, and the time needed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from shipfp_rs.designs.plan import Needed, Plan, Stretch, needed_for, run_sheet
from shipfp_rs.designs.spectrum import SINE, SQUARE, Criterion, candidates, support
from shipfp_rs.designs.subject import Noise, Prediction, Subject, predict, quantities, sensors_of, spread
from shipfp_rs.designs.waveforms import TOP_HZ, Generator, Kind, Limits, Setting, settling, waveform
from shipfp_rs.errors import InputError
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.state_space import LinearEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import accuracy, checked, positive
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel

__all__ = [
    "Criterion",
    "Generator",
    "Kind",
    "Limits",
    "Needed",
    "Noise",
    "Plan",
    "Prediction",
    "Stretch",
    "Subject",
    "design",
    "predict",
]

CANDIDATES = 120
"""Number of candidate frequencies of the optimal spectrum, on a logarithmic scale."""
FIRST_S = 300.0
"""Initial duration in the search for the time needed."""
LONGEST_S = 6.0 * 3600.0
"""Longest duration of a trial; an accuracy that needs more is rejected."""
LEAST_PART = 1e-6
"""Least amplitude relative to the operating speed; less than the resolution of any set-point input."""
SHORTEST_S = 60.0
ROUNDS = 8


@checked
def design(
    expected: Vessel | Fingerprint | str | Path,
    *,
    amplitude_rpm: float | None = None,
    duration_s: float | None = None,
    accuracy_pct: float | None = None,
    parameters: Sequence[str] | None = None,
    kind: Literal["sines", "squares", "multisine", "chirp", "mix"] = "mix",
    criterion: Literal["D", "A"] = "D",
    structure: Structure | None = None,
    sensors: Mapping[str, Noise] | None = None,
    n_e_rpm: float | None = None,
    rate_rpm_s: float | None = None,
    avoid_hz: Sequence[tuple[float, float]] = (),
    lowest_hz: float | None = None,
    highest_hz: float | None = None,
    longest_samples: int | None = None,
    generator: Generator | None = None,
    settle_s: float = 10.0,
    draws: Draws | None = None,
) -> Plan:
    """Plan a trial: the most informative set point within limits, and the expected accuracy.

    Parameters
    ----------
    expected
        Expected ship: a `Vessel`, its name or file, or an earlier `Fingerprint` or its file. A design is optimal for the
        expected parameters and nearly optimal for similar ones.
    amplitude_rpm
        Largest deviation of the set point [rpm of the engine]; None: 3 % of the operating speed.
    duration_s
        Duration of the whole time series [s]; None: as long as `accuracy_pct` requires.
    accuracy_pct
        Accuracy to reach: largest relative standard deviation of each of `parameters` [%].
    parameters
        Names of parameters or combinations that must reach `accuracy_pct`; None: all that the response to small
        deviations determines.
    kind
        "sines" (in sequence), "squares" (square waves in sequence, the most informative for a given amplitude, if sudden
        changes are permitted), "multisine" (simultaneous sines with a low crest factor), "chirp" (over the most
        informative range) or "mix" (sines, a chirp, and steps for validation).
    criterion
        "D": smallest volume of the confidence ellipsoid; "A": smallest sum of the relative variances of all identifiable
        quantities.
    structure
        Structure to identify; None: the full ship from speed and gauge torque, or the fingerprint's structure.
    sensors
        `Noise` of each signal; default: 0.3 % of the operating speed and 1 % of the torque, flat up to 10 Hz, with an
        accuracy of 0.3 % each.
    n_e_rpm
        Operating point of a vessel [rpm]; None: that of the vessel.
    rate_rpm_s
        Largest rate of change of the set point [rpm/s]; None: unlimited.
    avoid_hz
        Bands (low, high) around resonances [Hz], which the set point does not excite.
    lowest_hz, highest_hz
        Lowest and highest frequency of the set point [Hz]; None: two periods in the available time, and 5 Hz.
    longest_samples
        Longest waveform that fits the signal generator.
    generator
        Calibration and range of the generator; None: the vessel's set-point line if it declares one.
    settle_s
        Time at the operating point before, between and after the waveform's parts [s].
    draws
        Draws of the earlier fingerprint; the plan then also gives the accuracy for the first 30 of these ships.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If arguments are out of range, or no trial is possible within the limits.

    Notes
    -----
    Information of a line: L. Ljung, System Identification, 2nd ed., section 13.3. Optimal shares are computed by the
    multiplicative algorithm, see `spectrum.optimal_shares`, for small deviations, where the ship is linear. Standard
    deviations follow from the likelihood of `identify` at the expected values, for a simulated record of the whole time
    series.

    Examples
    --------
    >>> plan = design("stan-launch-804", amplitude_rpm=13.0, duration_s=120.0, kind="sines")
    >>> plan.excitation.amplitude_rpm <= 13.0
    True
    """
    if duration_s is None and accuracy_pct is None:
        raise InputError("neither duration_s nor accuracy_pct is given, expected at least one")
    if accuracy_pct is None and parameters is not None and len(parameters):
        raise InputError(
            "parameters: found without accuracy_pct, expected accuracy_pct, the accuracy of these parameters"
        )
    if duration_s is not None:
        positive("duration_s", duration_s)
    if accuracy_pct is not None:
        accuracy(accuracy_pct)
    if not (math.isfinite(settle_s) and settle_s >= 0.0):
        raise InputError(f"settle_s is {settle_s}, expected zero or more")
    subject = Subject.of(expected, structure, n_e_rpm)
    set_point = subject.operating_point["n_set"]
    limits = Limits(
        0.03 * set_point if amplitude_rpm is None else amplitude_rpm,
        rate_rpm_s,
        tuple(avoid_hz),
        lowest_hz,
        highest_hz,
        longest_samples,
    )
    if not LEAST_PART * set_point <= limits.amplitude_rpm < set_point:
        raise InputError(
            f"amplitude_rpm is {limits.amplitude_rpm:g}, expected {LEAST_PART * set_point:.2g} rpm or more, and less than "
            f"the operating speed {set_point:g}"
        )
    if kind == "squares" and (limits.avoid_hz or limits.rate_rpm_s is not None):
        raise InputError(
            "kind 'squares' jumps and has harmonics, expected neither avoid_hz nor rate_rpm_s with it; choose 'sines'"
        )
    noises = sensors_of(sensors, subject.signals)
    if generator is None and subject.vessel is not None and subject.vessel.set_point is not None:
        generator = Generator(subject.vessel.set_point.calibration)
    if generator is not None:
        # Raises an error if the generator can't reach the largest deviations.
        generator.volts(set_point + limits.amplitude_rpm * np.array([-1.0, 1.0]))

    def made(duration: float) -> Plan:
        return _plan(subject, kind, criterion, limits, noises, generator, duration, settle_s)

    if duration_s is not None:
        plan = made(duration_s)
        plan = plan if accuracy_pct is None else _judged(plan, made, accuracy_pct, parameters)
    else:
        assert accuracy_pct is not None
        plan = _long_enough(made, accuracy_pct, parameters, max(SHORTEST_S, 3.0 * settling(kind, settle_s)))
    if draws is None:
        return plan
    return dataclasses.replace(plan, spread=spread(subject, plan.excitation, noises, draws))


def _plan(
    subject: Subject,
    kind: Kind,
    criterion: Criterion,
    limits: Limits,
    sensors: Mapping[str, Noise],
    generator: Generator | None,
    duration_s: float,
    settle_s: float,
) -> Plan:
    rate = limits.sample_rate(duration_s)
    frequency = np.geomspace(*limits.span(duration_s, rate), CANDIDATES)
    frequency = frequency[limits.outside(frequency)]
    fewest = max(len(subject.free), 3)
    if len(frequency) < fewest:
        raise InputError(
            f"the bands of avoid_hz {list(limits.avoid_hz)} leave {len(frequency)} of {CANDIDATES} candidate frequencies, "
            f"expected at least {fewest}; narrow the bands"
        )
    shape = SQUARE if kind == "squares" else SINE
    lines = candidates(subject, sensors, frequency, limits.amplitude_at(frequency), rate, shape)
    setting, efficiency = Setting.of(lines, limits, criterion, rate)
    excitation = waveform(kind, setting, duration_s, settle_s)
    prediction = predict(subject, excitation, sensors)
    designed_for = tuple(quantities(subject, lines.sensitivity))
    return Plan(
        subject.name,
        kind,
        criterion,
        excitation,
        tuple(
            (float(line), float(share)) for line, share in zip(*support(lines, setting.shares), strict=True)
        ),
        efficiency,
        designed_for,
        prediction,
        None,
        run_sheet(excitation, prediction.experiment),
        subject.operating_point["n_set"],
        sensors,
        limits,
        generator,
        _notes(subject, limits, rate, prediction, designed_for),
        {},
    )


def _notes(
    subject: Subject,
    limits: Limits,
    rate_hz: float,
    prediction: Prediction,
    designed_for: Sequence[str],
) -> tuple[str, ...]:
    notes = []
    told = {**prediction.parameters, **prediction.derived}
    unknown = [name for name, row in told.items() if row.status == "unidentifiable"]
    if unknown:
        notes.append(f"The record will not determine {', '.join(unknown)} by themselves.")
    bent = [one for one in subject.free if one not in designed_for and one not in unknown]
    if bent:
        notes.append(
            f"Small motions determine only {', '.join(designed_for)}, for which the design is. "
            f"{', '.join(bent)} follow from the curvature of the propeller's law alone: a larger amplitude helps, more "
            "time hardly."
        )
    weak = [
        f"{name} ({value:.0f} %)"
        for name, value in prediction.relative_pct.items()
        if value > 50.0 and told[name].status == "free"
    ]
    if weak:
        notes.append(
            f"Hardly determined, with the standard deviation over the value: {', '.join(weak)}; intervals will be skewed."
        )
    if limits.longest_samples is not None and limits.highest_hz is None and rate_hz < 10.0 * TOP_HZ:
        notes.append(
            f"The generator's {limits.longest_samples} samples allow {rate_hz:g} Hz, and so nothing above "
            f"{rate_hz / 10.0:g} Hz."
        )
    limit = _torque_limit(subject, prediction)
    if limit:
        notes.append(limit)
    return tuple(notes)


def _torque_limit(subject: Subject, prediction: Prediction) -> str:
    """Warning if the linear response exceeds the engine's torque envelope; else empty."""
    vessel = subject.vessel
    if vessel is None or "g" not in subject.values or not len(vessel.envelope()[0]):
        return ""
    speeds, torques = vessel.envelope()
    experiment = prediction.experiment
    model = linearise(vessel, subject.operating_point["n_set"])
    dn, brake = LinearEquations(("dn", "dM"), gauge=False).simulate(dataclasses.asdict(model), experiment)
    speed = subject.operating_point["n_e"] / 60.0 * (1.0 + dn)
    excess = subject.operating_point["M_b"] * (1.0 + brake) / np.interp(speed, speeds, torques)
    if excess.max() <= 1.0:
        return ""
    return (
        f"The engine's torque limit would be exceeded by {100.0 * (excess.max() - 1.0):.0f} %: beyond it the ship is not "
        "linear and the predictions are not valid; lower the amplitude or the rate of change."
    )


def _wanted(plan: Plan, parameters: Sequence[str] | None) -> tuple[str, ...]:
    known = tuple(plan.prediction.relative_pct)
    usual = tuple(name for name in plan.designed_for if name in known) or known
    chosen = tuple(parameters) if parameters else usual
    for name in chosen:
        if name not in known:
            raise InputError(
                f"parameters: {name!r} is not identifiable here, expected some of {', '.join(known)}"
            )
    return chosen


def _judged(
    plan: Plan, made: Callable[[float], Plan], accuracy_pct: float, parameters: Sequence[str] | None
) -> Plan:
    duration = plan.excitation.duration
    later = made(2.0 * duration).prediction.relative_pct
    now = plan.prediction.relative_pct
    needed = needed_for(accuracy_pct, now, later, _wanted(plan, parameters), duration)
    return dataclasses.replace(plan, needed=needed)


def _long_enough(
    made: Callable[[float], Plan], accuracy_pct: float, parameters: Sequence[str] | None, shortest_s: float
) -> Plan:
    """Shortest plan that meets the accuracy, to about 10 %."""
    duration, best = max(FIRST_S, shortest_s), None
    for _ in range(ROUNDS):
        plan = _judged(made(duration), made, accuracy_pct, parameters)
        assert plan.needed is not None
        if plan.needed.met:
            best = plan if best is None or plan.excitation.duration < best.excitation.duration else best
            if plan.needed.duration_s > 0.9 * duration or duration <= shortest_s:
                break
        # The estimate assumes that information grows with the duration; settling time adds none, so it is not exact.
        duration = max(1.03 * plan.needed.duration_s, shortest_s)
        if duration > LONGEST_S:
            time = f"about {duration / 3600.0:.3g} h" if math.isfinite(duration) else "for ever"
            raise InputError(
                f"accuracy_pct is {accuracy_pct:g}, {plan.needed.limited_by} would take {time}, expected at most "
                f"{LONGEST_S / 3600.0:g} h; raise the amplitude, calibrate better, or give only the important parameters"
            )
    if best is None:
        raise InputError(
            f"accuracy_pct is {accuracy_pct:g}: no duration found that meets it; give duration_s"
        )
    return best
