"""Poles, margins, bandwidth and recovery of the identified speed loop, each with its standard deviation.

This module also rebuilds a fingerprint's structure and its frequency response.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from shipfp_rs.errors import InputError
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.estimate import with_interval
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identifiability import gradient_of
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.structures.elements import LATE_CHANNELS
from shipfp_rs.structures.linearised import StateSpace, loop_of, require_linear, state_space
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.transfer import drooped
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, ComplexArray, Values
from shipfp_rs.support.sentences import Sentence


@checked
def predict_response(
    fingerprint: Fingerprint,
    measured: FrequencyResponse,
    points: int = 200,
    structure: Structure | None = None,
) -> FrequencyResponse:
    """Return the fitted model's response at `points` frequencies over the measured range.

    Raises
    ------
    InputError
        See `predict`.
    """
    structure = structure or structure_of(fingerprint)
    signals = tuple(
        structure.signal_for(output, measured.response, measured.name) for output in structure.outputs
    )
    frequency = np.geomspace(0.8 * measured.frequency_hz.min(), 1.25 * measured.frequency_hz.max(), points)
    own = structure.part(measured.name).equations
    response, _ = own.response(fingerprint.optimum, frequency, ())
    return FrequencyResponse(structure.name, frequency, dict(zip(signals, response, strict=True)))


def structure_of(fingerprint: Fingerprint) -> Structure:
    """Rebuild the structure of a fingerprint.

    Raises
    ------
    InputError
        If the structure's equations are the user's code, which a file can't contain.
    """
    try:
        return Structure.from_dict(fingerprint.structure)
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        name = fingerprint.structure.get("name")
        raise InputError(
            f"structure {name!r} of the fingerprint can't be rebuilt, {type(error).__name__.removesuffix('Error').lower()} "
            f"at {error}; expected the file as `shipfp run` wrote it"
        ) from error


TOLD = 1e-4
"""Relative change along an undetermined direction of the parameters up to which a figure counts as determined."""
PADE = 5
SLOWEST = 5
"""Number of roots of the Pade approximation that are refined to exact poles: two, their conjugates, and one in reserve."""
SETTLED = 1e-3
"""Largest relative change of a pole in the last step of Newton's method, for the method to have converged."""
SEARCHED_HZ = np.geomspace(1e-4, 1e2, 1200)
RECOVERED = 0.05
"""Band, relative to a step of the set point, within which the speed has recovered."""
LONGEST = 8.0
"""Duration of a step response, in time constants of the slowest pole."""
INSTANTS = 4000
LEADING = 1e-6
"""Phase [turns] below which a phase is a rounding error and counts as zero."""
LARGEST = 2.0
"""Relative standard deviation above which a figure is undetermined; its 95 % interval would span a factor of
50 either way.
"""
STRAIGHT = 0.2
"""Largest relative standard deviation for which a figure's interval is propagated linearly; above it, the
interval is the range over the parameter sets that the profile likelihoods found compatible with the data.
"""
LEAST = {"phase margin": -np.inf, "overshoot": 0.0, "dM_b(0)": -np.inf, "dM_g(0)": -np.inf}
"""Least values of figures that may be zero or change sign; intervals of all others are symmetric in the logarithm."""
ENDLESS = ("gain margin", "ultimate gain")
"""Figures that are infinite for some loops, such as the gain margin of a loop without a phase crossing."""
SAME = {"dM_b(inf)": "vK_p", "dM_b(0)": "p", "dM_g(0)": "p"}
"""Figures that equal a parameter for a ship without further elements, and then have the parameter's interval."""

TOLD_BY = 0.975
"""Share of draws that must have a figure."""

Figure = Callable[[Values], float]


