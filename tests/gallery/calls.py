"""Calls of the public functions, each with arguments that work, of which one is replaced by a slip."""

from __future__ import annotations

import copy
import datetime
import functools
import inspect
import json
import math
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from pydantic import BaseModel

import shipfp_rs as fp
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.assessment.profile_likelihood import profile_likelihood
from shipfp_rs.assessment.si import parameters_of, with_parameters
from shipfp_rs.assessment.validation import cross_validation
from shipfp_rs.identification.fingerprint import Estimate
from shipfp_rs.support.units import torque_factor
from shipfp_rs.vessel.steady_state import steady_state

VALUES: tuple[Any, ...] = (
    True, False, 0, 1, -1, 2, 3, 7, 0.0, -0.0, 0.5, 1.5, -5.0, 1e-300, 1e300, -1e300, 1e-9, 1e9, 1e14,
    math.nan, math.inf, -math.inf, 10**15, 10**30, -(10**30), 2**63, "", "a", "x" * 5000,
    "n\u00e4\u2603\u202e\u0131", "a\nb", "a\tb", "nan", "auto", "1.5", "-", ".", "..", "/", "/dev/null", "*", "?.csv",
    "[red]", "%s{}", "gauge", "none", [], [1], [1.0, 2.0], [2.0, 1.0], [math.nan, 1.0], ["a"], [[1.0, 2.0]],
    [[0.0, 1.0], [0.0, 2.0]], [True], list(range(3000)), {}, {"a": 1}, {"scale": 0.0},
    {"low": 1.0, "high": 1.0}, datetime.date(2024, 2, 29),
)  # fmt: skip
FACTORS = (60.0, 1.0 / 60.0, 1e3, 1e-3, 0.01, 100.0, -1.0, 1e6, 1e-6, 2.0 * math.pi)
"""Slips of unit and sign."""
TEXTS: tuple[str, ...] = (
    *(str(value) for value in VALUES if not isinstance(value, list | dict)),
    "1e400", "0x10", "1,5", "1_000", "\u0661", "5:1", "1:5", "nan:1", "0:0", "1:2:3", "true", "-10:10", "tau_n",
    "chirp", "log.parquet", "TRIAL.toml", "none.toml", "none.parquet", "D", "A", "sines", "/proc/in", "log.parquet/in",
)  # fmt: skip

Place = tuple[str | int, ...]


def places(model: type[BaseModel], content: Mapping[str, Any]) -> list[Place]:
    """Return every key that a file can hold: those of the model's tables, and those that are in it."""
    return list(dict.fromkeys([*_declared(model, ()), *held(content, ())]))


def _declared(model: type[BaseModel], place: Place) -> Iterator[Place]:
    for key, field in model.model_fields.items():
        yield (*place, key)
        for inner in _models_in(field.annotation):
            listed = inner.__name__ == "Window"
            yield from _declared(inner, (*place, key, 0) if listed else (*place, key))
    if extra := get_type_hints(model).get("__pydantic_extra__"):
        for inner in _models_in(extra):
            yield from _declared(inner, (*place, "speed"))


