"""One draw: simulates a trial under its conditions, identifies it and returns a table row, within a time limit."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, Literal, TypeVar

import numpy as np
import pyarrow as pa

from shipfp_rs import signals
from shipfp_rs.assessment.si import parameters_of
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Kind, Sensors, simulate_raw_log, trial_tables
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import COMBINATIONS
from shipfp_rs.support.toml import validated
from shipfp_rs.sweeps.chain import Excitation
from shipfp_rs.sweeps.plan import Conditions, Plan
from shipfp_rs.vessel.vessel import Vessel

Result = TypeVar("Result")


class TimedOut(BaseException):
    """The time limit was reached. Not an `Exception`, so that `except Exception` in the work does not catch it."""


def within(limit_s: float | None, work: Callable[[], Result]) -> Result:
    """Return the result of `work`, or raise `TimedOut` in it after the limit.

    The error is raised between two steps of the interpreter; a running kernel finishes first.
    """
    if limit_s is None:
        return work()
    thread, running, lock = threading.get_ident(), True, threading.Lock()

    def stop() -> None:
        with lock:
            if running:
                raise_in(thread, TimedOut)

    timer = threading.Timer(limit_s, stop)
    timer.daemon = True
    timer.start()
    try:
        result = work()
    finally:
        timer.cancel()
        with lock:
            running = False
            # Cancel an error that is requested but not yet raised: the work is done, and later code must not be
            # interrupted.
            raise_in(thread, None)
    return result


def raise_in(thread: int, error: type[BaseException] | None) -> None:
    """Raise an exception in a thread; None cancels a pending one."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread), None if error is None else ctypes.py_object(error)
    )


DrawStatus = Literal["done", "failed", "timed_out"]
FIGURES = ("estimate", "std", "low", "high")


def names_of(structure: Structure) -> list[str]:
    """Names of the estimates in a row: free parameters, and combinations of the structure."""
    ones = dict.fromkeys(structure.names, 1.0)
    derived = [name for name in COMBINATIONS if name not in ones and _applies(name, ones)]
    return [*(parameter.name for parameter in structure.free), *derived]


def _applies(name: str, values: dict[str, float]) -> bool:
    try:
        COMBINATIONS[name][1](values)
    except KeyError:
        return False
    return True


def schema_of(plan: Plan) -> pa.Schema:
    """Schema of `results.parquet`: index, seed, status, factors, truth, estimates, intervals and fits of each draw."""
    names = names_of(plan.structure)
    return pa.schema(
        [
            ("index", pa.int64()),
            ("seed", pa.int64()),
            ("status", pa.string()),
            ("error", pa.string()),
            ("message", pa.string()),
            *(
                (f"factor.{key}", pa.string() if factor.is_text else pa.float64())
                for key, factor in sorted(plan.factors.items())
            ),
            *((f"truth.{name}", pa.float64()) for name in names),
            *((f"{figure}.{name}", pa.float64()) for figure in FIGURES for name in names),
            *((f"state.{name}", pa.string()) for name in names),
            *((f"fit.{output}", pa.float64()) for output in plan.structure.outputs),
            ("converged", pa.bool_()),
        ]
    )


def run_draws(plan: Plan, indices: Sequence[int]) -> pa.RecordBatch:
    """Rows of some draws; errors of a draw are recorded in its row."""
    return pa.RecordBatch.from_pylist([_row(plan, index) for index in indices], schema=schema_of(plan))


def lost_row(plan: Plan, index: int, message: str) -> pa.RecordBatch:
    """Row of a draw without a result, since its process ended."""
    row = _opening(plan, index) | {"status": "failed", "error": "WorkerLost", "message": message}
    return pa.RecordBatch.from_pylist([row], schema=schema_of(plan))


def _opening(plan: Plan, index: int) -> dict[str, Any]:
    factors = {
        key: str(value) if plan.factors[key].is_text else float(value)
        for key, value in plan.factor_values(index).items()
    }
    seed = plan.seed_of(index)
    return {"index": index, "seed": seed} | {f"factor.{key}": value for key, value in factors.items()}


def _row(plan: Plan, index: int) -> dict[str, Any]:
    row = _opening(plan, index)
    status: DrawStatus = "done"
    try:
        row |= within(plan.sweep.time_limit_s, lambda: dict(_found(plan, index)))
    except TimedOut:
        status = "timed_out"
        row |= {"error": "TimedOut", "message": f"not done within {plan.sweep.time_limit_s:g} s"}
    except Exception as error:  # any failure of a draw is recorded in its row and does not end the sweep
        status = "failed"
        row |= {"error": type(error).__name__, "message": " ".join(str(error).split())}
    return row | {"status": status}


