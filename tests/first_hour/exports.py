"""Writers of text as oscilloscopes, measuring amplifiers, logic analysers and controllers export it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import timedelta
from pathlib import Path

import numpy as np

from tests.logger_files import START

Columns = Mapping[tuple[str, str], np.ndarray]


def _rows(rate_hz: float, columns: Columns, form: str = ".7g") -> Iterator[tuple[float, list[str]]]:
    """Yield the time [s] of each row and its cells."""
    for k, row in enumerate(zip(*columns.values(), strict=True)):
        yield k / rate_hz, ["" if np.isnan(value) else f"{value:{form}}" for value in row]


def _write(path: Path, head: Iterable[str], rows: Iterable[str], encoding: str = "utf-8") -> None:
    path.write_text("\r\n".join([*head, *rows]) + "\r\n", encoding=encoding, newline="")


def _units(columns: Columns) -> list[str]:
    return [unit for _, unit in columns]


def _names(columns: Columns) -> list[str]:
    return [name for name, _ in columns]


def tektronix(path: Path, rate_hz: float, columns: Columns) -> None:
    """An oscilloscope's own units at its inputs, labels above the names of the inputs, a time with few digits."""
    inputs = [f"CH{k + 1}" for k in range(len(columns))]
    each = {"Waveform Type": "ANALOG", "Horizontal Units": "s", "Sample Interval": f"{1.0 / rate_hz:.6E}",
            "Record Length": str(len(next(iter(columns.values()))))}  # fmt: skip
    head = ["Model,MSO58", "Firmware Version,2.0.3.950", ""]
    head += [",".join([key, *[value] * len(inputs)]) for key, value in each.items()]
    head += [",".join(["Vertical Units", *_units(columns)]), "," * len(inputs)]
    head += [",".join(["Label", *_names(columns)]), ",".join(["TIME", *inputs])]
    _write(path, head, (",".join([f"{t - 5.0:.6e}", *cells]) for t, cells in _rows(rate_hz, columns)))


def picoscope(path: Path, rate_hz: float, columns: Columns) -> None:
    """Units of its probes in brackets below the names, and a blank line."""
    units = [f"({unit})" for unit in _units(columns)]
    head = [",".join(["Time", *_names(columns)]), ",".join(["(s)", *units]), ""]
    _write(path, head, (",".join([f"{t:.8f}", *cells]) for t, cells in _rows(rate_hz, columns, ".8f")))


def labview(path: Path, rate_hz: float, columns: Columns) -> None:
    """Two headers, a first column without times, decimal commas, and a column of comments."""
    count, samples = len(columns), len(next(iter(columns.values())))
    first = {"Writer_Version": "2", "Reader_Version": "2", "Separator": "Tab", "Decimal_Separator": ",",
             "Multi_Headings": "No", "X_Columns": "No", "Time_Pref": "Relative", "Operator": "Lab",
             "Date": f"{START:%Y/%m/%d}", "Time": f"{START:%H:%M:%S},938945770263671875"}  # fmt: skip
    each = {"Samples": str(samples), "Date": first["Date"], "Time": first["Time"], "X_Dimension": "Time",
            "X0": "0,0000000000000000E+0", "Delta_X": f"{1.0 / rate_hz:.6f}".replace(".", ",")}  # fmt: skip
    lines = [f"{key}\t{value}" for key, value in first.items()]
    head = [
        "LabVIEW Measurement\t",
        *lines,
        "***End_of_Header***\t",
        "\t",
        f"Channels\t{count}" + "\t" * count,
    ]
    head += ["\t".join([key, *[value] * count]) + "\t" for key, value in each.items()]
    head.insert(-2, "\t".join(["Y_Unit_Label", *_units(columns)]) + "\t")
    head += ["***End_of_Header***" + "\t" * (count + 1), "\t".join(["X_Value", *_names(columns), "Comment"])]
    _write(
        path, head, ("\t" + "\t".join(cells).replace(".", ",") for _, cells in _rows(rate_hz, columns, ".6f"))
    )


