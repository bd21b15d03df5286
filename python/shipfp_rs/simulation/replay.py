"""Response of a simulated vessel to a record's set point, at the record's samples."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.interpolate import make_interp_spline

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.low_pass import LowPass
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.vessel import Vessel

LEAST_RATE_HZ = 100.0
"""Rate below which a set point is interpolated, so that its shape is kept [Hz]."""
LEAD_S = 10.0
"""Time at the operating point before the record, in which filters settle and levels are measured [s]."""


@checked
def replay(vessel: Vessel, record: Experiment, at_the_shaft: bool = False) -> Experiment:
    """Return the response of a vessel to a record's set point in still water, sampled and masked like the record.

    A set point with linear course between samples (hold "first", as of processed logs) is assumed to be low-passed; the
    response is then low-passed, too.

    Parameters
    ----------
    vessel
        The ship.
    record
        Record whose set point, as deviation from its operating point, is applied about the vessel's.
    at_the_shaft
        Whether the speed is measured on the shaft behind the twist.
    """
    up = max(1, math.ceil(LEAST_RATE_HZ / record.rate_hz))
    rate = up * record.rate_hz
    lead = up * round(LEAD_S * record.rate_hz)
    moving = _between(record, up)
    samples = np.concatenate([np.zeros(lead), moving, np.full(lead, moving[-1])])
    answer = simulate(vessel, Excitation(record.name, record.kind, rate, samples, hold=record.hold))
    gear = 60.0 * vessel.gearbox.ratio
    signals = {**answer.signals, **({"n_e": answer.signals["n_s"] * gear} if at_the_shaft else {})}
    signals = {name: signals[name] for name in record.signals if name in signals}
    point = {name: float(row[lead // 2 : lead].mean()) for name, row in signals.items() if name != "E_n"}
    if up == 1 or record.hold == "zero":
        rows = {name: row[lead : lead + up * len(record) : up] for name, row in signals.items()}
    else:
        channel = Channel(record.name, "", rate, len(samples))
        low_pass = LowPass(channel, record.rate_hz, float(lead))
        rows = {name: low_pass(partial(_stretch, row), len(record)) for name, row in signals.items()}
    rows = {name: np.where(np.isnan(record.signals[name]), np.nan, row) for name, row in rows.items()}
    # The filtered set point is unknown beyond the record's ends.
    rows["n_set"] = record.signals["n_set"] - record.operating_point["n_set"] + point["n_set"]
    return replace(
        record,
        signals=rows,
        operating_point={**answer.operating_point, **point},
        provenance={"source": "simulation"},
    )


def _between(record: Experiment, up: int) -> Array:
    """Deviation of the set point [rpm] at `up` times the record's rate, shape (up N,); gaps are interpolated."""
    deviation = record.signals["n_set"] - record.operating_point["n_set"]
    at = np.arange(len(deviation))
    known = np.isfinite(deviation)
    if not known.any():
        raise InputError(f"experiment {record.name!r}: every sample of n_set is masked")
    deviation = np.interp(at, at[known], deviation[known])
    if up == 1:
        return deviation
    if record.hold == "zero":
        return np.repeat(deviation, up)
    fine = np.minimum(np.arange(up * len(at)) / up, at[-1])
    return np.asarray(make_interp_spline(at, deviation, k=5)(fine))


def _stretch(samples: Array, start: int, stop: int) -> Array:
    return samples[start:stop].copy()
