"""Experiments as tables: Parquet files with one row per sample, and pandas data frames."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import TIME, UNITS, Experiment
from shipfp_rs.support.arguments import Rule, checked
from shipfp_rs.support.files import ending_in, local, replacing
from shipfp_rs.support.tables import FACTS

TIMES = ("time", TIME)
"""Names of the time column [s]."""


def is_frame(value: Any) -> bool:
    """Whether a value is a `pandas.DataFrame`, without an import of pandas."""
    return type(value).__name__ == "DataFrame" and type(value).__module__.split(".")[0] == "pandas"


Frame = Annotated[Any, Rule("a pandas.DataFrame", is_frame)]


def of_frames(data: Any) -> Any:
    """Return the data with each frame replaced by an experiment."""
    if is_frame(data):
        return experiment_of(data)
    if isinstance(data, Sequence):
        return [experiment_of(one) if is_frame(one) else one for one in data]
    return data


@checked
def experiment_of(frame: Frame) -> Experiment:
    """Return the experiment whose signals are the columns of a data frame.

    Parameters
    ----------
    frame
        `pandas.DataFrame` of N rows at equidistant times. Its columns are signals, with names and units of
        `experiments.experiment.UNITS`: n_set, n_e [rpm], n_s [rev/s], M_s, M_b, M_g, M_load [Nm], X_f [mm]. Its time is a
        column `time` or `time_s`, or the index: seconds, dates or time spans.

    Returns
    -------
    Experiment
        Experiment whose operating point is the means of its signals; a frame from `Experiment.to_pandas` keeps its
        stored operating point.

    Raises
    ------
    InputError
        If there is no time, the times are not equidistant, or a column is not a known signal.

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


METADATA_KEY = b"shipfp_experiments"


@checked
def write_experiments(path: str | Path, experiments: Sequence[Experiment]) -> Path:
    """Write experiments to a Parquet file that any Parquet reader can open; the file is written completely or not at all.

    Columns are `experiment`, `time_s` and the signals, with units in the field metadata. Masked samples are NaN; the
    column of a signal that an experiment does not have is null. Rate, operating point, hold, kind and provenance are
    JSON in the file's metadata.

    Parameters
    ----------
    path
        File to write.
    experiments
        At least one, with different names.

    Raises
    ------
    InputError
        If there is no experiment, two share a name, or the file can't be written.
    """
    path = ending_in(path, ".parquet", ".pq")
    names = [experiment.name for experiment in experiments]
    if not names or len(set(names)) != len(names):
        raise InputError(f"{path}: experiments named {names}, expected at least one and each name once")
    signals = [name for name in UNITS if any(name in experiment.signals for experiment in experiments)]
    schema = pa.schema(
        [
            pa.field("experiment", pa.dictionary(pa.int32(), pa.string())),
            pa.field("time_s", pa.float64(), metadata={"unit": "s"}),
            *(pa.field(name, pa.float64(), metadata={"unit": UNITS[name]}) for name in signals),
        ],
        metadata={METADATA_KEY: json.dumps([_attributes(experiment) for experiment in experiments])},
    )
    with (
        replacing(path) as temporary,
        pq.ParquetWriter(local(temporary), schema, compression="zstd") as writer,
    ):
        for experiment in experiments:
            length = len(experiment)
            columns = [
                pa.DictionaryArray.from_arrays(np.zeros(length, dtype=np.int32), [experiment.name]),
                pa.array(experiment.time),
                *(
                    pa.array(experiment.signals[name])
                    if name in experiment.signals
                    else pa.nulls(length, pa.float64())
                    for name in signals
                ),
            ]
            writer.write_table(pa.table(columns, schema=schema), row_group_size=length)
    return path


@checked
def read_experiments(path: str | Path) -> tuple[Experiment, ...]:
    """Read experiments from a file that `write_experiments` wrote.

    Raises
    ------
    InputError
        If the file is missing or was not written by `write_experiments`.
    """
    path = Path(path)
    try:
        with pq.ParquetFile(local(path)) as file:
            attributes = json.loads((file.schema_arrow.metadata or {})[METADATA_KEY])
            return tuple(
                _experiment(file.read_row_group(index), facts) for index, facts in enumerate(attributes)
            )
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: can't be read as Parquet, {error}") from error
    except KeyError as error:
        raise InputError(
            f"{path}: holds no experiments; expected a file written by write_experiments"
        ) from error


def _attributes(experiment: Experiment) -> dict[str, Any]:
    return {"signals": list(experiment.signals), **experiment._columns().facts}


def _experiment(table: pa.Table, attributes: Mapping[str, Any]) -> Experiment:
    return Experiment(
        name=attributes["name"],
        rate_hz=attributes["rate_hz"],
        signals={name: table[name].to_numpy() for name in attributes["signals"]},
        operating_point=attributes["operating_point"],
        hold=attributes["hold"],
        kind=attributes["kind"],
        provenance=attributes["provenance"],
    )
