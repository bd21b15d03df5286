"""Tables on a terminal and in a pipe: no heading is cut, whatever the width."""

from __future__ import annotations

import re
import sys

import pytest

from shipfp_rs.cli import options
from shipfp_rs.cli.sweep import _print

NAMES = [
    "case, way, structure",
    "tau_n",
    "vK_p/tau_n",
    "(p-g)/(vK_i)+T_set-T_f",
    "validation n [%]",
    "validation M [%]",
]


@pytest.mark.parametrize("width", [40, 80, 300])
def test_every_heading_is_whole_on_a_terminal(monkeypatch, capsys, width) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(width))
    options.print_table("A title that is longer than a narrow table", NAMES, [["ours", *"12345"]] * 2)
    printed = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out)
    for name in NAMES[width < 80 :]:  # names of lines may be broken between words
        assert name in printed
    assert max(map(len, printed.splitlines())) <= width


def test_a_wide_table_is_whole_in_a_pipe(capsys) -> None:
    heads = [f"a heading of some length, {place}" for place in range(20)]
    options.print_table("A title", heads, [["1"] * 20])
    lines = capsys.readouterr().out.splitlines()
    assert any(all(head in line for head in heads) for line in lines)


def test_a_sweep_of_any_size_prints_a_screen(capsys) -> None:
    figures = {"estimates": 9, "bias": 0.01, "spread": 0.1, "error_95": 0.2, "coverage": 0.95}
    parameters = {f"parameter_{place}": figures for place in range(40)}
    row = {
        "factors": {f"a.factor_{place}": 1.0 for place in range(9)},
        "done": 9,
        "failed": 0,
        "failure_rate": 0.0,
        "parameters": parameters,
    }
    summary = {
        "name": "study",
        "accuracy_pct": 5.0,
        "draws": {"total": 9000, "done": 9000, "failed": 0, "timed_out": 0},
        "parameters": parameters,
        "errors": {"InputError": 3},
        "trial_length": [{"parameter": "tau_n", "factors": {}, "note": "20 s"}] * 12,
        "by_factor": {f"a.factor_{place}": [row] * 12 for place in range(9)},
    }
    _print(summary)
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) <= 29  # and the folder
    assert "in summary.json: 18 parameters; shortest trial" in printed
    assert "by a.factor_8" in printed