@checked
def closed_loop(
    fingerprint: Fingerprint, structure: Structure | None = None, *, draws: Draws | None = None
) -> dict[str, Estimate]:
    """Return the usual control figures of the speed loop, linearised about the operating point.

    Parameters
    ----------
    fingerprint
        Fingerprint of a linear structure: that of the ship or of a vessel's plant. If the model ends at a torque
        meter, the figures are those of the whole ship if the load behind the meter is known, and otherwise those
        of the drive alone.
    structure
        Structure of the fingerprint; None rebuilds it.
    draws
        Draws of the fingerprint. Each figure's interval then holds 95 % of its values for the first 400 draws.

    Returns
    -------
    dict
        Estimates with 95 % intervals by name. Without draws, intervals are first order in the covariance of the
        parameters, on a logarithmic scale if the figure can't change its sign. They include the figures of all
        parameter sets that the profile likelihoods found compatible with the data. The figures are: real and
        imaginary part of the two slowest poles with exact dead times [rad/s], slowest first, each complex pair
        by its upper pole; crossover [Hz], phase margin [deg], gain margin [-]; proportional gain vK_p [-] and
        period [s] at which the loop would oscillate if all gains increased together (K_u and P_u of tuning
        rules); -3 dB bandwidth of the speed [Hz]; settling time of the speed to within 5 % after a step of the
        set point [s], and overshoot [-]; slow and fast gain of the torque [-] (eq. 3.39, 3.40). The fast gain
        neglects actuator lag and flexible shaft. An undetermined figure has no value. The gain margin of a loop
        that never oscillates has no value either; its interval begins at the least gain at which the loop would
        oscillate with an element that the data do not exclude.

    Raises
    ------
    InputError
        If the structure has no linearisation, or if draws are given of a model that ends at a torque meter: they
        lack the load behind the meter.

    Examples
    --------
    >>> from shipfp_rs.reproduce.fullscale import extended_structure, measured_response
    >>> from shipfp_rs import identify
    >>> sines = measured_response(1.637)
    >>> fitted = identify(sines, extended_structure(), noise="std", starts=8)
    >>> found = closed_loop(fitted)
    >>> found["phase margin"].unit
    'deg'
    """
    if fingerprint.behind_meter and draws is not None:
        raise InputError(
            "draws: those of a model that ends at a torque meter lack the load behind it; leave them out"
        )
    if fingerprint.behind_meter:
        fingerprint, structure = whole_ship(fingerprint), None
    structure = structure or structure_of(fingerprint)
    require_linear(structure)
    values = dict(fingerprint.optimum)
    if draws is not None:
        return _of_draws(_figures(structure, values), values, draws)
    return {
        name: _same(fingerprint, name, figure(values))
        or estimated(fingerprint, structure, unit, figure, LEAST.get(name), endless=name in ENDLESS)
        for name, (unit, figure) in _figures(structure, values).items()
    }


def _of_draws(figures: Mapping[str, tuple[str, Figure]], values: Values, draws: Draws) -> dict[str, Estimate]:
    """Estimates whose intervals hold 95 % of the draws; a figure missing in 2.5 % of the draws or more has no value."""

    def of(drawn: Values) -> list[float]:
        return [_or_none(figure, {**values, **drawn}) for _, figure in figures.values()]

    found = {}
    for (name, (unit, figure)), row in zip(figures.items(), np.transpose(draws.of(of)), strict=True):
        value, known = _or_none(figure, values), row[np.isfinite(row)]
        if np.isfinite(value) and len(known) > TOLD_BY * len(row):
            low, high = np.quantile(known, [0.025, 0.975])
            found[name] = with_interval(value, (min(float(low), value), max(float(high), value)), unit)
        else:
            found[name] = Estimate(None, unit=unit, status="unidentifiable", reason=Sentence("there is none"))
    return found


def _or_none(figure: Figure, values: Values) -> float:
    """Return a figure; NaN if it has no root or its computation does not converge."""
    try:
        return figure(values)
    except (ValueError, np.linalg.LinAlgError):
        return float("nan")


def poles_of(structure: Structure, values: Values) -> ComplexArray:
    """Two slowest poles of the loop with dead time [rad/s], slowest first, shape (2,) or (1,); of a pair the upper pole."""
    return np.array(sorted(_Loop(structure, values).poles[:2], key=abs))


