"""Advice on a governor's gains: those that meet limits for nearly all ships that the data allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from shipfp_rs import _core
from shipfp_rs.assessment.closed_loop import closed_loop, structure_of, unwrapped
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.usability import (
    BENT,
    LIMITED,
    LOAD_ONLY,
    MISSED,
    NO_GAUGE,
    TO_THE_METER,
    UNTESTED,
)
from shipfp_rs.structures.elements import LAGS, LATE_CHANNELS
from shipfp_rs.structures.linearised import loop_of
from shipfp_rs.structures.ship import INDEX, ShipEquations, rate_limited
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import NotNegative, Positive, Whole, checked
from shipfp_rs.support.arrays import Array, ComplexArray, Values
from shipfp_rs.support.files import finite
from shipfp_rs.support.threads import where_alone, with_one_blas_thread

SHARE = 0.95
"""Least share of the draws that must meet the limits."""
FACTORS = np.geomspace(0.2, 5.0, 11)
"""Tried factors on today's gains."""
ON_THE_MAP, KEPT = 40, 6
"""Number of draws for the map of all gains, and number of the best gains that are tried on all draws."""
SEARCHED_HZ = np.geomspace(1e-3, 1e2, 400)
RATE_HZ, SHORT_S = 100.0, 1e-3
"""Sample rate of the simulated steps [Hz], and time below which a lag or a delay is neglected [s]."""
LONGER, LONGEST_S = 1.5, 40.0
"""Duration of a step relative to the recovery time, and longest duration [s]."""
DOUBTED = (UNTESTED, LOAD_ONLY, NO_GAUGE, MISSED, TO_THE_METER, BENT, LIMITED)
"""Verdicts that put the model of the loop in doubt. Inaccurate gains do not, since the draws represent their errors."""
UNITS = {
    "phase margin": "deg",
    "crossover": "of the known band",
    "overshoot": "%",
    "dip": "%",
    "recovery": "s",
    "error": "% s",
}
FIGURES = tuple(UNITS)


@dataclass(frozen=True)
class Tuning:
    """Advised gains of a governor.

    Parameters
    ----------
    proportional, integral
        Advised factors on today's proportional and integral gain.
    gains
        Today's and advised gains, and the droop if there is one, as (today, advised) by name.
    dials
        Today's and advised settings of the given dials, as (today, advised) by name.
    share, share_today
        Share of the possible ships (those compatible with the data) that meet all limits, with advised and with
        today's gains.
    rise
        Factor by which both advised gains may rise together until fewer than 95 % of the ships meet the limits; the last
        tried factor if they never do.
    figures, figures_today
        Median of each figure, and value that 95 % of the ships do not exceed (a phase margin: do not fall
        below), with advised and with today's gains.
    limits
        Figure to limit.
    ultimate
        Proportional gain vK_p and period [s] at which the loop would oscillate, with 95 % intervals, for
        comparison with tuning rules.
    factors, map
        Tried factors (F,), and for each (integral, proportional) the share of the ships that meet all limits, (F, F).
    """

    proportional: float
    integral: float
    gains: Mapping[str, tuple[float, float]]
    dials: Mapping[str, tuple[float, float]]
    share: float
    share_today: float
    rise: float
    figures: Mapping[str, tuple[float, float]]
    figures_today: Mapping[str, tuple[float, float]]
    limits: Mapping[str, float]
    ultimate: Mapping[str, Any]
    factors: Array
    map: Array

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        arrays = {"factors": self.factors.tolist(), "map": self.map.tolist()}
        return dict(finite({**asdict(self), **arrays}))