def catman(path: Path, rate_hz: float, columns: Columns) -> None:
    """Tabs, also at every end, decimal commas, one byte a letter, and a time that tells the name of its rate."""
    names = [f"{name} [{unit}]" for name, unit in columns]
    rows = (
        "\t".join([f"{t:.4f}", *cells, ""]).replace(".", ",") for t, cells in _rows(rate_hz, columns, ".6f")
    )
    _write(path, ["\t".join(["Zeit  1 - Standardmessrate [s]", *names, ""])], rows, "latin-1")


def yokogawa(path: Path, rate_hz: float, columns: Columns) -> None:
    """What is known of each trace in lines of its own, and no names above the records."""
    count, samples = len(columns), str(len(next(iter(columns.values()))))
    before = {"Header Size": "15", "Model Name": '"DL850E"', "Comment": '"Trial"'}
    each = {"BlockNumber": "1", "TraceName": _names(columns), "BlockSize": samples, "VUnit": _units(columns),
            "SampleRate": f"{rate_hz:.7E}", "HResolution": f"{1.0 / rate_hz:.7E}", "HOffset": "-2.0000000E+00",
            "HUnit": ["s"] * count, "DisplayBlockSize": samples, "DisplayPointNo.": "1",
            "Date": [f"{START:%Y/%m/%d}"] * count, "Time": [f"{START:%H:%M:%S.00}"] * count}  # fmt: skip
    head = [f'"{key}",{value}' for key, value in before.items()]
    for key, told in each.items():
        cells = [told] * count if isinstance(told, str) else [f'"{cell}"' for cell in told]
        head.append(",".join([f'"{key}"', *cells]))
    _write(path, [*head, ""], (",".join([f"{t - 2.0:.6E}", *c]) for t, c in _rows(rate_hz, columns, ".6E")))


def long_table(path: Path, rate_hz: float, columns: Columns) -> None:
    """One value a row, with the name of its signal and its unit, as a historian gives it."""
    rows = (
        f"{START + timedelta(seconds=t):%Y-%m-%dT%H:%M:%S.%f}Z,{name},{cell},{unit}"
        for t, cells in _rows(rate_hz, columns)
        for (name, unit), cell in zip(columns, cells, strict=True)
    )
    _write(path, ["time,name,value,unit"], rows)


def two_rates(path: Path, rate_hz: float, columns: Columns) -> None:
    """The last channel is sampled at every fifth row, and blank between."""
    *_, (last, slow) = columns.items()
    slow = np.where(np.arange(len(slow)) % 5 == 0, slow, np.nan)
    head = [";".join(["Tempo [s]", *(f"{name} [{unit}]" for name, unit in columns)])]
    told = _rows(rate_hz, {**columns, last: slow})
    _write(path, head, (";".join([f"{t:.3f}", *cells]).replace(".", ",") for t, cells in told))


def controller(path: Path, rate_hz: float, columns: Columns) -> None:
    """Values that a controller holds for two rows, beside dates of ISO 8601 with decimal commas."""
    held = {key: np.repeat(values[::2], 2)[: len(values)] for key, values in columns.items()}
    head = [";".join(["Zeitstempel", *(f"{name} [{unit}]" for name, unit in columns)])]
    stamped = ((START + timedelta(seconds=t), cells) for t, cells in _rows(rate_hz, held, ".2f"))
    _write(path, head, (
        ";".join([f"{at:%Y-%m-%d %H:%M:%S.%f}"[:-3], *cells]).replace(".", ",") for at, cells in stamped
    ))  # fmt: skip


def edges(path: Path, name: str, rises_s: np.ndarray, falls_s: np.ndarray) -> None:
    """A logic analyser's rows: the state at its start, and one at each change."""
    changes = sorted([(t, 1) for t in rises_s] + [(t, 0) for t in falls_s])
    rows = [(0.0, 1 - changes[0][1]), *changes]
    _write(path, [f"Time [s],{name}"], (f"{t:.9f},{state}" for t, state in rows))


def _plain(rate_hz: float, columns: Columns, clock: str = "Time [s]") -> Iterator[list[str]]:
    """Headings and rows of a table with a time."""
    yield [clock, *(f"{name} [{unit}]" for name, unit in columns)]
    yield from ([f"{t:.4f}", *cells] for t, cells in _rows(rate_hz, columns))