def _figures(structure: Structure, values: Values) -> dict[str, tuple[str, Figure]]:
    # Several figures share intermediate results for the same parameter values.
    loop_at = cache(lambda items: _Loop(structure, dict(items)))

    def of(read: Callable[[_Loop], float]) -> Figure:
        return lambda known: float(read(loop_at(tuple(known.items()))))

    def of_pole(pole: complex, part: str) -> Figure:
        # The nearest pole, not that of the same index: other parameter values may change the order of the poles.
        none = complex(np.nan, np.nan)
        return of(lambda loop: getattr(min(loop.poles, key=lambda one: abs(one - pole), default=none), part))

    figures: dict[str, tuple[str, Figure]] = {}
    for place, pole in enumerate(poles_of(structure, values), 1):
        figures[Sentence("pole {place}, real", place=place)] = ("rad/s", of_pole(pole, "real"))
        if pole.imag > 0.0:
            figures[Sentence("pole {place}, imaginary", place=place)] = ("rad/s", of_pole(pole, "imag"))
    torque = "dM_g" if "tau_prop" in structure.names else "dM_b"
    return figures | {
        Sentence("crossover"): ("Hz", of(lambda loop: loop.crossover)),
        Sentence("phase margin"): ("deg", of(lambda loop: 180.0 + loop.phase_deg(loop.crossover))),
        Sentence("gain margin"): ("-", of(lambda loop: loop.gain_margin)),
        "ultimate gain": ("-", of(lambda loop: loop.gain_margin * loop.proportional)),
        "ultimate period": ("s", of(lambda loop: 1.0 / loop.turning)),
        Sentence("bandwidth"): ("Hz", of(lambda loop: loop.bandwidth)),
        Sentence("recovery time"): ("s", of(lambda loop: loop.step[0])),
        Sentence("overshoot"): ("-", of(lambda loop: loop.step[1])),
        f"{torque}(0)": ("-", of(lambda loop: loop.known["p"])),
        f"{torque}(inf)": ("-", of(lambda loop: loop.fast_torque)),
    }


def unwrapped(loop: ComplexArray) -> Array:
    """Unwrapped phase (..., F) of open loops at `SEARCHED_HZ` [rad].

    At low frequencies an open loop lags by 90 degrees, or by 270 degrees if engine and load are unstable without
    governor (g above p). Its phase is never positive.
    """
    phase = np.unwrap(np.angle(loop), axis=-1)
    return np.asarray(phase - 2.0 * np.pi * np.ceil(phase[..., :1] / (2.0 * np.pi) - LEADING))