@dataclass(frozen=True)
class Steps:
    """Steps that are applied to every ship, and limits of the figures that follow from the steps.

    `set_step` and `load_step` are relative to the operating point. The speed has recovered when the relative deviation is
    within `band`. `duration_s` is the duration of each step. The ship is known up to the frequency `band_hz`.
    `limits` has the least value of the phase margin, and the largest values of all other figures, by name.
    """

    set_step: float
    load_step: float
    band: float
    duration_s: float
    band_hz: float
    limits: Mapping[str, float]

    def settled(self, values: Values) -> tuple[float, float]:
        """Return the speed's deviation long after the step of the set point, and its fall long after that of the load."""
        droop = values.get("droop", 0.0)
        over = 1.0 + droop * (values["p"] + values.get("damping", 0.0) - values["g"])
        return self.set_step / over, droop * self.load_step / over

    def figures(self, structure: Structure, values: Values, factors: Sequence[tuple[float, float]]) -> Array:
        """Return the `FIGURES` (G, 6) of a ship for factors (proportional, integral) on its gains."""
        margins, crossovers = phase_margins(structure, values, np.array([*factors, (1.0, 1.0)]))
        equations = structure.equations
        assert isinstance(equations, ShipEquations)
        vector, count = _vector(structure, equations, values), int(self.duration_s * RATE_HZ)
        asked, load = np.ones(2 * count), np.zeros(2 * count)
        asked[1:], load[count:] = 1.0 + self.set_step, self.load_step
        if "set_rate" in values:
            asked = rate_limited(asked, values["set_rate"], RATE_HZ)
        level, lower = self.settled(values)
        outputs = [_core.SHIP_OUTPUTS.index("dn")]
        found = np.full((len(factors), len(FIGURES)), np.inf)
        found[:, 0] = margins[:-1]
        found[:, 1] = crossovers[:-1] / max(self.band_hz, crossovers[-1])
        for row, (proportional, integral) in zip(found, factors, strict=True):
            own = vector.copy()
            own[INDEX["K_p"]] *= proportional
            own[INDEX["K_i"]] *= integral
            own[INDEX["K_d"]] *= proportional
            try:
                (speed,) = _core.simulate_ship(
                    own, asked, load, 1.0 / RATE_HZ, 0, "zero", outputs, equations.limit
                )
            except SimulationError:
                continue
            first, off = speed[:count], speed[count:] - level
            if not np.isfinite(speed).all() or abs(first[-1] - level) > 0.5 * level:
                continue
            dip, off = 100.0 * max(-off.min(), 0.0), off + lower
            away = np.flatnonzero(np.abs(off) > self.band)
            last = away[-1] + 1 if len(away) else 0
            row[2:] = (
                100.0 * max(first.max() / level - 1.0, 0.0),
                dip,
                last / RATE_HZ if last < count else np.inf,
                100.0 * float(np.abs(off).sum()) / RATE_HZ,
            )
        return found

    def met(self, figures: Array) -> Array:
        """Return whether figures (..., 6) meet all limits."""
        found = np.isfinite(figures[..., -1])
        for name, limit in self.limits.items():
            one = figures[..., FIGURES.index(name)]
            found = found & (one >= limit if name == "phase margin" else one <= limit)
        return np.asarray(found)


