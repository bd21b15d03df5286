"""A command that must be refused: status 2, one line on what was expected, and nothing else."""

from __future__ import annotations

import pytest

from shipfp_rs import cli


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that must be refused, and return its one line."""
    status = cli.main(arguments)
    told = capsys.readouterr()
    assert (status, told.out) == (2, ""), told
    assert told.err.startswith("shipfp: error: ")
    assert told.err.count("\n") == 1
    assert "internal" not in told.err
    assert len(told.err) < 1000
    return told.err