def _models_in(annotation: Any) -> set[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    return {model for argument in get_args(annotation) for model in _models_in(argument)}


def held(content: Any, place: Place) -> Iterator[Place]:
    if not isinstance(content, Mapping | list):
        return
    for key, value in content.items() if isinstance(content, Mapping) else enumerate(content):
        yield (*place, key)
        yield from held(value, (*place, key))


def slipped(
    content: Mapping[str, Any], places: list[Place], chance: random.Random
) -> tuple[str, dict[str, Any]]:
    """Return content with one slip, and what the slip is."""
    changed = copy.deepcopy(dict(content))
    place = chance.choice(places)
    owner: Any = changed
    for part in place[:-1]:
        if isinstance(owner, dict):
            owner = owner.setdefault(part, {})
        elif isinstance(owner, list) and isinstance(part, int) and part < len(owner):
            owner = owner[part]
        else:
            return f"{place}: not there", changed
    last = place[-1]
    if not isinstance(owner, dict | list):
        return f"{place}: not there", changed
    there = last in owner if isinstance(owner, dict) else isinstance(last, int) and last < len(owner)
    kind = chance.choice(("value", "value", "value", "value", "unit", "missing", "misspelt"))
    if kind == "missing" and there:
        del owner[last]
    elif kind == "unit" and there and isinstance(owner[last], float):
        owner[last] *= chance.choice(FACTORS)
    elif kind == "misspelt" and there and isinstance(owner, dict) and isinstance(last, str):
        owner[chance.choice((last[1:], last + last[-1:], last.upper(), f"{last}\u00e9", "x" * 3000))] = (
            owner.pop(last)
        )
    elif isinstance(owner, dict) or there:
        owner[last] = chance.choice(VALUES)
        return f"{place} = {repr(owner[last])[:60]}", changed
    return f"{place}: {kind}", changed


def toml(content: Mapping[str, Any]) -> str:
    """Write parsed TOML as text, every table in one line."""
    return "".join(f"{json.dumps(key)} = {_written(value)}\n" for key, value in content.items())


def _written(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, float):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan" if math.isnan(value) else repr(value))
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {_written(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_written, value)) + "]"
    return str(value)


def damaged(text: str, chance: random.Random) -> str:
    """Return a text of a file with one of its lines doubled, cut, or swapped for bytes of another file."""
    lines = text.splitlines(keepends=True)
    at = chance.randrange(len(lines))
    lines[at] = chance.choice(
        (lines[at] * 2, lines[at][: len(lines[at]) // 2], "\ufeff" + lines[at], "PAR1\x00\n", "= 1\n", "[[\n")
    )
    return "".join(lines)


Base = tuple[Callable[..., Any], dict[str, Any]]

ODD: tuple[Any, ...] = (
    *VALUES, None, object(), b"x", {1: 2}, set(), {"n_e": "x"}, {"dn": 1.0}, {"tau_n": -5.0}, (1.0, 2.0), (2.0, 1.0), 1j,
    np.empty(0), np.array([np.nan]), np.array([1.0, np.inf, 2.0]), np.ones((2, 3)), np.arange(9.0) * 1j,
    np.array(["a", "b"]), np.array([1.0, 2.0, 2.0, 3.0]), np.arange(9.0)[::-1], np.zeros(50), np.float32(3.0),
    np.int64(-1), np.arange(5, dtype=np.int8), np.array(7.0), np.bool_(True), [None, 1.0], ["tau_n"], ["dn"],
    "tau_n", "dn", "rk4", "zero", Path("none"), Path("log.parquet"), range(5), iter([1.0]),
)  # fmt: skip
"""Slips of Python's own beside those of files."""


@dataclass(frozen=True)
class Call:
    """A public function, its arguments, and what was done to them."""

    name: str
    function: Callable[..., Any]
    arguments: Mapping[str, Any]
    about: str


def slipped_call(table: Mapping[str, Base], chance: random.Random) -> Call:
    """Return a call with one argument that is a slip."""
    name = chance.choice(list(table))
    function, arguments = table[name]
    known = [
        key
        for key, parameter in inspect.signature(function).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
        and key not in ("progress", "threads")
    ]
    key = chance.choice(sorted({*known, *arguments}))
    value = chance.choice(ODD)
    return Call(name, function, {**arguments, key: value}, f"{key} = {repr(value)[:60]}")


def _used(made: Callable[..., Any], use: Callable[[Any], Any]) -> Callable[..., Any]:
    """Return what makes an object and then uses it: what it takes must work, too."""

    @functools.wraps(made, updated=())
    def call(**given: Any) -> tuple[Any, Any]:
        one = made(**given)
        return one, use(one)

    return call


def table(folder: Path) -> dict[str, Base]:
    """Return all calls that work, on what `prepare` has written into the folder."""
    log = fp.Log.open(folder / "log.parquet")
    trial = fp.Trial.load(folder / "TRIAL.toml")
    record = fp.process(log, trial)[0]
    fingerprint = fp.Fingerprint.load(folder / "fingerprint.json")
    return {
        **_of_signals(),
        **_of_ships(),
        **_of_logs(log, trial, record),
        **_of_trains(),
        **_of_spectra(record),
        **_of_structures(),
        **_of_fits(record, fingerprint),
    }


def _of_signals() -> dict[str, Base]:
    short = fp.signals.steps([13.0, -13.0], 1.0)
    common = {"amplitude_rpm": 10.0}
    band = {"low_hz": 0.1, "high_hz": 2.0}
    return {
        "chirp": (fp.signals.chirp, {"start_hz": 0.1, "stop_hz": 2.0, "duration_s": 10.0, **common}),
        "sine_sequence": (fp.signals.sine_sequence, {"frequencies_hz": [0.5, 1.0], "periods": 3.0, **common}),
        "multisine": (
            fp.signals.multisine,
            {"frequencies_hz": [0.5, 1.0], "period_s": 4.0, "iterations": 10, **common},
        ),
        "steps": (fp.signals.steps, {"sizes_rpm": [13.0, -13.0], "hold_s": 2.0}),
        "prbs": (fp.signals.prbs, {"order": 5, "bit_s": 0.1, **common}),
        "band_limited_noise": (
            fp.signals.band_limited_noise,
            {**band, "duration_s": 20.0, "rms_rpm": 5.0, "seed": 1},
        ),
        "join": (fp.signals.join, {"excitations": [short, short]}),
        "standard": (fp.signals.standard, {"kind": "chirp", "duration_s": 20.0, **common}),
        "Excitation.ramped": (short.ramped, {"ramp_s": 0.1}),
        "Excitation.settled": (short.settled, {"before_s": 1.0}),
        "Excitation.power_in": (short.power_in, band),
        "Excitation": (
            _used(fp.signals.Excitation, lambda one: fp.simulate(fp.Vessel.load("stan-launch-804"), one)),
            {"name": "S", "kind": "steps", "rate_hz": 10.0, "samples": [1.0, 2.0]},
        ),
    }


def _of_ships() -> dict[str, Base]:
    launch = fp.Vessel.load("stan-launch-804")
    short = fp.signals.steps([13.0, -13.0], 1.0)
    model = fp.linearise(launch)
    values = parameters_of(launch)
    return {
        "Vessel.load": (fp.Vessel.load, {"name_or_path": "stan-launch-804"}),
        "steady_state": (steady_state, {"vessel": launch, "n_e_rpm": 1200.0}),
        "linearise": (fp.linearise, {"vessel": launch, "n_e_rpm": 1200.0}),
        "frequency_response": (model.frequency_response, {"frequency_hz": [0.1, 1.0]}),
        "LinearModel": (
            _used(type(model), lambda one: one.frequency_response([0.1, 1.0])),
            {"tau_n": 1.0, "g": -0.5, "v": 1.5, "K_p": 10.0, "K_i": 1.0, "p": 2.0, "tau_prop": 0.4},
        ),
        "simulate": (fp.simulate, {"vessel": launch, "excitation": short, "seed": 1}),
        "simulate_raw_log": (
            fp.simulate_raw_log,
            {"vessel": launch, "excitations": short, "sensors": fp.Sensors(rate_hz=200.0), "steady_s": 10.0},
        ),
        "Sensors": (
            _used(
                fp.Sensors,
                lambda one: fp.simulate_raw_log(launch, short, sensors=one, steady_s=10.0, pause_s=1.0),
            ),
            {"rate_hz": 200.0},
        ),
        "parameters_of": (parameters_of, {"vessel": launch}),
        "with_parameters": (with_parameters, {"vessel": launch, "values": {"tau_n": values["tau_n"]}}),
        "design": (fp.design, {"expected": launch, "duration_s": 100.0}),
    }


def _of_logs(log: fp.Log, trial: fp.Trial, record: fp.Experiment) -> dict[str, Base]:
    arrays = {"a": np.arange(9.0), "b": np.ones(9)}
    return {
        "Log.open": (fp.Log.open, {"path": "log.parquet"}),
        "Log.from_arrays": (fp.Log.from_arrays, {"arrays": arrays, "rate_hz": 2.0}),
        "Log.read": (log.read, {"name": "speed", "start_s": 1.0, "stop_s": 3.0}),
        "Log.rows": (log.rows, {"name": "speed", "start_s": 1.0, "stop_s": 3.0}),
        "Log.channel": (log.channel, {"name": "speed"}),
        "Log.write": (log.write, {"path": "new.parquet"}),
        "Calibration": (
            _used(fp.Calibration, lambda one: one.inverse(one([1.0]))),
            {"scale": 2.0, "offset": 1.0},
        ),
        "Calibration.from_table": (
            fp.Calibration.from_table,
            {"recorded": [0.0, 1.0, 2.0], "values": [1.0, 3.0, 5.1]},
        ),
        "torque_factor": (
            torque_factor,
            {
                "shear_modulus": 8e10,
                "outer_diameter": 0.1,
                "gauge_factor": 2.0,
                "gauge_resistance": 350.0,
                "shunt_resistance": 437e3,
                "shunt_voltage": 2.0,
            },
        ),
        "Trial.load": (fp.Trial.load, {"path": "TRIAL.toml"}),
        "process": (fp.process, {"log": log, "trial": trial}),
        "Experiment": (
            _used(fp.Experiment, lambda one: fp.read_experiments(fp.write_experiments("new.parquet", [one]))),
            {
                "name": "S",
                "rate_hz": 25.0,
                "signals": {"n_set": np.ones(50), "n_e": np.ones(50)},
                "operating_point": {"n_set": 1.0, "n_e": 1.0},
            },
        ),
        "Experiment.window": (record.window, {"start_s": 1.0, "stop_s": 20.0}),
        "write_experiments": (fp.write_experiments, {"path": "new.parquet", "experiments": [record]}),
        "read_experiments": (fp.read_experiments, {"path": "records.parquet"}),
    }


def _of_trains() -> dict[str, Base]:
    train = np.where(np.arange(4000) % 100 < 30, 5.0, 0.0)
    times = np.arange(200) * 0.05
    return {
        "pulse_times": (fp.tacho.pulse_times, {"samples": train, "rate_hz": 1000.0}),
        "speed_from_pulses": (fp.tacho.speed_from_pulses, {"times_s": times, "pulses_per_rev": 4}),
    }


def _of_spectra(record: fp.Experiment) -> dict[str, Base]:
    samples = np.sin(np.arange(500) * 0.3)
    answer = (np.ones(3), np.ones(3), np.arange(3.0))
    return {
        "fit_sine": (fp.frequency.fit_sine, {"samples": samples, "rate_hz": 10.0, "near_hz": 0.48}),
        "fit_lines": (
            fp.frequency.fit_lines,
            {"samples": samples, "rate_hz": 10.0, "frequencies_hz": [0.48]},
        ),
        "sine_response": (fp.frequency.sine_response, {"output": answer, "set_point": answer}),
        "local_response": (fp.frequency.local_response, {"experiment": record, "band_hz": (0.1, 1.0)}),
        "spectral_response": (fp.frequency.spectral_response, {"experiments": record, "segment_s": 8.0}),
        "multisine_response": (fp.frequency.multisine_response, {"experiment": record, "period_s": 5.0}),
        "stepped_sine_response": (fp.frequency.stepped_sine_response, {"experiments": record}),
    }


def _of_structures() -> dict[str, Base]:
    linear = fp.Structure.linear(products=True)
    content = linear.to_dict()
    return {
        "Structure.linear": (fp.Structure.linear, {"torque": "gauge"}),
        "Structure.ship": (fp.Structure.ship, {"elements": ()}),
        "Structure.from_dict": (fp.Structure.from_dict, {"content": content}),
        "Structure.with_fixed": (linear.with_fixed, {"tau_n": 1.0}),
        "Structure.with_start": (linear.with_start, {"tau_n": 1.0}),
        "Structure.with_bounds": (linear.with_bounds, {"tau_n": (0.1, 5.0)}),
        "Structure.with_prior": (linear.with_prior, {"tau_n": (1.0, 0.1)}),
        "Structure.with_tied": (linear.with_tied, {"vK_i": ("vK_p", 1.0)}),
        "Parameter": (fp.Parameter, {"name": "a", "unit": "s", "start": 1.0, "lower": 0.1, "upper": 2.0}),
    }


def _of_fits(record: fp.Experiment, fingerprint: fp.Fingerprint) -> dict[str, Base]:
    structure = fp.Structure.linear(torque="gauge", products=True, free_exponent=True).with_fixed(tau_n=1.17)
    short = fp.signals.steps([13.0, -13.0], 1.0)
    fit = {"structure": structure, "starts": 1}
    return {
        "identify": (fp.identify, {"data": record, **fit}),
        "identify, chosen": (fp.identify, {"data": record}),
        "validate": (fp.validate, {"fingerprint": fingerprint, "experiment": record}),
        "cross_validation": (
            cross_validation,
            {"experiments": [record, record.window(0.0, 20.0, name="B")], **fit},
        ),
        "profile_likelihood": (
            profile_likelihood,
            {"data": record, "structure": structure, "parameters": ["p"]},
        ),
        "closed_loop": (closed_loop, {"fingerprint": fingerprint}),
        "compare": (fp.compare, {"before": fingerprint, "after": fingerprint}),
        "trend": (
            fp.trend,
            {"fingerprints": {0.0: fingerprint, 1.0: fingerprint, 2.0: fingerprint}, "name": "p"},
        ),
        "Fingerprint.load": (fp.Fingerprint.load, {"path": "fingerprint.json"}),
        "Fingerprint.save": (fingerprint.save, {"path": "new.json"}),
        "Fingerprint.predict": (fingerprint.predict, {"experiment": record}),
        "Fingerprint.simulate": (fingerprint.simulate, {"drive": short}),
        "Fingerprint.fit_report": (fingerprint.fit_report, {}),
        "Estimate": (Estimate, {"value": 1.0, "std": 0.1, "ci95": (0.8, 1.2)}),
        "sweep": (fp.sweep, {"plan": "SWEEP.toml", "out": "out", "executor": "threads", "workers": 1}),
    }
