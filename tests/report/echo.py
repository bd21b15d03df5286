"""A model that makes speed and torque follow the set point at once."""

from __future__ import annotations

from dataclasses import replace

from shipfp_rs.experiments.experiment import Experiment


def echo(experiment: Experiment) -> Experiment:
    """Return what such a model makes of an experiment."""
    moved = 1.0 + experiment.normalised("n_set")
    signals = {name: experiment.operating_point[name] * moved for name in ("n_e", "M_g")}
    return replace(experiment, signals={"n_set": experiment.signals["n_set"], **signals})
