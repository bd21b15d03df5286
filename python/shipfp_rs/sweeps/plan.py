"""SWEEP.toml: vessel, trial, factors (the varied values), and each draw's seed and identification."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, model_validator
from scipy.special import ndtri
from scipy.stats import qmc

from shipfp_rs._core import __version__
from shipfp_rs.errors import InputError
from shipfp_rs.processing.trial import HOW
from shipfp_rs.processing.trial import Identify as TrialIdentify
from shipfp_rs.runs.run import structure_from
from shipfp_rs.simulation.raw_log import Sensors as UsualSensors
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.toml import FilePath, Name, Section, Seed, built_in, read_named, unexpected, validated
from shipfp_rs.sweeps.chain import Excitation, Faults, Noise, OperatingPoint, Sensors
from shipfp_rs.vessel.drive_train import SIMULATED_KEYS
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel

Design = Literal["random", "latin", "sobol", "grid"]

BLOCK = 65_536
"""Draws per design; a larger sweep has several independent designs, so memory does not grow with the number of draws."""


def seed_of(seed: int, index: int) -> int:
    """Seed of one draw, 0 to 2^63 - 1, drawn from the child of `SeedSequence(seed).spawn` with the draw's index."""
    child = np.random.SeedSequence(seed, spawn_key=(index,))
    return int(child.generate_state(1, np.uint64)[0] >> np.uint64(1))


def place(
    design: Literal["random", "latin", "sobol"], factors: int, draws: int, seed: int, index: int
) -> Array:
    """Point of a draw in the unit cube, shape (factors,); each block of `BLOCK` draws is a separate design."""
    block, row = divmod(index, BLOCK)
    return np.asarray(_block(design, factors, min(BLOCK, draws - block * BLOCK), seed, block)[row])


@lru_cache(maxsize=2)
def _block(design: str, factors: int, rows: int, seed: int, block: int) -> Array:
    if not factors:
        return np.empty((rows, 0))
    # A spawn key of two numbers can't collide with the key of a draw, a single number.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block, 1)))
    if design == "random":
        return np.asarray(generator.random((rows, factors)))
    if design == "latin":
        return np.asarray(qmc.LatinHypercube(factors, rng=generator).random(rows))
    # A Sobol sequence is balanced for a power of two of draws, so the next power is drawn; draws after `rows` are not used.
    return np.asarray(qmc.Sobol(factors, rng=generator).random_base2(math.ceil(math.log2(rows))))


Positive = Annotated[float, Field(gt=0.0)]
Value = float | bool | str
MOST_SAMPLES = 5_000_000
"""Largest number of samples per draw; a fit to that many takes one or two minutes and a gigabyte of memory."""
MOST_DRAWS = 10_000_000
"""Largest number of draws; their table still fits in memory, and at ten draws per second they take twelve days."""
Draws = Annotated[int, Field(ge=1, le=MOST_DRAWS)]

OF_OTHER_CHAIN: Mapping[str, tuple[str, ...]] = {"experiment": ("sensors", "faults"), "log": ("noise",)}
"""For each value of `chain`, the tables of SWEEP.toml that have no effect."""


class Header(Section):
    """The sweep: name, ship and design of the draws."""

    name: Name = "sweep"
    """Name of the sweep in the results."""
    vessel: FilePath
    """Name of a built-in ship or path of a vessel file."""
    chain: Literal["experiment", "log"] = "experiment"
    """Processing of each draw: "experiment" is a clean simulation with noise, "log" a raw log with sensors and faults."""
    design: Design = "latin"
    """Design of the draws: "latin" and "sobol" distribute them evenly, "grid" has every combination of levels."""
    draws: Draws | None = None
    """Number of draws; a grid has the key `repeats` instead."""
    repeats: Draws | None = None
    """Number of draws for each combination of levels in a grid."""
    seed: Seed = 0
    """Seed from which the seeds of all draws are derived."""
    time_limit_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """Time limit of one draw [s]; without one, results do not depend on the speed of the machine."""

    @model_validator(mode="after")
    def _has_a_size(self) -> Self:
        grid = self.design == "grid"
        if (self.draws is None) != grid:
            found = f"design {self.design!r} " + ("with draws" if grid else "without draws")
            raise unexpected("draws", found, "repeats for a grid, draws for any other design")
        if self.repeats is not None and not grid:
            raise unexpected("repeats", f"{self.repeats} with design {self.design!r}", "it for a grid only")
        return self


class Identify(TrialIdentify):
    """The table [identify] of TRIAL.toml, but without `seed`, since each draw has its own."""

    @model_validator(mode="after")
    def _has_no_seed(self) -> Self:
        if "seed" in self.model_fields_set:
            raise unexpected("seed", f"{self.seed}", "none; each draw's seed follows from sweep.seed")
        return self


class Conditions(Section):
    """Conditions of one draw."""

    excitation: Excitation = Excitation()
    noise: Noise = Noise()
    operating_point: OperatingPoint = OperatingPoint()
    vessel: dict[str, Any] = Field(default_factory=dict)
    """Values that replace those of the vessel's file, by dotted key."""
    sensors: Sensors = Sensors()
    faults: Faults = Faults()
    identify: Identify = Identify()