class _Loop:
    """Loop of a structure at values of its parameters; figures that do not exist are NaN."""

    def __init__(self, structure: Structure, values: Values) -> None:
        self.structure, self.values = structure, values
        self.equations, self.known = loop_of(structure, values)

    @cached_property
    def poles(self) -> ComplexArray:
        """The slowest poles, slowest first, more than are reported: roots of a Pade model, refined by Newton's method."""
        known = {**self.known, "T_set": 0.0}  # outside the loop
        inside = {**self.values, "T_set": 0.0, **dict.fromkeys(LATE_CHANNELS, 0.0)}
        poles = np.linalg.eigvals(state_space(self.structure, inside, PADE).A).astype(np.complex128)
        poles = poles[np.argsort(-poles.real)][:SLOWEST]
        for _ in range(20):
            with np.errstate(over="ignore", invalid="ignore"):  # far poles do not converge and are left out
                value, slope = self.equations.characteristic(known, poles)
                moved = value / slope
            poles = poles - moved
        # For a root of the approximation without a nearby exact pole, the iteration does not converge.
        poles = poles[np.abs(moved) < SETTLED * np.abs(poles)]
        upper = poles[poles.imag > -1e-9 * np.abs(poles)]
        upper = np.where(np.abs(upper.imag) < 1e-7 * np.abs(upper), upper.real, upper)
        kept = [
            pole for place, pole in enumerate(upper) if not np.isclose(pole, upper[:place], rtol=1e-6).any()
        ]
        return np.array(sorted(kept, key=lambda pole: -pole.real))

    def at(self, frequency_hz: float) -> complex:
        """The open loop at a frequency."""
        return complex(self.equations.open_loop(self.known, 2j * np.pi * np.array([frequency_hz]))[0])

    @cached_property
    def searched(self) -> ComplexArray:
        """The open loop at `SEARCHED_HZ`."""
        return self.equations.open_loop(self.known, 2j * np.pi * SEARCHED_HZ)

    @cached_property
    def phase(self) -> Array:
        """Unwrapped phase of the open loop at `SEARCHED_HZ` [rad]."""
        return unwrapped(self.searched)

    def phase_deg(self, frequency_hz: float) -> float:
        """Unwrapped phase of the open loop at a frequency [deg]."""
        if not np.isfinite(frequency_hz):
            return float("nan")
        angle = np.angle(self.at(frequency_hz))
        before = self.phase[max(int(np.searchsorted(SEARCHED_HZ, frequency_hz, side="right")) - 1, 0)]
        return float(np.degrees(angle + 2.0 * np.pi * np.round((before - angle) / (2.0 * np.pi))))

    @cached_property
    def crossover(self) -> float:
        """Frequency at which the open loop's gain falls through one [Hz]."""
        return _passed(np.abs(self.searched) - 1.0, lambda frequency: abs(self.at(frequency)) - 1.0)

    @cached_property
    def turning(self) -> float:
        """Frequency at which the loop oscillates if the gain is high enough [Hz]."""
        searched = np.degrees(self.phase) + 180.0
        return _passed(searched, lambda frequency: self.phase_deg(frequency) + 180.0)

    @property
    def gain_margin(self) -> float:
        """Factor on the gain at which the loop oscillates."""
        return 1.0 / abs(self.at(self.turning)) if np.isfinite(self.turning) else float("nan")

    @property
    def bandwidth(self) -> float:
        """Frequency at which the speed follows the set point by -3 dB [Hz]."""

        def above(loop: Any) -> Any:
            return np.abs(loop / (1.0 + loop)) - np.sqrt(0.5)

        return _passed(above(self.searched), lambda frequency: float(above(self.at(frequency))))

    @property
    def proportional(self) -> float:
        """Proportional gain, v K_p: data may determine this product without determining its factors."""
        return self.known.get("vK_p", self.known.get("v", 1.0) * self.known.get("K_p", 0.0))

    @property
    def fast_torque(self) -> float:
        """Gain at high frequencies from set point to torque, without actuator lag and flexible shaft."""
        behind = "tau_prop" in self.structure.names
        fast = float(drooped(self.known)[0]) * self.proportional
        return fast * (self.known["tau_prop"] / self.known["tau_n"] if behind else 1.0)

    @cached_property
    def step(self) -> tuple[float, float]:
        """Recovery time [s] and overshoot [-] after a step of the set point."""
        speed = state_space(self.structure, self.values, PADE)
        slowest = -np.linalg.eigvals(speed.A).real.max()
        if "dn" not in speed.outputs or slowest <= 0.0:
            return float("nan"), float("nan")
        times = np.linspace(0.0, LONGEST / slowest, INSTANTS)
        poles, weights = _decay(speed)
        off = (weights @ _powers(np.exp(poles * times[1]), INSTANTS)).real
        last = int(np.flatnonzero(np.abs(off) > RECOVERED)[-1])
        if last + 1 >= INSTANTS:
            return float("nan"), max(_peak(off), 0.0)
        recovery = brentq(
            lambda at: abs(float((weights @ np.exp(poles * at)).real)) - RECOVERED,
            times[last],
            times[last + 1],
        )
        return float(recovery), max(_peak(off), 0.0)


def _passed(searched: Array, value: Callable[[float], float]) -> float:
    """Lowest frequency [Hz] at which a function, known at `SEARCHED_HZ`, falls through zero; NaN if it never does."""
    change = np.flatnonzero(np.diff(np.sign(searched)) < 0.0)
    if not len(change):
        return float("nan")
    low, high = SEARCHED_HZ[change[0]], SEARCHED_HZ[change[0] + 1]
    return float(brentq(value, low, high, xtol=1e-14, rtol=1e-13))


def _peak(off: Array) -> float:
    """Largest value of an evenly sampled signal, from the parabola through its largest sample and both neighbours."""
    at = int(np.argmax(off))
    if not 0 < at < len(off) - 1:
        return float(off[at])
    rise, bend = 0.5 * (off[at + 1] - off[at - 1]), off[at + 1] - 2.0 * off[at] + off[at - 1]
    return float(off[at] - 0.5 * rise**2 / bend) if bend else float(off[at])


