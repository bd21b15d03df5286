"""Sweeps as people meet them in a notebook: how far they are, and a short word at the end."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from shipfp_rs.support.progress import heard_by
from shipfp_rs.sweeps import sweep
from tests.sweep_folders import cheap_plan


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Notebook(io.StringIO):
    __module__ = "ipykernel.iostream"


@pytest.mark.parametrize("kind", [Terminal, Notebook])
def test_cases_a_sweep_says_how_far_it_is(
    kind: type[io.StringIO], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream := kind())
    found = sweep(cheap_plan(4), tmp_path / "out", executor="threads", workers=1)
    said = stream.getvalue().split("\r")[1:]
    assert [line.split(",")[0] for line in said] == [f"{25 * k} %: {k} of 4 draws" for k in range(5)]
    assert "0 failed, about " in said[2]
    assert said[4].rstrip().endswith("about 0 s left")
    assert str(found).count("\n") < 10


def test_cases_a_pipe_stays_empty_and_a_listener_hears(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    heard: list[tuple[str, float]] = []
    with heard_by(lambda what, share: heard.append((what, share))):
        sweep(cheap_plan(2), tmp_path / "heard", executor="threads", workers=1)
    assert heard == [(f"{k} of 2 draws, 0 failed", 0.5 * k) for k in range(3)]
    sweep(cheap_plan(2), tmp_path / "silent", executor="threads", workers=1)
    assert capsys.readouterr().err == ""