class Factor(Section):
    """Variation of one value: from a list of values, uniform from `low` to `high`, or normal."""

    values: Annotated[tuple[Value, ...], Field(strict=False, min_length=1)] | None = None
    """Possible values, with equal frequency."""
    low: float | None = None
    """Lowest value."""
    high: float | None = None
    """Highest value."""
    scale: Literal["linear", "log"] = "linear"
    """Whether values, or their logarithms, are uniform from low to high."""
    mean: float | None = None
    """Mean of a normal distribution."""
    std: Positive | None = None
    """Standard deviation of a normal distribution."""
    points: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """Levels in a grid."""

    @model_validator(mode="after")
    def _is_one_kind(self) -> Self:
        pairs = {"low": (self.low, self.high), "mean": (self.mean, self.std)}
        given = [name for name, pair in pairs.items() if pair != (None, None)]
        if len(given) + (self.values is not None) != 1 or any(None in pairs[name] for name in given):
            raise unexpected(
                "values", "no or several ways to vary", "values, or low and high, or mean and std"
            )
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise unexpected("high", f"{self.high:g}", f"more than low, {self.low:g}")
            if self.scale == "log" and self.low <= 0.0:
                raise unexpected("low", f"{self.low:g}", "a positive number on a logarithmic scale")
        return self

    def at(self, share: float) -> Value:
        """Value below which this fraction (0 to 1) of the draws lies."""
        if self.values is not None:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.mean is not None and self.std is not None:
            return self.mean + self.std * float(ndtri(min(max(share, 1e-12), 1.0 - 1e-12)))
        assert self.low is not None
        assert self.high is not None
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)

    def levels(self) -> list[Value] | None:
        """Levels of a grid; None without any."""
        if self.values is not None:
            return list(self.values)
        if self.points is None:
            return None
        if self.mean is not None:
            return [self.at((point + 0.5) / self.points) for point in range(self.points)]
        return [self.at(float(share)) for share in np.linspace(0.0, 1.0, self.points)]

    @property
    def is_text(self) -> bool:
        """Whether any value is a text."""
        return self.values is not None and any(isinstance(value, str) for value in self.values)


