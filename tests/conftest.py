"""Shared by the tests: what is slow to make is made once."""

from __future__ import annotations

import pytest

from shipfp_rs.reproduce import Reproduction


@pytest.fixture(scope="session")
def fullscale() -> Reproduction:
    """Table 7.1, refitted."""
    from shipfp_rs.reproduce.fullscale import reproduce

    return reproduce()