@checked
@with_one_blas_thread
def tune(
    fingerprint: Fingerprint,
    *,
    phase_margin_deg: Positive = 45.0,
    overshoot_pct: Positive = 20.0,
    dip_pct: Positive | None = None,
    recovery_s: Positive | None = None,
    droop_pct: NotNegative | None = None,
    load_step_pct: Positive = 10.0,
    set_step_pct: Positive = 1.0,
    band_pct: Positive = 1.0,
    draws: Whole = 200,
    seed: Whole = 0,
    dials: Mapping[str, float] | None = None,
) -> Tuning:
    """Return gains of the governor that meet limits for at least 95 % of the ships that the data allow.

    The nonlinear model of each ship, with its limits and delays, simulates a step of the set point and then a
    step of the load. The advised gains are those with the least speed error after the load step among the gains
    that meet the limits; gains whose neighbours on the map meet them, too, are preferred. The crossover must not
    rise above the band in which the fit compared model and data, or above today's crossover if that is higher:
    the data do not describe the ship there.

    Parameters
    ----------
    fingerprint
        Fingerprint of a ship whose model of the loop is not in doubt; the data may determine only products of gains.
    phase_margin_deg
        Least phase margin of the linear loop [deg].
    overshoot_pct
        Largest overshoot after a step of the set point, per cent of the step.
    dip_pct, recovery_s
        Largest dip of the speed after a step of the load, per cent of the operating speed, and longest time until the speed
        stays within `band_pct` of its new level; None: no limit.
    droop_pct
        Droop of the advised setting: decrease of the speed from no fuel torque to the operating torque, per cent
        of the speed; None: today's droop.
    load_step_pct, set_step_pct, band_pct
        Steps of load and set point, per cent of the operating torque and speed, and band of the recovered speed,
        per cent of the operating speed.
    draws, seed
        Number of ships, drawn from the fingerprint's likelihood, and the seed of the draw.
    dials
        Present readings of the governor's dials: "gain" (as GAIN of Woodward, or Gain of ComAp), "reset"
        (integral over proportional gain, as RESET of Woodward, or Int of ComAp), "droop_pct", each in any unit.
        None takes them from the trial's [governor].

    Returns
    -------
    Tuning
        Factors on today's gains, their effect, and the map of all tried gains.

    Raises
    ------
    InputError
        If the data do not determine the loop, or no gains meet the limits.

    Notes
    -----
    The speed error is the integral of its absolute value after the load step. Ultimate gain and period are those of
    J. G. Ziegler and N. B. Nichols, 10.1115/1.4019264.
    """
    structure = _known_structure(fingerprint)
    drawn = fingerprint.draws(draws, seed=seed)
    ships = [{**fingerprint.optimum, **one} for one in drawn.sets]
    droop = fingerprint.optimum.get("droop", 0.0) if droop_pct is None else droop_pct / 100.0
    then = ships if droop_pct is None else [{**one, "droop": droop} for one in ships]
    told = closed_loop(fingerprint)
    limits = {
        "phase margin": phase_margin_deg,
        "crossover": 1.0,
        "overshoot": overshoot_pct,
        "dip": dip_pct,
        "recovery": recovery_s,
    }
    test = Steps(
        set_step_pct / 100.0,
        load_step_pct / 100.0,
        band_pct / 100.0,
        min(LONGER * max(recovery_s or 0.0, told["recovery time"].value or LONGEST_S), LONGEST_S),
        fingerprint.settings.get("band_hz", SEARCHED_HZ[-1]),
        {name: limit for name, limit in limits.items() if limit is not None},
    )
    grid = [(float(p), float(i)) for i in FACTORS for p in FACTORS]
    figures = _figures(test, structure, then[:ON_THE_MAP], grid)
    shares = test.met(figures).mean(axis=0).reshape(len(FACTORS), -1)
    today = _figures(test, structure, ships, [(1.0, 1.0)])
    for place in _best(
        shares, np.quantile(figures[..., -1], SHARE, axis=0, method="higher").reshape(shares.shape)
    ):
        proportional, integral = FACTORS[place[1]], FACTORS[place[0]]
        advised = _figures(test, structure, then, [(float(proportional), float(integral))])
        if (share := float(test.met(advised).mean())) >= SHARE:
            return Tuning(
                proportional=float(proportional),
                integral=float(integral),
                gains=_gains(fingerprint, float(proportional), float(integral), droop),
                dials=_dials(
                    fingerprint.settings.get("governor", {}) if dials is None else dials,
                    gain=float(proportional),
                    reset=float(integral / proportional),
                    droop_pct=_over(droop, fingerprint.optimum.get("droop", 0.0)),
                ),
                share=share,
                share_today=float(test.met(today).mean()),
                rise=_rise(shares, place),
                figures=_told(advised),
                figures_today=_told(today),
                limits=test.limits,
                ultimate={name: told[name].to_dict() for name in ("ultimate gain", "ultimate period")},
                factors=FACTORS,
                map=shares,
            )
    raise InputError(_why_none(test, figures, shares))


