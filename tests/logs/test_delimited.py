"""Text files of any common layout are understood; one that was cut loses its last record at most, and says so."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers import delimited
from tests.logger_files import WRITERS, opened


@pytest.mark.parametrize(
    ("good", "vague", "bad", "names"),
    [
        ("Good", "Uncertain", "Bad - I/O", "u [V],u Status,n [rpm],n Status"),
        ("OK", "OK", "Timeout", "A.val [V],A.state,B.val [rpm],B.state"),
        ("192", "64", "0", "u [V],u_q,n [rpm],n_q"),
        ("0", "1073741824", "2147483648", "u.Value [V],u.Code,n.Value [rpm],n.Code"),
        ("Good", "Uncertain", "Bad - I/O", "u [V],Status,n [rpm],Status"),
        ("192", "64", "0", "u [V],Quality,n [rpm],Quality"),
        ("OK", "OK", "Timeout", "u [V],State,n [rpm],State"),
    ],
)
def test_a_value_of_bad_status_is_missing_of_its_tag_alone(
    good: str, vague: str, bad: str, names: str, tmp_path: Path
) -> None:
    told = {3: vague, 5: bad, 6: bad}
    rows = [f"{0.5 * k},{k},{told.get(k, good)},{2 * k},{good}" for k in range(20)]
    with pytest.warns(LogWarning, match="samples 5 to 6; missing: the status of 2 values is bad"):
        log = opened(tmp_path, f"time [s],{names}", *rows)
    (fault,), (u, n) = log.faults, log.channels
    assert (fault.channel, fault.spans.tolist(), log.channels[n].unit) == (u, [[5, 7]], "rpm")
    assert np.flatnonzero(np.isnan(log[u])).tolist() == [5, 6]
    np.testing.assert_array_equal(log[n], 2 * np.arange(20))


@pytest.mark.parametrize("scale", [1, 0.25])
def test_equal_headings_of_numbers_beside_numbers_are_refused(scale: float, tmp_path: Path) -> None:
    rows = [f"{0.5 * k},{k},{scale * k},{2 * k},{scale * k + 3}" for k in range(20)]
    with pytest.raises(InputError, match="column 'p' appears twice"):
        opened(tmp_path, "time [s],u [V],p,n [rpm],p", *rows)


def test_times_of_edges_alone_are_no_log(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"times in 'Edge' and no values beside .* file = in \[channels\.NAME\] of"
    ):
        opened(tmp_path, "Edge [s]", "0.1", "0.21", "0.33")


def test_a_number_type_holds_in_every_part_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delimited, "PART", 64)
    large = [2**64 - 1 if k == 70 else k for k in range(100)]
    half = [k + 0.5 if k == 90 else k for k in range(100)]
    rows = [f"{k},{large[k]},{half[k]},{-k}" for k in range(100)]
    log = opened(tmp_path, "time,large,half,count", *rows)
    for name, values, dtype in (
        ("large", large, np.uint64),
        ("half", half, float),
        ("count", range(0, -100, -1), int),
    ):
        np.testing.assert_array_equal(log.read(name), np.array(values, dtype), strict=True)
        np.testing.assert_array_equal(log.read(name, 60.0, 80.0), np.array(values, dtype)[60:80])


def test_a_word_far_down_is_a_gap_that_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delimited, "PART", 64)
    rows = [f"{k},{'abc' if k == 70 else k}" for k in range(100)]
    with pytest.warns(LogWarning, match="1 cells of 'u' are no numbers and taken as missing: 'abc'"):
        log = opened(tmp_path, "time,u", *rows)
    values = log.read("u")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(values)), [70])
    np.testing.assert_array_equal(values[71:], np.arange(71, 100))


@pytest.mark.parametrize(
    ("head", "row", "units"),
    [("time;n;M", "{t:.1f} s;{n} rpm;{M} %", ("rpm", "%")), ("time;n [rpm];M", "{t:.1f};{n} rpm;+ {M}", ("rpm", "")),
     ("Source,CH1,CH2\nSecond,Volt,Volt", "{t:.1f},{n},{M}", ("V", "V")), ("time;n;M", "{t:.1f};+ {n},00;{M},0", ("", ""))],
)  # fmt: skip
def test_units_and_signs_may_stand_apart_in_cells(
    head: str, row: str, units: tuple[str, str], tmp_path: Path
) -> None:
    rows = [row.format(t=0.1 * k, n=1500 + k % 3, M=40 + k % 2) for k in range(40)]
    if "+ {n}" in row:
        rows = [each.replace(".", ",") for each in rows]
    log = opened(tmp_path, head, *rows)
    assert tuple(channel.unit for channel in log.channels.values()) == units
    speed, torque = (log.read(name) for name in log.channels)
    np.testing.assert_array_equal(speed, 1500.0 + np.arange(40) % 3)
    np.testing.assert_array_equal(torque, 40.0 + np.arange(40) % 2)


def test_a_file_cut_anywhere_loses_one_record_at_most(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.csv", tmp_path / "cut.csv"
    draw = np.random.default_rng(4)
    torque, counts = draw.standard_normal(20), draw.integers(-9999, 9999, 20)
    WRITERS["CSV"][1](whole, {"torque": torque, "counts": counts})
    content = whole.read_bytes()
    third = content.index(b"0.03,")
    for end in range(third, len(content) + 1, 7):
        cut.write_bytes(content[:end])
        lost = content[:end].rpartition(b"\n")[2].decode()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            log = Log.open(cut)
        rows = content[:end].count(b"\n") - 1
        np.testing.assert_array_equal(log.read("torque"), torque[:rows])
        np.testing.assert_array_equal(log.read("counts"), counts[:rows])
        assert len(caught) == bool(lost)
        assert all(f"{lost!r} is left out" in str(warning.message) for warning in caught)
