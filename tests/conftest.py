"""Shared by the tests: what is slow to make is made once."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from shipfp_rs.reproduce import Reproduction


@pytest.fixture(scope="session")
def fullscale() -> Reproduction:
    """Table 7.1, refitted."""
    from shipfp_rs.reproduce.fullscale import reproduce

    return reproduce()


@pytest.fixture(autouse=True)
def _no_figure_left_open() -> Iterator[None]:
    """Close what a test drew with pyplot, so that the next one starts without."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")
