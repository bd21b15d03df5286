"""Conversion to and from tables of xarray, pandas, Arrow and polars, and to HTML."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array, same
from shipfp_rs.support.files import ending_in, write_text_atomically
from shipfp_rs.support.hints import Hinted

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    import xarray as xr
    from jinja2 import Environment


FACTS = "shipfp"
"""Name of the attribute, or key of a schema's metadata, that holds the object's metadata as JSON."""


class Columns(NamedTuple):
    """Table: columns by name, their units, and metadata. The first column is the time or the frequency."""

    values: Mapping[str, Array]
    units: Mapping[str, str]
    facts: Mapping[str, Any]


class Tabular(Hinted):
    """Base of classes that convert to tables: one independent column, dependent columns, and metadata.

    Tables hold the metadata (name, operating point, ...) as JSON. For tables from other programs, keywords supply
    metadata that are missing or wrong. A method whose package is not installed raises `InputError`.
    """

    @abstractmethod
    def _columns(self) -> Columns:
        """Convert the object to columns."""

    @classmethod
    @abstractmethod
    def _from_columns(cls, values: Mapping[str, Array], facts: Mapping[str, Any]) -> Self:
        """Create the object from columns and metadata."""

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        mine, its = self._columns(), other._columns()
        ordered = list(mine.values) == list(its.values)
        return ordered and same(mine.values, its.values) and same(mine.facts, its.facts)

    def __hash__(self) -> int:
        values, _, facts = self._columns()
        lengths = tuple((key, len(one)) for key, one in values.items())
        return hash((type(self).__name__, facts.get("name"), lengths))

    def __reduce__(self) -> tuple[Callable[..., Self], tuple[Mapping[str, Array], Mapping[str, Any]]]:
        """Pickle and copy the object as a table, since read-only mappings can't be pickled."""
        values, _, facts = self._columns()
        return self._from_columns, (values, facts)

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` with units in the attributes, which `to_netcdf` can store."""
        xarray = package("xarray")
        values, units, facts = self._columns()
        index, *others = values
        variables = {name: (index, values[name], {"units": units[name]}) for name in others}
        made: xr.Dataset = xarray.Dataset(
            variables, {index: (index, values[index], {"units": units[index]})}, {FACTS: json.dumps(facts)}
        )
        return made

    @classmethod
    def from_xarray(cls, dataset: xr.Dataset, **facts: Any) -> Self:
        """Create the object from a one-dimensional dataset; `facts` override its metadata.

        Raises
        ------
        InputError
            If dimension, variables or metadata do not fit the object.
        """
        if len(dataset.dims) != 1:
            raise InputError(
                f"dataset has dimensions {', '.join(map(str, dataset.dims)) or 'none'}, expected one; choose with .isel"
            )
        (index,) = dataset.dims
        columns = {str(index): dataset[index].to_numpy()}
        columns |= {str(name): dataset[name].to_numpy() for name in dataset.data_vars}
        return cls._checked(columns, dataset.attrs.get(FACTS), facts)

    def to_pandas(self) -> pd.DataFrame:
        """Return a `pandas.DataFrame` with the time or the frequency as index, and the metadata in `attrs`."""
        pandas = package("pandas")
        values, _, facts = self._columns()
        index, *others = values
        frame: pd.DataFrame = pandas.DataFrame(
            {name: values[name] for name in others}, index=pandas.Index(values[index], name=index)
        )
        frame.attrs[FACTS] = json.dumps(facts)
        return frame

    def to_csv(self, path: str | Path | None = None) -> str | Path:
        """Return `to_pandas` as CSV, or write it to a file and return its path."""
        text: str = self.to_pandas().to_csv(lineterminator="\n")
        return text if path is None else write_text_atomically(ending_in(path, ".csv"), text)

    @classmethod
    def from_pandas(cls, frame: pd.DataFrame, **facts: Any) -> Self:
        """Create the object from a frame with time [s] or frequency [Hz] as index; `facts` override its metadata.

        Raises
        ------
        InputError
            If index, columns or metadata do not fit the object.
        """
        columns = {frame.index.name or "": frame.index.to_numpy()}
        columns |= {str(name): frame[name].to_numpy() for name in frame.columns}
        return cls._checked(columns, frame.attrs.get(FACTS), facts)

    def to_arrow(self) -> pa.Table:
        """Return a `pyarrow.Table` with units in its fields' metadata. Polars converts the object without this method."""
        import pyarrow as pa

        values, units, facts = self._columns()
        fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in values]
        return pa.table(
            [pa.array(column) for column in values.values()],
            schema=pa.schema(fields, metadata={FACTS: json.dumps(facts)}),
        )

    @classmethod
    def from_arrow(cls, table: Any, **facts: Any) -> Self:
        """Create the object from a table of any package with an Arrow interface (pyarrow, polars, ...).

        The first column is the time [s] or the frequency [Hz]. Polars does not keep metadata; give them as `facts`, for
        instance ``operating_point={"n_set": 1300.0, "n_e": 1300.0}``.

        Raises
        ------
        InputError
            If it is not a table, or columns or metadata do not fit the object.
        """
        import pyarrow as pa

        try:
            read = pa.table(table)
        except (TypeError, ValueError, pa.ArrowException) as error:
            raise InputError(
                f"found a {type(table).__name__}, expected a table of Arrow or polars"
            ) from error
        columns = {name: read[name].to_numpy() for name in read.column_names}
        return cls._checked(columns, (read.schema.metadata or {}).get(FACTS.encode()), facts)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    @classmethod
    def _checked(
        cls, columns: Mapping[str, Any], stored: str | bytes | None, facts: Mapping[str, Any]
    ) -> Self:
        values = {}
        for name, column in columns.items():
            if column.dtype.kind not in "biuf":
                raise InputError(f"column {name!r} holds {column.dtype}, expected numbers; leave it out")
            values[name] = column.astype(np.float64)
        try:
            own = json.loads(stored or "{}")
        except ValueError as error:
            raise InputError(
                f"attribute {FACTS!r} is not JSON; remove it and give the metadata by keyword"
            ) from error
        return cls._from_columns(values, own | facts)


def package(name: str, distribution: str | None = None, extra: str | None = None) -> Any:
    """Import an optional package; `InputError` with the install command, whose extra has the package's name by default."""
    try:
        return __import__(name)
    except ImportError as error:
        raise InputError(
            f"{distribution or name} is not installed; install it with: pip install 'shipfp_rs[{extra or name}]'"
        ) from error


@cache
def environment() -> Environment:
    """Jinja environment with the package's templates; all text except `Markup` is escaped."""
    # Jinja loads slowly, so it is imported only when a first table is shown.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("shipfp_rs", "data/templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "allow_nan": False}
    return made


def text_table(head: Sequence[str], rows: Iterable[Sequence[str]], left: int | None = None) -> list[str]:
    """Lines of a table with a heading; columns are two spaces apart; the first `left` columns, or all, are flush left."""
    lines = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = ["<" if left is None or place < left else ">" for place in range(len(widths))]
    line = "  ".join(f"{{:{side}{width}}}" for side, width in zip(sides, widths, strict=True))
    return [line.format(*cells).rstrip() for cells in lines]


def shown(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """HTML of a title, a table and notes."""
    return environment().get_template("object.html").render(title=title, head=head, rows=rows, notes=notes)