def phase_margins(structure: Structure, values: Values, factors: Array) -> tuple[Array, Array]:
    """Return the linear loop's phase margins [deg] and crossover frequencies [Hz], (G,) each, for gain factors (G, 2).

    The factors multiply the proportional and the integral gain. If the loop gain crosses 1 several times, the smallest phase
    margin and the highest crossover frequency count.
    """
    equations, known = loop_of(structure, values)
    for names, factor in zip((("vK_p", "K_p"), ("vK_i", "K_i")), factors.T, strict=True):
        known |= {name: known[name] * factor[:, None] for name in names if name in known}
    loop: ComplexArray = equations.open_loop(known, 2j * np.pi * SEARCHED_HZ)
    size, phase = np.log(np.abs(loop)), unwrapped(loop)
    before, after = size[..., :-1], size[..., 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = before / (before - after)
        at = phase[..., :-1] + share * np.diff(phase, axis=-1)
    crosses = before * after < 0.0
    margins = np.where(crosses, 180.0 + np.degrees(at), np.inf).min(axis=-1)
    return margins, np.where(crosses, SEARCHED_HZ[1:], 0.0).max(axis=-1)


def _known_structure(fingerprint: Fingerprint) -> Structure:
    """Return the structure of a fingerprint, or raise `InputError` with the reason why no gains can be advised."""
    if (kind := fingerprint.structure.get("kind")) != "ship":
        raise InputError(
            f"fingerprint: found a structure of kind {kind!r}, expected a ship with a governor, `Structure.ship`"
        )
    doubted = any(fingerprint.usable.startswith(one.split("{")[0]) for one in DOUBTED)
    if doubted or not fingerprint.usable.startswith("Usable"):
        raise InputError(
            f"fingerprint: found {fingerprint.usable or 'no verdict'!r}, expected one whose model of the loop is not in "
            "doubt"
        )
    if fingerprint.behind_meter:
        raise InputError(
            "fingerprint: found a model that ends at a torque meter, expected one of the whole ship"
        )
    return structure_of(fingerprint)


def _vector(structure: Structure, equations: ShipEquations, values: Values) -> Array:
    """Return the stepper's parameters of a ship with exact sensors and a load, without negligible lags."""
    known = structure.complete(values)
    known = {name: value for name, value in known.items() if name not in LATE_CHANNELS}
    known |= {name: 0.0 for name in (*LAGS, "tau_twist") if known.get(name, 1.0) < SHORT_S}
    vector = equations.vector(known)
    vector[INDEX["load_gain"]] = 1.0
    return vector


def _figures(
    test: Steps, structure: Structure, ships: Sequence[Values], factors: Sequence[tuple[float, float]]
) -> Array:
    """Return the figures (S, G, 6) of each ship for each pair of factors."""
    jobs = [partial(test.figures, structure, values, factors) for values in ships]
    return np.array(where_alone(jobs))


def _best(shares: Array, errors: Array) -> list[tuple[int, int]]:
    """Return the indices of gains that meet the limits: those inside the region first, each group by the speed's error."""
    robust = shares >= SHARE
    inner = robust.copy()
    inner[1:] &= robust[:-1]
    inner[:-1] &= robust[1:]
    inner[:, 1:] &= robust[:, :-1]
    inner[:, :-1] &= robust[:, 1:]
    found = []
    for kept in (inner, robust & ~inner):
        places = [(int(i), int(p)) for i, p in np.argwhere(kept)]
        found += sorted(places, key=lambda place: errors[place])[:KEPT]
    return found


def _rise(shares: Array, place: tuple[int, int]) -> float:
    """Return the factor on both gains at which the share falls below `SHARE`; the last tried factor if it never does."""
    row, column = place
    room = len(shares) - 1 - max(place)
    along = np.array([shares[row + step, column + step] for step in range(room + 1)])
    below = np.flatnonzero(along < SHARE)
    step = float(np.log(FACTORS[1] / FACTORS[0]))
    if not len(below):
        return float(np.exp(step * room))
    last = int(below[0])
    part = (along[last - 1] - SHARE) / (along[last - 1] - along[last]) if last else 0.0
    return float(np.exp(step * (last - 1 + part))) if last else 1.0


def _gains(
    fingerprint: Fingerprint, proportional: float, integral: float, droop: float
) -> dict[str, tuple[float, float]]:
    """Return the best ship's gains, today's and advised, by name, and its droop if there is one."""
    known, factors = fingerprint.optimum, {"p": proportional, "d": proportional, "i": integral}
    names = [f"{v}K_{part}" for v in ("v", "") for part in "pid"]
    found = {name: (known[name], known[name] * factors[name[-1]]) for name in names if known.get(name, 0.0)}
    today = known.get("droop", 0.0)
    return found | ({"droop": (today, droop)} if today or droop else {})


def _over(droop: float, today: float) -> float:
    """Return the factor on a droop; NaN if there is no droop today."""
    return droop / today if today else float("nan")


def _dials(told: Mapping[str, float], **factors: float) -> dict[str, tuple[float, float]]:
    """Return today's and the advised settings of dials."""
    if odd := set(told) - set(factors):
        raise InputError(f"dials: found {', '.join(sorted(odd))}, expected some of {', '.join(factors)}")
    every = {name: (float(value), float(value) * factors[name]) for name, value in told.items()}
    return {name: row for name, row in every.items() if np.isfinite(row[1])}


def _told(figures: Array) -> dict[str, tuple[float, float]]:
    """Return each figure's median and the value that 95 % of the ships meet, from figures (S, 1, 6)."""
    found = {}
    for place, name in enumerate(FIGURES):
        row = figures[:, 0, place]
        least, most = np.quantile(row, 1.0 - SHARE, method="lower"), np.quantile(row, SHARE, method="higher")
        kept = least if name == "phase margin" else most
        found[name] = float(np.quantile(row, 0.5, method="lower")), float(kept)
    return found


def _why_none(test: Steps, figures: Array, shares: Array) -> str:
    """Return the reason why no gains are advised: the limit that most ships miss at the best gains."""
    place = int(np.argmax(shares))
    missed = {}
    for name, limit in test.limits.items():
        met = replace(test, limits={name: limit}).met(figures[:, place])
        missed[name] = 100.0 * (1.0 - float(met.mean()))
    worst = max(missed, key=lambda name: missed[name])
    return (
        f"limits: found gains that meet them for at most {100.0 * shares.flat[place]:.0f} % of the ships that the data "
        f"allow, expected {100.0 * SHARE:.0f}; with these gains {missed[worst]:.0f} % do not keep to the limit "
        f"of the {worst}, {test.limits[worst]:.3g} {UNITS[worst]}: loosen this limit, or measure longer"
    )