def _found(plan: Plan, index: int) -> Iterator[tuple[str, Any]]:
    conditions = plan.conditions_with(plan.factor_values(index))
    vessel = plan.ship.replace(conditions.vessel) if conditions.vessel else plan.ship
    names = names_of(plan.structure)
    truth = _truth(vessel, conditions.operating_point.n_e_rpm, plan.structure)
    yield from ((f"truth.{name}", truth.get(name)) for name in names)
    seed = plan.seed_of(index)
    make = _from_log if plan.sweep.chain == "log" else _from_experiment
    options, experiments = conditions.identify, make(conditions, vessel, seed)
    fingerprint = identify(
        experiments,
        plan.structure,
        vessel=plan.ship.name,
        seed=seed,
        **options.options,
    )
    yield from _estimates(fingerprint, names)


def _truth(vessel: Vessel, n_e_rpm: float | None, structure: Structure) -> dict[str, float]:
    """True parameters of the ship by name.

    If the structure has no actuator lag, the ship's lag is added to the dead time, as in `linearise`.
    """
    truth = parameters_of(vessel, n_e_rpm)
    if "tau_act" not in structure.names:
        truth["T_d"] += truth["tau_act"]
    return truth


def _estimates(fingerprint: Fingerprint, names: Sequence[str]) -> Iterator[tuple[str, Any]]:
    estimates = {**fingerprint.derived, **fingerprint.parameters}
    for name in names:
        if name in estimates:
            estimate = estimates[name]
            low, high = estimate.ci95 or (None, None)
            figures = (estimate.value, estimate.std, low, high)
            yield from ((f"{figure}.{name}", value) for figure, value in zip(FIGURES, figures, strict=True))
            yield f"state.{name}", estimate.status
    for output, figures_of_fit in fingerprint.fit.items():
        if output != "overall":
            yield f"fit.{output}", figures_of_fit["nrmse_pct"]
    yield "converged", fingerprint.settings["converged"]


# Cached, since the set point is often the same in all draws, and making a multisine takes longer than the fit to it.
@lru_cache(maxsize=4)
def _excitation(settings: Excitation, rate_hz: float, seed: int) -> signals.Excitation:
    return signals.standard(
        settings.kind,
        settings.duration_s,
        settings.amplitude_rpm,
        start_hz=settings.start_hz,
        stop_hz=settings.stop_hz,
        rate_hz=rate_hz,
        seed=seed,
    )


def _excitation_for(conditions: Conditions, rate_hz: float, seed: int) -> signals.Excitation:
    settings = conditions.excitation
    return _excitation(settings, rate_hz, seed if settings.kind in ("prbs", "noise") else 0)


def _from_experiment(conditions: Conditions, vessel: Vessel, seed: int) -> Experiment:
    noise, n_e_rpm = conditions.noise, conditions.operating_point.n_e_rpm
    excitation = _excitation_for(conditions, conditions.excitation.rate_hz, seed)
    clean = simulate(vessel, excitation, n_e_rpm=n_e_rpm)
    # Noise is relative to the operating point, as for a sensor; a larger excitation has a higher signal-to-noise ratio.
    levels = {
        name: noise.level * getattr(noise, name) * abs(clean.operating_point[name]) / float(np.std(samples))
        for name, samples in clean.signals.items()
        if getattr(noise, name, 0.0) > 0.0
    }
    if not levels or not noise.level:
        return clean
    coloured = {name: (level, noise.correlation) for name, level in levels.items()}
    return simulate(vessel, excitation, n_e_rpm=n_e_rpm, noise=coloured, seed=seed)


def _from_log(conditions: Conditions, vessel: Vessel, seed: int) -> list[Experiment]:
    given = {
        key: value
        for key, value in conditions.sensors.model_dump(exclude={"steady_s"}).items()
        if value is not None
    }
    faults = conditions.faults
    rates: dict[Kind, float] = {"A": faults.A, "B": faults.B, "C": faults.C, "D1": faults.D1}
    sensors = Sensors(**given, faults_per_minute=rates)
    log, truth = simulate_raw_log(
        vessel,
        _excitation_for(conditions, sensors.rate_hz, seed),
        sensors=sensors,
        faults=[fault for fault, rate in rates.items() if rate > 0.0],
        n_e_rpm=conditions.operating_point.n_e_rpm,
        steady_s=conditions.sensors.steady_s,
        seed=seed,
    )
    tables = trial_tables(vessel.name, "simulated", sensors, truth)
    return process(log, validated(tables, Trial, "simulated trial"), vessel)