def csv_with_units(path: Path, rate_hz: float, columns: Columns) -> None:
    """Units in brackets behind the names."""
    _write(path, [], map(",".join, _plain(rate_hz, columns)))


def csv_with_commas(path: Path, rate_hz: float, columns: Columns) -> None:
    """The same with decimal commas."""
    rows = map(";".join, _plain(rate_hz, columns, "Zeit [s]"))
    _write(path, [], (row.replace(".", ",") for row in rows))


def csv_with_a_line_of_units(path: Path, rate_hz: float, columns: Columns) -> None:
    """Units in a line of their own."""
    _, *rows = map(",".join, _plain(rate_hz, columns))
    _write(path, [",".join(["Time", *_names(columns)]), ",".join(["s", *_units(columns)])], rows)


def statuses(path: Path, rate_hz: float, columns: Columns) -> None:
    """A historian's columns of status: a value that it calls bad is zero."""
    bad = {(key, row) for j, key in enumerate(columns) for row in range(500 + 300 * j, 510 + 300 * j)}
    told = {key: np.where([(key, row) in bad for row in range(len(x))], 0.0, x) for key, x in columns.items()}
    head = ",".join(["Time [s]", *(f"{name} [{unit}],{name} Status" for name, unit in columns)])
    _write(path, [head], (
        f"{t:.4f}," + ",".join(f"{x},{'Bad' if (key, k) in bad else 'Good'}" for key, x in zip(columns, cells, strict=True))
        for k, (t, cells) in enumerate(_rows(rate_hz, told))
    ))  # fmt: skip


def times_of_each(path: Path, rate_hz: float, columns: Columns) -> None:
    """Each channel has a column of times, and begins a row after the one before it."""
    count = len(next(iter(columns.values())))
    head = [cell for name, unit in columns for cell in ("Time [s]", f"{name} [{unit}]")]
    cells = [
        [f"{k / rate_hz:.4f},{x[k]:.7g}" if k < count else "," for k in range(j, count + j)]
        for j, x in enumerate(columns.values())
    ]
    _write(path, [",".join(head)], map(",".join, zip(*cells, strict=True)))


def packed_clock(path: Path, rate_hz: float, columns: Columns) -> None:
    """The time of day as one number, 95959.98, over the hour."""
    head, *rows = _plain(rate_hz, columns, "Time")
    at = (
        f"{START.replace(hour=9, minute=59, second=20) + timedelta(seconds=float(t)):%H%M%S.%f}"
        for t, *_ in rows
    )
    _write(path, [",".join(head)], (",".join([clock, *row[1:]]) for clock, row in zip(at, rows, strict=True)))  # fmt: skip


def twice(path: Path, rate_hz: float, columns: Columns) -> None:
    """Each row stands there twice."""
    head, *rows = map(",".join, _plain(rate_hz, columns))
    _write(path, [head], (row for row in rows for _ in range(2)))


def carriage_returns(path: Path, rate_hz: float, columns: Columns) -> None:
    """Lines that end in CR alone."""
    path.write_text("".join(f"{','.join(row)}\r" for row in _plain(rate_hz, columns)), newline="")


def on_change(path: Path, rate_hz: float, columns: Columns) -> None:
    """The first channel has a resolution of a half, and stands only where it changes."""
    (first, values), *rest = columns.items()
    values = np.round(2.0 * values) / 2.0
    told = np.where(np.diff(values, prepend=np.nan) == 0.0, np.nan, values)
    _write(path, [], map(",".join, _plain(rate_hz, {first: told, **dict(rest)})))


def with_units(path: Path, rate_hz: float, columns: Columns) -> None:
    """Each cell has its unit."""
    _write(path, [",".join(["Time [s]", *_names(columns)])], (
        ",".join([f"{t:.4f}", *map(" ".join, zip(cells, _units(columns), strict=True))])
        for t, cells in _rows(rate_hz, columns)
    ))  # fmt: skip
