"""The tug's trial on a ship whose parameters are known: Table 7.1 with the truth beside it, on as many seeded trials."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import combinations

import numpy as np
import numpy.typing as npt

from shipfp_rs.experiment import Experiment
from shipfp_rs.fingerprint import Fingerprint
from shipfp_rs.identification import identify
from shipfp_rs.inflow import Inflow, disturbed
from shipfp_rs.linear_model import linearise
from shipfp_rs.log import Channel
from shipfp_rs.low_pass import LowPass
from shipfp_rs.rawlog import Sensors
from shipfp_rs.reproduce import Reproduction, Row, Way, row_of
from shipfp_rs.reproduce.fullscale import thesis_structure
from shipfp_rs.reproduce.fullscale_trial import VESSEL, excitation, plan
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation import simulate
from shipfp_rs.structure import Structure
from shipfp_rs.truth import true_values
from shipfp_rs.vessel import Vessel

Array = npt.NDArray[np.float64]

LAST_HZ = 0.8
"""Up to here the rack and the torque of the tug follow at the trial's amplitude; above, their limits of rate act, which no
linear structure has. S13 (1.637 Hz) is left out as well, and the chirps are cut where they pass this frequency."""
RATE_HZ = 5.0
"""Keeps the ripple of the shaft (5.2 Hz), of the blades and of the engine out; 1.5 Hz are passed."""
THESIS_RATE_HZ = 20.0
"""Of the thesis's structure, whose simulation joins the samples of the set point by straight lines."""
SIMULATED_HZ = 200.0
PAUSE_S = 10.0
LEAD_S = 2.0
"""Kept of the pause before each experiment, so that it begins at rest."""
SPREAD = 0.1
"""Half width of the ranges, over the tug's own values, in which each trial's ship is drawn."""
DRAWN = (
    "shaft.inertia_kg_m2",
    "shaft.propeller_side_inertia_kg_m2",
    "governor.K_p",
    "governor.K_i",
    "governor.set_point_dead_time_s",
    "actuator.dead_time_s",
    "operating_point.v",
    "operating_point.g",
)
PARTS: Mapping[str, tuple[str, ...]] = {
    "sines S2-S12": tuple(f"S{number}" for number in range(2, 13)),
    "chirp C11": ("C11",),
    "chirps C21-C23": ("C21", "C22", "C23"),
}
EVERYTHING = "all"
CHIRP = "chirp C11"
FREE = ("p", "tau_prop", "vK_p", "vK_i", "T_d", "T_set")
SHOWN = ("tau_n", "g", *FREE)


def at_rest_before_and_after(name: str) -> Excitation:
    """Return an experiment of Table 6.7 with a pause on either side."""
    moving = excitation(name, rate_hz=SIMULATED_HZ)
    rest = np.zeros(round(PAUSE_S * SIMULATED_HZ))
    return Excitation(
        name, moving.kind, SIMULATED_HZ, np.concatenate([rest, moving.samples, rest]), hold="first"
    )


def window_s(name: str) -> tuple[float, float]:
    """Return which part of an experiment is fitted [s], from its own start: to its end or to `LAST_HZ`."""
    row, length = plan()[name], excitation(name, rate_hz=SIMULATED_HZ).duration
    start, stop = row.frequency_hz, row.stop_frequency_hz
    if start is not None and stop is not None and stop > LAST_HZ:
        length *= math.log(LAST_HZ / start) / math.log(stop / start)
    return -LEAD_S, length


