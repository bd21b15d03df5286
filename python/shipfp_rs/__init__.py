"""Ship fingerprinting: identification of a propulsion drive train's dynamic parameters from a raw trial log.

Vessel + Excitation --simulate--> Experiment
Log --process--> Experiment --identify(Structure)--> Fingerprint --> report

Other functions are imported from their modules: see the API page.
"""

from __future__ import annotations

from importlib import import_module
from logging import NullHandler, getLogger
from typing import TYPE_CHECKING, Any

from shipfp_rs._core import __version__ as __version__
from shipfp_rs.errors import InputError as InputError
from shipfp_rs.errors import ShipfpError as ShipfpError
from shipfp_rs.support.hints import no_attribute

if TYPE_CHECKING:
    from shipfp_rs import errors as errors
    from shipfp_rs import frequency as frequency
    from shipfp_rs import plot as plot
    from shipfp_rs import published as published
    from shipfp_rs import signals as signals
    from shipfp_rs import tacho as tacho
    from shipfp_rs.assessment.comparison import compare as compare
    from shipfp_rs.assessment.comparison import trend as trend
    from shipfp_rs.assessment.validation import validate as validate
    from shipfp_rs.designs import design as design
    from shipfp_rs.experiments.experiment import Experiment as Experiment
    from shipfp_rs.experiments.parquet import read_experiments as read_experiments
    from shipfp_rs.experiments.parquet import write_experiments as write_experiments
    from shipfp_rs.frequency import FrequencyResponse as FrequencyResponse
    from shipfp_rs.identification.fingerprint import Fingerprint as Fingerprint
    from shipfp_rs.identification.identify import identify as identify
    from shipfp_rs.identification.load_side import load_side as load_side
    from shipfp_rs.logs.log import Log as Log
    from shipfp_rs.processing.process import process as process
    from shipfp_rs.processing.trial import Trial as Trial
    from shipfp_rs.runs.run import run as run
    from shipfp_rs.signals import Excitation as Excitation
    from shipfp_rs.simulation.raw_log import Sensors as Sensors
    from shipfp_rs.simulation.raw_log import simulate_raw_log as simulate_raw_log
    from shipfp_rs.simulation.simulate import simulate as simulate
    from shipfp_rs.structures.structure import Parameter as Parameter
    from shipfp_rs.structures.structure import Structure as Structure
    from shipfp_rs.support.units import Calibration as Calibration
    from shipfp_rs.sweeps import sweep as sweep
    from shipfp_rs.vessel.linear_model import linearise as linearise
    from shipfp_rs.vessel.vessel import Vessel as Vessel

_WHERE = {
    "Calibration": "support.units",
    "Excitation": "signals",
    "Experiment": "experiments.experiment",
    "Fingerprint": "identification.fingerprint",
    "FrequencyResponse": "frequency",
    "Log": "logs.log",
    "Parameter": "structures.structure",
    "Sensors": "simulation.raw_log",
    "Structure": "structures.structure",
    "Trial": "processing.trial",
    "Vessel": "vessel.vessel",
    "compare": "assessment.comparison",
    "design": "designs",
    "identify": "identification.identify",
    "linearise": "vessel.linear_model",
    "load_side": "identification.load_side",
    "process": "processing.process",
    "read_experiments": "experiments.parquet",
    "run": "runs.run",
    "simulate": "simulation.simulate",
    "simulate_raw_log": "simulation.raw_log",
    "sweep": "sweeps",
    "trend": "assessment.comparison",
    "validate": "assessment.validation",
    "write_experiments": "experiments.parquet",
}
_MODULES = ("errors", "frequency", "plot", "published", "signals", "tacho")

__all__ = sorted([*_WHERE, *_MODULES, "InputError", "ShipfpError", "__version__"])

getLogger(__name__).addHandler(NullHandler())  # no output until the user adds a handler


def __getattr__(name: str) -> Any:
    # Modules are loaded on first use: importing the package does not load SciPy, pydantic or pyarrow.
    if name in _MODULES:
        return import_module(f"shipfp_rs.{name}")
    if name in _WHERE:
        return getattr(import_module(f"shipfp_rs.{_WHERE[name]}"), name)
    raise no_attribute(import_module(__name__), name)


def __dir__() -> list[str]:
    return __all__
