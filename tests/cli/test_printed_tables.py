"""Tables on a terminal and in a pipe: no heading is cut, whatever the width."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from shipfp_rs import cli
from shipfp_rs.assessment.comparison import Change
from shipfp_rs.cli import options
from shipfp_rs.cli.sweep import _print
from shipfp_rs.identification.estimate import ALONG, Estimate

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


def test_a_table_of_estimates_fits_a_terminal_and_says_no_more_than_its_errors(monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    ranged = "the data allow any value between 0 and 1"
    found = {
        "(p-g)/(vK_i)+T_set-T_f": Estimate(0.34841, 0.002, (0.346, 0.3509), "s"),
        "T_d": Estimate(0.0, 1.6e-4, (0.0, 3.21e-4), "s"),
        "T_s": Estimate(0.0, None, None, "s", "free", ALONG),
        "T_M": Estimate(0.00053, 6e-4, (-0.00075, 0.00174), "s", "prior"),
        "g": Estimate(None, status="unidentifiable", reason=ranged),
        "v": Estimate(None, status="unidentifiable", reason=ranged),
    }
    options.print_estimates("Estimates", found, {"T_d": 0.0, "T_M": 0.0004})
    printed = re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out)
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if line.strip()}
    assert rows["T_d"] == ["T_d", "0", "<", "0.00032", "0", "0.00032", "s"]
    assert (rows["T_s"][-1], rows["T_M"][-1], rows["g"][-1], rows["v"][-1]) == ("a", "b", "c", "c")
    assert printed.count("parameter") == 1
    assert printed.splitlines()[-1] == "c  not identifiable"
    assert max(map(len, printed.splitlines())) <= 80


def test_what_was_zero_before_does_not_change_by_nan_per_cent() -> None:
    change = Change("T_d", "s", 0.0, 0.0213, 0.0213, float("nan"), (0.0194, 0.0233), 1e-9, significant=True)
    assert change.by == " by 0.02130 s"
    assert replace(change, change_pct=4.04).by == " by +4.0 %"


@pytest.mark.parametrize("command", cli.EXAMPLES, ids=lambda command: command.__name__)
def test_each_command_s_help_ends_with_an_example_that_parses(command, capsys) -> None:
    _, name, *words = cli.EXAMPLES[command].split()
    assert cli.main([name, "--help"]) == 0
    assert f"Example: shipfp {name}" in capsys.readouterr().out
    typer.main.get_command(cli.app).get_command(None, name).make_context(name, words)


def test_columns_that_init_can_not_use_are_named(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("time_s,n_set [rpm],way [furlong]\n0,1,2\n1,2,3\n2,3,4\n", encoding="utf-8")
    assert cli.main(["init", "mine", "--log", "log.csv"]) == 0
    assert "not used: way [furlong]" in capsys.readouterr().out


def test_a_shell_completes_the_names_of_ships() -> None:
    assert options.vessels("stan-l") == ["stan-launch-804"]
