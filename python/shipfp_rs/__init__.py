"""Ship fingerprinting: the dynamic parameters of a propulsion drive train from a raw trial log.

Vessel + Excitation --simulate--> Experiment
Log --process--> Experiment --identify(Structure)--> Fingerprint --> report
"""

from __future__ import annotations

from importlib import import_module
from logging import NullHandler, getLogger
from typing import TYPE_CHECKING, Any

from shipfp_rs._core import __version__
from shipfp_rs.errors import (
    IdentificationError,
    InputError,
    InternalError,
    LogWarning,
    ShipfpError,
    SimulationError,
)

if TYPE_CHECKING:
    from shipfp_rs import frequency, plot, published, signals, tacho
    from shipfp_rs.assessment.bootstrap import bootstrap
    from shipfp_rs.assessment.closed_loop import closed_loop
    from shipfp_rs.assessment.comparison import Change, Comparison, compare, trend
    from shipfp_rs.assessment.ladder import ladder
    from shipfp_rs.assessment.leverage import leverage
    from shipfp_rs.assessment.profile_likelihood import profile_likelihood
    from shipfp_rs.assessment.ship_parameters import parameters_of, with_parameters
    from shipfp_rs.assessment.validation import CrossValidation, cross_validation, validate
    from shipfp_rs.designs import design
    from shipfp_rs.experiments.experiment import Experiment
    from shipfp_rs.experiments.parquet import read_experiments, write_experiments
    from shipfp_rs.frequency import FrequencyResponse
    from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
    from shipfp_rs.identification.identify import identify
    from shipfp_rs.logs.channel import Channel
    from shipfp_rs.logs.log import Log, register_reader
    from shipfp_rs.processing.process import process
    from shipfp_rs.processing.trial import Trial
    from shipfp_rs.signals import Excitation
    from shipfp_rs.simulation.raw_log import Truth, simulate_raw_log
    from shipfp_rs.simulation.replay import answered
    from shipfp_rs.simulation.sensors import Sensors
    from shipfp_rs.simulation.simulate import simulate
    from shipfp_rs.structures.structure import Parameter, Structure
    from shipfp_rs.support.calibration import Calibration, torque_factor
    from shipfp_rs.support.tables import Tabular
    from shipfp_rs.sweeps import sweep
    from shipfp_rs.vessel.linear_model import LinearModel, linearise
    from shipfp_rs.vessel.steady_state import BollardCurve, OperatingPoint, bollard_curve, steady_state
    from shipfp_rs.vessel.vessel import Vessel

_WHERE = {
    "BollardCurve": "vessel.steady_state",
    "Calibration": "support.calibration",
    "Change": "assessment.comparison",
    "Channel": "logs.channel",
    "Comparison": "assessment.comparison",
    "CrossValidation": "assessment.validation",
    "Estimate": "identification.fingerprint",
    "Excitation": "signals",
    "Experiment": "experiments.experiment",
    "Fingerprint": "identification.fingerprint",
    "FrequencyResponse": "frequency",
    "Identifiability": "identification.fingerprint",
    "LinearModel": "vessel.linear_model",
    "Log": "logs.log",
    "OperatingPoint": "vessel.steady_state",
    "Parameter": "structures.structure",
    "Sensors": "simulation.sensors",
    "Structure": "structures.structure",
    "Tabular": "support.tables",
    "Trial": "processing.trial",
    "Truth": "simulation.raw_log",
    "Vessel": "vessel.vessel",
    "answered": "simulation.replay",
    "bollard_curve": "vessel.steady_state",
    "bootstrap": "assessment.bootstrap",
    "closed_loop": "assessment.closed_loop",
    "compare": "assessment.comparison",
    "cross_validation": "assessment.validation",
    "design": "designs",
    "identify": "identification.identify",
    "ladder": "assessment.ladder",
    "leverage": "assessment.leverage",
    "linearise": "vessel.linear_model",
    "parameters_of": "assessment.ship_parameters",
    "process": "processing.process",
    "profile_likelihood": "assessment.profile_likelihood",
    "read_experiments": "experiments.parquet",
    "register_reader": "logs.log",
    "simulate": "simulation.simulate",
    "simulate_raw_log": "simulation.raw_log",
    "steady_state": "vessel.steady_state",
    "sweep": "sweeps",
    "torque_factor": "support.calibration",
    "trend": "assessment.comparison",
    "validate": "assessment.validation",
    "with_parameters": "assessment.ship_parameters",
    "write_experiments": "experiments.parquet",
}
_MODULES = ("frequency", "plot", "published", "signals", "tacho")

__all__ = [
    "BollardCurve",
    "Calibration",
    "Change",
    "Channel",
    "Comparison",
    "CrossValidation",
    "Estimate",
    "Excitation",
    "Experiment",
    "Fingerprint",
    "FrequencyResponse",
    "Identifiability",
    "IdentificationError",
    "InputError",
    "InternalError",
    "LinearModel",
    "Log",
    "LogWarning",
    "OperatingPoint",
    "Parameter",
    "Sensors",
    "ShipfpError",
    "SimulationError",
    "Structure",
    "Tabular",
    "Trial",
    "Truth",
    "Vessel",
    "__version__",
    "answered",
    "bollard_curve",
    "bootstrap",
    "closed_loop",
    "compare",
    "cross_validation",
    "design",
    "frequency",
    "identify",
    "ladder",
    "leverage",
    "linearise",
    "parameters_of",
    "plot",
    "process",
    "profile_likelihood",
    "published",
    "read_experiments",
    "register_reader",
    "signals",
    "simulate",
    "simulate_raw_log",
    "steady_state",
    "sweep",
    "tacho",
    "torque_factor",
    "trend",
    "validate",
    "with_parameters",
    "write_experiments",
]

getLogger(__name__).addHandler(NullHandler())  # silent until the user gives the logger "shipfp_rs" a handler


def __getattr__(name: str) -> Any:
    # Loaded on first use: importing the package costs no SciPy, pydantic or pyarrow.
    if name in _MODULES:
        return import_module(f"shipfp_rs.{name}")
    if name in _WHERE:
        return getattr(import_module(f"shipfp_rs.{_WHERE[name]}"), name)
    raise AttributeError(f"module 'shipfp_rs' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