@dataclass(frozen=True)
class Ship:
    """A ship of the study, and its trial without any disturbance."""

    vessel: Vessel
    simulated: dict[str, Experiment] = field(default_factory=dict)

    @classmethod
    def drawn(cls, seed: int) -> Ship:
        """Return the tug with every parameter drawn anew; the seed 0 gives the tug itself."""
        tug = Vessel.load(VESSEL)
        if seed == 0:
            return cls(tug)
        random = np.random.default_rng([0x7, seed])
        changes = {}
        for key in DRAWN:
            section, name = key.split(".")
            value = getattr(getattr(tug, section), name)
            changes[key] = value * random.uniform(1.0 - SPREAD, 1.0 + SPREAD)
        changes["propeller.torque_exponent"] = random.uniform(2.0, 2.3)
        return cls(tug.replace(changes))

    @cached_property
    def truth(self) -> dict[str, float]:
        """Parameters of the linear structure at the operating point, the actuator's lag apart from T_d."""
        model = dataclasses.asdict(linearise(self.vessel))
        lag = self.vessel.actuator.lag_s
        return true_values(model | {"T_d": model["T_d"] - lag}) | {"tau_act": lag, "tau_twist": self.twist}

    @property
    def twist(self) -> float:
        """The shaft's twist, M_s0 / (2 pi n_s0 k) [s]."""
        vessel = self.vessel
        torque = vessel.torque_coefficient * vessel.nominal_shaft_speed**vessel.propeller.torque_exponent
        assert vessel.shaft.stiffness_Nm_rad is not None
        return float(torque) / (2.0 * math.pi * vessel.nominal_shaft_speed * vessel.shaft.stiffness_Nm_rad)

    def clean(self, name: str) -> Experiment:
        """Return an experiment in still water, about the means of its own rest."""
        if name not in self.simulated:
            whole = simulate(self.vessel, at_rest_before_and_after(name))
            # The governor that computes at each firing holds the mean speed a little below the set point.
            rest = round(PAUSE_S * SIMULATED_HZ)
            point = {
                signal: float(whole.signals[signal][rest // 2 : rest].mean())
                for signal in ("n_set", "n_e", "n_s", "M_g")
            }
            self.simulated[name] = dataclasses.replace(whole, operating_point=point)
        return self.simulated[name]

    def measured(self, name: str, seed: int | None, rate_hz: float = RATE_HZ) -> Experiment:
        """Return one experiment in moving water as `process` gives it of a raw log without faults.

        Without a seed the water is still and the torque's telemetry without noise.

        The shaft's speed stands for the engine's, as with reflectors on the shaft. The torque has the noise of the
        telemetry; that of good pulses is far below what the water does.
        """
        clean = self.clean(name)
        order = list(plan()).index(name)
        moving, noise = clean, np.zeros(len(clean))
        if seed is not None:
            moving = disturbed(clean, linearise(self.vessel), Inflow(), seed=1000 * seed + order)
            sensors = Sensors()
            density = sensors.torque_noise_V * sensors.torque.scale / math.sqrt(sensors.telemetry_hz)
            spread = density * math.sqrt(SIMULATED_HZ / 2.0)
            noise = np.random.default_rng([0x6, seed, order]).normal(0.0, spread, len(clean))
        first, last = window_s(name)
        channel = Channel(name, "", SIMULATED_HZ, len(clean))
        low_pass = LowPass(channel, rate_hz, (PAUSE_S + first) * SIMULATED_HZ)
        count = round((last - first) * rate_hz)
        gear = 60.0 * self.vessel.gearbox.ratio
        raw = {
            "n_set": moving.signals["n_set"],
            "n_e": moving.signals["n_s"] * gear,
            "M_g": moving.signals["M_g"] + noise,
        }
        point = clean.operating_point
        return Experiment(
            name=name,
            rate_hz=rate_hz,
            signals={key: low_pass(partial(_stretch, samples), count) for key, samples in raw.items()},
            operating_point={"n_set": point["n_set"], "n_e": point["n_s"] * gear, "M_g": point["M_g"]},
            hold="first",
            kind=clean.kind,
        )

    def structure(self) -> Structure:
        """Return the structure that is fitted.

        What drawings tell of the ship is given, and two of the three values of which gauge and speed tell none: the
        inertia, from a torsional vibration calculation, and the engine's slope g, from its factory test. How far the
        mean speed stands off the set point at rest is measured.
        """
        known = {name: self.truth[name] for name in ("tau_n", "g", "tau_act", "tau_twist")}
        point = self.clean(PARTS[CHIRP][0]).operating_point
        known["misread"] = (point["n_set"] - point["n_e"]) / point["n_e"]
        return Structure.linear(
            torque="gauge",
            products=True,
            free_exponent=True,
            dead_time_loop=True,
            dead_time_set_point=True,
            actuator_lag=True,
            misreading=True,
            twist=True,
            curvature=True,
            speed="propeller",
            name="extended",
        ).with_fixed(**known)


def _stretch(samples: Array, start: int, stop: int) -> Array:
    return samples[start:stop].copy()


def fitted(of: Ship, seed: int | None, part: str) -> Fingerprint:
    """Make a part of a seeded trial, and identify it without a look at the truth.

    Weights for white noise and a covariance for the noise as it is: weights for the true noise would trust the slow
    speed, which water hardly moves, to parts in a hundred thousand, and so whatever the structure lacks.
    """
    return identify(
        [of.measured(name, seed) for name in experiments_of(part)],
        of.structure(),
        noise="white",
        covariance="sandwich",
        initial_state="zero",
        starts=1,
        vessel=VESSEL,
    )


def fitted_as_the_thesis(of: Ship, seed: int, part: str) -> Fingerprint:
    """Fit the thesis's structure to the same, with the weights that its sine fits were refitted with."""
    return identify(
        [of.measured(name, seed, THESIS_RATE_HZ) for name in experiments_of(part)],
        thesis_structure(),
        noise="white",
        starts=1,
        vessel=VESSEL,
    )


def experiments_of(part: str) -> tuple[str, ...]:
    """Return the names of a part's experiments."""
    return sum(PARTS.values(), ()) if part == EVERYTHING else PARTS[part]


@dataclass(frozen=True)
class Outcome:
    """One trial of one ship: the truth, what the structure makes of still water, and what the trial told."""

    truth: Mapping[str, float]
    still: Fingerprint
    told: Fingerprint

    @classmethod
    def of(cls, ship: Ship, seed: int, part: str) -> Outcome:
        """Make and identify a part of a trial, with water and without."""
        return cls(ship.truth, fitted(ship, None, part), fitted(ship, seed, part))


@dataclass(frozen=True)
class Score:
    """How a parameter came out over many trials.

    Parameters
    ----------
    trials
        Number of trials in which it was told.
    inside
        Share of them whose 95 % interval holds the truth.
    inside_still
        Share whose interval holds what the same structure finds in still water: there noise alone can miss.
    error_pct, std_pct
        Medians of the error's size and of the predicted standard deviation, over the truth.
    structure_pct
        Mean error in still water over the truth: what the structure lacks.
    """

    trials: int
    inside: float
    inside_still: float
    error_pct: float
    std_pct: float
    structure_pct: float


def scores(outcomes: Sequence[Outcome]) -> dict[str, Score]:
    """Return each free parameter's score."""
    found = {}
    for name in FREE:
        rows = []
        for outcome in outcomes:
            estimate, still = outcome.told.parameters[name], outcome.still.parameters[name].value
            if estimate.value is None or estimate.ci95 is None or still is None:
                continue
            truth, (low, high) = outcome.truth[name], estimate.ci95
            rows.append(
                (
                    low <= truth <= high,
                    low <= still <= high,
                    abs(estimate.value / truth - 1.0),
                    (estimate.std or 0.0) / abs(truth),
                    still / truth - 1.0,
                )
            )
        if rows:
            inside, inside_still, error, std, structure = np.array(rows, dtype=np.float64).T
            found[name] = Score(
                len(rows),
                float(inside.mean()),
                float(inside_still.mean()),
                100.0 * float(np.median(error)),
                100.0 * float(np.median(std)),
                100.0 * float(structure.mean()),
            )
    return found


def agreement(fingerprints: Mapping[str, Fingerprint]) -> dict[str, float]:
    """Return, for each free parameter, the largest difference of two parts' estimates in their joint deviations."""
    found = {}
    for name in FREE:
        told = [e for f in fingerprints.values() if (e := f.parameters[name]).value is not None and e.std]
        found[name] = max(
            (
                abs(one.value - other.value) / math.hypot(one.std, other.std)
                for one, other in combinations(told, 2)
                if one.value is not None and other.value is not None and one.std and other.std
            ),
            default=math.nan,
        )
    return found


def reproduce(draws: int = 1, progress: Callable[[int, int], None] | None = None) -> Reproduction:
    """Identify the tug's trial on the tug itself, part by part, then the long chirp on as many drawn ships."""
    tug = Ship.drawn(0)
    rows = [Row("twin", "truth", "truth", "extended", {name: tug.truth[name] for name in SHOWN}, {})]
    fingerprints: dict[str, Fingerprint] = {}
    jobs, done = 2 * len(PARTS) + 1 + draws - 1, 0
    ways: tuple[tuple[Way, Callable[[Ship, int, str], Fingerprint]], ...] = (
        ("thesis", fitted_as_the_thesis),
        ("ours", fitted),
    )
    for way, fit in ways:
        for part in (*PARTS, EVERYTHING) if way == "ours" else PARTS:
            fingerprint = fit(tug, 0, part)
            fingerprints[f"{way}, {part}"] = fingerprint
            rows.append(
                row_of(
                    fingerprint,
                    table="twin",
                    case=part,
                    way=way,
                    structure=str(fingerprint.structure["name"]),
                    notes="",
                    optimum=way == "thesis",
                )
            )
            done += 1
            if progress is not None:
                progress(done, jobs)
    outcomes = [Outcome(tug.truth, fitted(tug, None, CHIRP), fingerprints[f"ours, {CHIRP}"])]
    for seed in range(1, draws):
        outcomes.append(Outcome.of(Ship.drawn(seed), seed, CHIRP))
        done += 1
        if progress is not None:
            progress(done, jobs)
    return Reproduction(
        "The tug's trial on a ship whose parameters are known",
        tuple(rows),
        tuple(_verdict(tug, fingerprints, scores(outcomes), draws)),
        fingerprints,
    )


def table(found: Mapping[str, Score]) -> list[str]:
    """Return lines of text, one for each parameter."""
    lines = [
        f"{'':9} trials  truth inside 95 %  still water's inside  median error  predicted std  error in still water"
    ]
    for name, s in found.items():
        lines.append(
            f"{name:9} {s.trials:6d} {s.inside:18.1%} {s.inside_still:21.1%} {s.error_pct:11.2f} % {s.std_pct:12.2f} % "
            f"{s.structure_pct:19.2f} %"
        )
    return lines


def _verdict(
    tug: Ship, fingerprints: Mapping[str, Fingerprint], found: Mapping[str, Score], draws: int
) -> Iterator[str]:
    ours = {part: fingerprints[f"ours, {part}"] for part in (*PARTS, EVERYTHING)}
    for part, fingerprint in ours.items():
        outside = [
            name
            for name in FREE
            if (ci := fingerprint.parameters[name].ci95) and not ci[0] <= tug.truth[name] <= ci[1]
        ]
        alone = (
            "all intervals hold the truth" if not outside else f"the truth is outside of {', '.join(outside)}"
        )
        yield f"{part}: {alone}; structure " + ("stands" if fingerprint.model_adequate else "called wrong")
    apart = agreement({part: ours[part] for part in PARTS})
    yield "Largest difference between the parts, in joint standard deviations: " + ", ".join(
        f"{name} {value:.1f}" for name, value in apart.items()
    )
    for part in PARTS:
        thesis = fingerprints[f"thesis, {part}"]
        bound = [name for name, e in thesis.parameters.items() if e.status == "at_bound"]
        wrong = [
            name
            for name, e in thesis.parameters.items()
            if e.ci95 is not None and not e.ci95[0] <= tug.truth[name] <= e.ci95[1]
        ]
        called = "called wrong" if thesis.model_adequate is False else "stands"
        yield (
            f"thesis's structure, {part}: on bounds {', '.join(bound) or 'none'}; intervals that miss the truth "
            f"{', '.join(wrong) or 'none'}; structure {called}"
        )
    if draws > 1:
        yield f"{CHIRP} alone, {draws} ships and seas:"
        yield from table(found)