def _decay(space: StateSpace) -> tuple[ComplexArray, ComplexArray]:
    """Poles and weights of the exponentials of a step response: the speed minus its final value, divided by this value."""
    place = space.outputs.index("dn")
    poles, modes = np.linalg.eig(space.A)
    weights = (space.C[place] @ modes) * np.linalg.solve(modes, space.B) / poles
    return poles, weights / (space.D[place] - weights.sum().real)


def _powers(base: ComplexArray, count: int) -> ComplexArray:
    """Powers base^0, base^1, ... of each base, shape (P, count), as products of a few powers."""
    width = int(np.ceil(np.sqrt(count)))
    few = base[:, None] ** np.arange(width)
    many = (base[:, None] ** width) ** np.arange(width)
    return np.asarray((many[:, :, None] * few[:, None, :]).reshape(len(base), -1)[:, :count])


def _same(fingerprint: Fingerprint, name: str, value: float) -> Estimate | None:
    """Estimate of the parameter that equals a figure; None if no parameter does."""
    told = {**fingerprint.derived, **fingerprint.parameters}.get(SAME.get(name, ""))
    if (
        told is None
        or not fingerprint.engine_described
        or told.value is None
        or told.ci95 is None
        or not np.isclose(told.value, value, rtol=1e-9)
    ):
        return None
    return Estimate(told.value, told.std, told.ci95, told.unit)


def estimated(
    fingerprint: Fingerprint,
    structure: Structure,
    unit: str,
    figure: Figure,
    least: float | None,
    *,
    endless: bool = False,
) -> Estimate:
    """Estimate of a figure with its interval; `least` None: its sign can't change; `endless`: it may be infinite."""
    values = dict(fingerprint.optimum)
    value = figure(values)
    unknown = partial(Estimate, None, unit=unit, status="unidentifiable")
    if not fingerprint.engine_described:
        return unknown(reason=Sentence("drive and governor are not described"))
    if not np.isfinite(value):
        bounded = _possible(fingerprint, figure) if endless else []
        return unknown(ci95=(min(bounded), np.inf) if bounded else None, reason=Sentence("there is none"))
    free = [
        name
        for name, estimate in fingerprint.parameters.items()
        if estimate.status != "fixed" and name not in structure.ties
    ]
    slopes = dict(zip(free, gradient_of(figure, values, free, structure.ties), strict=True))
    for entry in fingerprint.identifiability.null_space:
        # Directions are changes relative to the parameter, or to its typical size if that is larger.
        change = sum(
            slopes[name] * max(abs(values[name]), structure[name].scale) * part
            for name, part in entry["direction"].items()
        )
        if abs(change) > TOLD * max(abs(value), 1e-9):
            along = Sentence(
                "changes along a direction that the data do not determine: {direction}",
                direction=entry["combination"],
            )
            return unknown(reason=along)
    names = list(fingerprint.covariance["names"])
    gradient = np.array([slopes[name] for name in names])
    matrix = np.array(fingerprint.covariance["matrix"], dtype=np.float64).reshape(len(names), len(names))
    std = float(np.sqrt(max(gradient @ matrix @ gradient, 0.0)))
    possible = _possible(fingerprint, figure)
    if not possible and std > LARGEST * max(abs(value), 1e-6):
        return unknown(reason=Sentence("changes only along directions that the data do not determine"))
    low, high = min([value, *possible]), max([value, *possible])
    if not possible or std < STRAIGHT * abs(value):
        ends = _first_order(value, std, least)
        low, high = min(low, *ends), max(high, *ends)
    return with_interval(value, (low, high), unit)


def _first_order(value: float, std: float, least: float | None) -> tuple[float, float]:
    """Ends of a figure's interval; a figure whose sign can't change is divided and multiplied by a factor."""
    reach = DEVIATIONS_95 * std
    if least is not None or not value:
        return max(value - reach, -np.inf if least is None else least), value + reach
    factor = float(np.exp(reach / abs(value)))
    return value / factor, value * factor


def _possible(fingerprint: Fingerprint, figure: Figure) -> list[float]:
    """Figure for each parameter set that the profile likelihoods found compatible with the data."""
    others = fingerprint.settings.get("possible", ())
    found = [_or_none(figure, {**fingerprint.optimum, **other}) for other in others]
    return [value for value in found if np.isfinite(value)]
