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
    from shipfp_rs.assessment.bootstrap import bootstrap
    from shipfp_rs.assessment.comparison import compare, trend
    from shipfp_rs.assessment.ladder import ladder
    from shipfp_rs.assessment.profile_likelihood import profile_likelihood
    from shipfp_rs.assessment.validation import cross_validation, validate
    from shipfp_rs.designs import design
    from shipfp_rs.experiments.experiment import Experiment
    from shipfp_rs.frequency import FrequencyResponse
    from shipfp_rs.identification.fingerprint import Fingerprint
    from shipfp_rs.identification.identify import identify
    from shipfp_rs.logs.log import Log
    from shipfp_rs.processing.process import process
    from shipfp_rs.processing.trial import Trial
    from shipfp_rs.simulation.simulate import simulate
    from shipfp_rs.structures.structure import Structure
    from shipfp_rs.sweeps import sweep
    from shipfp_rs.vessel.linear_model import linearise
    from shipfp_rs.vessel.vessel import Vessel

_WHERE = {
    "Experiment": "experiments.experiment",
    "Fingerprint": "identification.fingerprint",
    "FrequencyResponse": "frequency",
    "Log": "logs.log",
    "Structure": "structures.structure",
    "Trial": "processing.trial",
    "Vessel": "vessel.vessel",
    "bootstrap": "assessment.bootstrap",
    "compare": "assessment.comparison",
    "cross_validation": "assessment.validation",
    "design": "designs",
    "identify": "identification.identify",
    "ladder": "assessment.ladder",
    "linearise": "vessel.linear_model",
    "process": "processing.process",
    "profile_likelihood": "assessment.profile_likelihood",
    "simulate": "simulation.simulate",
    "trend": "assessment.comparison",
    "sweep": "sweeps",
    "validate": "assessment.validation",
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