class Plan(Conditions):
    """Contents of a SWEEP.toml.

    Examples
    --------
    >>> plan = Plan.load("duration")
    >>> plan.draws, sorted(plan.factors)
    (360, ['excitation.amplitude_rpm', 'excitation.duration_s'])
    """

    sweep: Header
    factors: dict[str, Factor] = Field(default_factory=dict)
    """Variations of values in the other tables, by dotted key."""

    @model_validator(mode="after")
    def _varies_what_exists(self) -> Self:
        for key, factor in self.factors.items():
            section, _, name = key.partition(".")
            known = _keys_of(section)
            if known is not None and name not in known:
                near = hints.suggestion(key, [f"{section}.{other}" for other in known])
                raise unexpected("factors", f"the unknown key {key!r}", f"a key of the file, {near}")
            if known is None and (section != "vessel" or not name):
                near = hints.suggestion(section, [*_SECTIONS, "vessel"])
                raise unexpected("factors", f"the unknown key {key!r}", f"section.key; {near}")
            if self.sweep.design == "grid" and factor.levels() is None:
                raise unexpected("factors", f"{key!r} without levels", "values or points for a grid")
        size = math.prod(len(factor.levels() or ()) for factor in self.factors.values())
        if self.sweep.design == "grid" and size * (self.sweep.repeats or 1) > MOST_DRAWS:
            raise unexpected("factors", f"a grid of {size} cells", f"at most {MOST_DRAWS} draws")
        return self

    @model_validator(mode="after")
    def _has_what_its_chain_takes(self) -> Self:
        chain = self.sweep.chain
        useless = [f"{section}." for section in OF_OTHER_CHAIN[chain]]
        given = [
            f"{section}.{key}" for section in _SECTIONS for key in getattr(self, section).model_fields_set
        ]
        for key in sorted([*given, *self.factors]):
            if key.startswith(tuple(useless)) or (chain == "log" and key == "excitation.rate_hz"):
                raise unexpected(key, f"it with chain {chain!r}", "no such key, it does nothing there")
        return self

    @model_validator(mode="after")
    def _has_its_torque(self) -> Self:
        if self.sweep.chain == "log" and self.identify.torque == "brake":
            raise unexpected(
                "identify.torque",
                "'brake' with chain 'log'",
                "'gauge', since a simulated log has a gauge's torque, or no key",
            )
        return self

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of the built-in studies."""
        return tuple(built_in("sweeps"))

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Read a built-in study by name, or a SWEEP.toml; the path of a vessel file is relative to its folder.

        Raises
        ------
        InputError
            If there is no such study or file, or a key or value is wrong; the message names it.
        """
        plan = read_named(name_or_path, cls, "sweeps", "sweep", "study")
        path = Path(name_or_path)
        if str(name_or_path) not in cls.names() and (path.parent / plan.sweep.vessel).is_file():
            header = plan.sweep.model_copy(update={"vessel": str(path.parent / plan.sweep.vessel)})
            plan = plan.model_copy(update={"sweep": header})
        return plan.checked(str(path))

    def checked(self, source: str) -> Self:
        """Return the plan after checking the ship, the structure, and each factor near its least and greatest value.

        Raises
        ------
        InputError
            If a check fails, since draws would fail for the same reason.
        """
        try:
            self.structure  # noqa: B018 made here, so that its errors come before the first draw
            self.ship.replace(self.vessel)
            self._require_length(self)
            for key, factor in self.factors.items():
                for value in (factor.at(0.01), factor.at(0.99)):
                    conditions = self.conditions_with({key: value})
                    self.ship.replace(conditions.vessel)
                    self._require_length(conditions)
            middle = self.conditions_with({key: factor.at(0.5) for key, factor in self.factors.items()})
            ship = self.ship.replace(middle.vessel)
            ship.require(*SIMULATED_KEYS)
            steady_state(ship, middle.operating_point.n_e_rpm)
        except InputError as error:
            message = str(error)
            raise InputError(message if message.startswith(source) else f"{source}: {message}") from error
        return self

    def _require_length(self, conditions: Conditions) -> None:
        length_s, rate_hz = conditions.excitation.duration_s, conditions.excitation.rate_hz
        if self.sweep.chain == "log":
            length_s += conditions.sensors.steady_s
            rate_hz = conditions.sensors.rate_hz or UsualSensors.rate_hz
        if length_s * rate_hz > MOST_SAMPLES:
            raise InputError(
                f"excitation.duration_s: found {length_s:g} s at {rate_hz:g} Hz, expected at most {MOST_SAMPLES} samples "
                "a draw"
            )

    @cached_property
    def ship(self) -> Vessel:
        """Ship from which every draw starts."""
        return Vessel.load(self.sweep.vessel)

    @cached_property
    def structure(self) -> Structure:
        """Structure with which every draw is identified."""
        return structure_from(self.identify, "gauge" if self.sweep.chain == "log" else "brake")

    @cached_property
    def draws(self) -> int:
        """Number of draws."""
        if self.sweep.draws is not None:
            return self.sweep.draws
        return math.prod(map(len, self._levels.values())) * (self.sweep.repeats or 1)

    @cached_property
    def _levels(self) -> dict[str, list[Value]]:
        return {key: self.factors[key].levels() or [] for key in sorted(self.factors)}

    def factor_values(self, index: int) -> dict[str, Value]:
        """Values of the factors in one draw; a grid is completed before it is repeated."""
        # Sorted, since the order of lines in a file must not change the draws.
        keys = sorted(self.factors)
        if self.sweep.design == "grid":
            counts = tuple(len(levels) for levels in self._levels.values())
            cell = np.unravel_index(index % math.prod(counts), counts) if counts else ()
            return {
                key: levels[int(at)] for (key, levels), at in zip(self._levels.items(), cell, strict=True)
            }
        shares = place(self.sweep.design, len(keys), self.draws, self.sweep.seed, index)
        return {key: self.factors[key].at(float(share)) for key, share in zip(keys, shares, strict=True)}

    def seed_of(self, index: int) -> int:
        """Seed of all random numbers in one draw."""
        return seed_of(self.sweep.seed, index)

    def conditions_with(self, values: Mapping[str, Value]) -> Conditions:
        """Return the conditions with some values changed, validated again.

        Raises
        ------
        InputError
            If a value is invalid.
        """
        content = {name: dict(getattr(self, name)) for name in Conditions.model_fields}
        # The seed of [identify] must not be given, even unchanged.
        content["identify"].pop("seed")
        for key, value in values.items():
            section, _, name = key.partition(".")
            content[section][name] = value
        return validated(content, Conditions, self.sweep.name)

    def record(self) -> dict[str, Any]:
        """Settings that determine the results, for comparison with an earlier run."""
        content = self.model_dump(mode="json")
        content["sweep"].pop("vessel")
        content["ship"] = self.ship.model_dump(mode="json")
        content["factors"] = {key: content["factors"][key] for key in sorted(self.factors)}
        as_read: dict[str, Any] = json.loads(json.dumps(content))
        return as_read | {"shipfp_rs": __version__}


_SECTIONS: Mapping[str, type[BaseModel]] = {
    "excitation": Excitation,
    "noise": Noise,
    "operating_point": OperatingPoint,
    "sensors": Sensors,
    "faults": Faults,
    "identify": Identify,
}


def _keys_of(section: str) -> tuple[str, ...] | None:
    """Keys of a table that a sweep may vary; None: the table has no fixed keys, or is unknown."""
    if section == "identify":
        return HOW  # other keys of [identify] would change the columns of the results
    return tuple(_SECTIONS[section].model_fields) if section in _SECTIONS else None
