"""Ship fingerprinting: the dynamic parameters of a propulsion drive train from a raw trial log.

Vessel + Excitation --simulate--> Experiment
Log --process--> Experiment --identify(Structure)--> Fingerprint --> report
"""

from __future__ import annotations

from importlib import import_module
from logging import NullHandler, getLogger
from typing import TYPE_CHECKING, Any

from shipfp_rs._core import __version__
from shipfp_rs.errors import IdentificationError, InputError, InternalError, ShipfpError, SimulationError

if TYPE_CHECKING:
    from shipfp_rs import frequency, plot, published, signals, tacho
    from shipfp_rs.comparison import compare, trend
    from shipfp_rs.designs import design
    from shipfp_rs.experiment import Experiment
    from shipfp_rs.fingerprint import Fingerprint
    from shipfp_rs.frequency import FrequencyResponse
    from shipfp_rs.identification import identify
    from shipfp_rs.likelihood import profile_likelihood
    from shipfp_rs.linear_model import linearise
    from shipfp_rs.log import Log
    from shipfp_rs.model_ladder import ladder
    from shipfp_rs.processing import process
    from shipfp_rs.resampling import bootstrap
    from shipfp_rs.simulation import simulate
    from shipfp_rs.structure import Structure
    from shipfp_rs.sweeps import sweep
    from shipfp_rs.trial import Trial
    from shipfp_rs.validation import cross_validation, validate
    from shipfp_rs.vessel import Vessel

_WHERE = {
    "Experiment": "experiment",
    "Fingerprint": "fingerprint",
    "FrequencyResponse": "frequency",
    "Log": "log",
    "Structure": "structure",
    "Trial": "trial",
    "Vessel": "vessel",
    "bootstrap": "resampling",
    "compare": "comparison",
    "cross_validation": "validation",
    "design": "designs",
    "identify": "identification",
    "ladder": "model_ladder",
    "linearise": "linear_model",
    "process": "processing",
    "profile_likelihood": "likelihood",
    "simulate": "simulation",
    "trend": "comparison",
    "sweep": "sweeps",
    "validate": "validation",
}
_MODULES = ("frequency", "plot", "published", "signals", "tacho")

__all__ = [
    "Experiment",
    "Fingerprint",
    "FrequencyResponse",
    "IdentificationError",
    "InputError",
    "InternalError",
    "Log",
    "ShipfpError",
    "SimulationError",
    "Structure",
    "Trial",
    "Vessel",
    "__version__",
    "bootstrap",
    "compare",
    "cross_validation",
    "design",
    "frequency",
    "identify",
    "ladder",
    "linearise",
    "plot",
    "process",
    "profile_likelihood",
    "published",
    "signals",
    "simulate",
    "sweep",
    "tacho",
    "trend",
    "validate",
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
