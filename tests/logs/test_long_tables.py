"""A table with one value a row gives a channel for each name, whatever its columns are called."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import LogWarning
from shipfp_rs.logs.log import Log
from tests.logger_files import opened

ROWS = 60
SPEED = 1490.0 + np.arange(ROWS) % 3
TORQUE = 820.0 + np.arange(ROWS) % 5
SIGNALS = {"Set speed": ("rpm", 0.0, np.full(ROWS, 1500.0)), "Shaft speed": ("rpm", 0.01, SPEED),
           "Shaft torque": ("Nm", 0.02, TORQUE)}  # fmt: skip
Cells = Callable[[str, str, float, float], Sequence[object]]


def written(
    folder: Path, head: str, cells: Cells, *, together: bool = False, names: Sequence[str] = ()
) -> Log:
    rows = []
    for k in range(ROWS):
        for place, (name, (unit, shift, values)) in enumerate(SIGNALS.items()):
            time = round(0.5 * k + (0.0 if together else shift), 3)
            own = names[place] if names else name
            rows.append(",".join(map(str, cells(own, unit, time, values[k]))))
    return opened(folder, head, *rows)


def assert_as_written(log: Log, names: Sequence[str] = tuple(SIGNALS), *, units: bool = True) -> None:
    assert list(log.channels) == list(names)
    for own, (unit, _, values) in zip(names, SIGNALS.values(), strict=True):
        assert log.channel(own).rate_hz == pytest.approx(2.0)
        assert log.channel(own).unit == (unit if units else "")
        np.testing.assert_allclose(log.read(own), values, atol=1e-9)


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(
    ("name", "value"),
    [("sensor", "value"), ("PID", "reading"), ("series", "payload"), ("topic", "payload"), ("entity", "state"),
     ("source_name", "result"), ("number", "_value"), ("Signal name", "Wert")],
)  # fmt: skip
def test_a_long_table_is_one_by_its_rows_not_by_its_headings(
    name: str, value: str, together: bool, tmp_path: Path
) -> None:
    log = written(tmp_path, f"time [s],{name},{value}",
                  lambda n, u, t, x: (t, f"{n} [{u}]", x), together=together)  # fmt: skip
    assert_as_written(log)


@pytest.mark.parametrize("together", [False, True])
def test_numbers_may_name_the_signals_of_a_long_table(together: bool, tmp_path: Path) -> None:
    log = written(tmp_path, "time [s],PID,reading", lambda n, u, t, x: (t, n, x),
                  together=together, names=("12", "13", "98"))  # fmt: skip
    assert_as_written(log, ("PID 12", "PID 13", "PID 98"), units=False)


def test_a_long_table_may_hold_units_qualities_and_stamps_beside_its_values(tmp_path: Path) -> None:
    def cells(name: str, unit: str, time: float, value: float) -> Sequence[object]:
        return name, value, unit, f"2026-03-14T09:12:{time:06.3f}Z", "Good", 192

    assert_as_written(written(tmp_path, "entity_id,state,uom,last_changed,status,code", cells))


def test_values_of_bad_quality_are_missing(tmp_path: Path) -> None:
    def cells(name: str, unit: str, time: float, value: float) -> Sequence[object]:
        bad = name == "Shaft torque" and 10.0 <= time < 15.0
        return name, time, 0.0 if bad else value, "Bad: no communication" if bad else "Good"

    with pytest.warns(LogWarning, match="of Shaft torque.*rows missing at samples 20 to 29"):
        log = written(tmp_path, "Tag,Time (s),Value,Quality", cells)
    np.testing.assert_array_equal(log.read("Shaft torque")[30:], TORQUE[30:])
    np.testing.assert_array_equal(log.read("Shaft speed"), SPEED)


def test_two_columns_may_name_a_signal_together(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},{engine},{signal},{k % 3 + level}"
            for k in range(50) for engine, level in (("port", 900), ("starboard", 1200))
            for signal, level in (("speed", level), ("torque", level / 2))]  # fmt: skip
    log = opened(tmp_path, "time [s],device,signal,value", *rows)
    assert list(log.channels) == ["port speed", "port torque", "starboard speed", "starboard torque"]
    np.testing.assert_allclose(log.read("starboard torque"), np.arange(50) % 3 + 600.0)


def test_names_one_after_the_other_are_channels_of_the_same_times(tmp_path: Path) -> None:
    rows = [
        f"{0.1 * k:.1f},{name},{k % 3 + level}" for name, level in (("a", 1), ("b", 9)) for k in range(50)
    ]
    log = opened(tmp_path, "time [s],what,value", *rows)
    np.testing.assert_allclose(log.read("b"), np.arange(50) % 3 + 9.0)


@pytest.mark.filterwarnings("ignore::shipfp_rs.errors.LogWarning")
@pytest.mark.parametrize(
    ("beside", "cell"),
    [("quality", lambda k: "Bad" if k % 7 == 0 else "Good"), ("mode", lambda k: "ahead" if k < 30 else "astern"),
     ("gear", lambda k: 1 + k // 20), ("pulse", lambda k: k % 2), ("counter", lambda k: k % 16)],
)  # fmt: skip
def test_a_state_beside_a_channel_names_nothing(
    beside: str, cell: Callable[[int], object], tmp_path: Path
) -> None:
    values = [round(1500 + 20 * np.sin(0.1 * k), 2) for k in range(90)]
    rows = [f"{0.1 * k:.1f},{cell(k)},{x}" for k, x in enumerate(values)]
    log = opened(tmp_path, f"time [s],{beside},speed", *rows)
    np.testing.assert_allclose(log.read("speed"), values)
