"""Calls of the public functions, each with arguments that work, of which one is replaced by a slip."""

from __future__ import annotations

import functools
import inspect
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import shipfp_rs as fp
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.assessment.profile_likelihood import profile_likelihood
from shipfp_rs.assessment.si import parameters_of, with_parameters
from shipfp_rs.assessment.validation import cross_validation
from shipfp_rs.identification.fingerprint import Estimate
from shipfp_rs.support.units import torque_factor
from shipfp_rs.vessel.steady_state import steady_state
from tests.gallery.slips import VALUES

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
