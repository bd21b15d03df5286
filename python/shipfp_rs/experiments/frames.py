"""Experiments from pandas frames: signals by column names, rate by times, operating point by means."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import TIME, Experiment
from shipfp_rs.support.arguments import Rule, checked
from shipfp_rs.support.tables import FACTS

TIMES = ("time", TIME)
"""Names of the time column [s]."""


def is_frame(value: Any) -> bool:
    """Whether a value is a `pandas.DataFrame`, without an import of pandas."""
    return type(value).__name__ == "DataFrame" and type(value).__module__.split(".")[0] == "pandas"


Frame = Annotated[Any, Rule("a pandas.DataFrame", is_frame)]


def of_frames(data: Any) -> Any:
    """Return data with experiments instead of frames."""
    if is_frame(data):
        return experiment_of(data)
    if isinstance(data, Sequence):
        return [experiment_of(one) if is_frame(one) else one for one in data]
    return data


@checked
def experiment_of(frame: Frame) -> Experiment:
    """Return the experiment of a frame.

    Parameters
    ----------
    frame
        `pandas.DataFrame` of N rows at equidistant times. Its columns are signals, with names and units of
        `experiments.experiment.UNITS`: n_set, n_e [rpm], n_s [rev/s], M_s, M_b, M_g, M_load [Nm], X_f [mm]. Its time is a
        column `time` or `time_s`, or the index: seconds, dates or time spans.

    Returns
    -------
    Experiment
        About the means of the signals, except for a frame of `Experiment.to_pandas`, which has the operating point.

    Raises
    ------
    InputError
        If there is no time, it is not equidistant, or a column is no signal.

    Examples
    --------
    >>> import pandas as pd  # doctest: +SKIP
    >>> experiment_of(pd.DataFrame({"time": [0.0, 0.1], "n_set": [900.0, 910.0]})).rate_hz  # doctest: +SKIP
    10.0
    """
    if column := next((name for name in TIMES if name in frame.columns), None):
        frame = frame.set_index(column)
    elif type(frame.index).__name__ == "RangeIndex":
        raise InputError(
            "data: a frame with neither a time as its index nor a column 'time', expected one [s]"
        )
    kind = frame.index.dtype.kind
    if kind in "mM":
        spans = (frame.index - frame.index[0]).to_numpy()
        frame = frame.set_axis(spans / np.timedelta64(1, "s"), axis=0).rename_axis(column or TIME)
    if FACTS in frame.attrs:
        return Experiment.from_pandas(frame)
    means = frame.mean(numeric_only=True)
    return Experiment.from_pandas(
        frame, operating_point={str(name): float(means[name]) for name in means.index}
    )
