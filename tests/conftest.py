"""Shared by the tests: what is slow to make is made once."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from shipfp_rs import _core
from shipfp_rs.reproduce import Reproduction


@pytest.fixture(scope="session")
def fullscale() -> Reproduction:
    """Table 7.1, refitted."""
    from shipfp_rs.reproduce.fullscale import reproduce

    return reproduce()


# A method of a class has a new object for each instruction set; it keeps nothing between them. How long a machine takes
# that others use, too, says nothing.
settings.register_profile(
    "shared", deadline=None, suppress_health_check=[HealthCheck.differing_executors, HealthCheck.too_slow]
)
settings.load_profile("shared")

# In the background of a shell Ctrl-C is ignored, and so it would be by every command that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
KERNEL_MODULES = ("_kernel", ".test_long_records", ".test_events")
"""Ends of the names of modules whose tests run with every instruction set that this machine has."""
OWN_CHOICE = ("test_pulse_kernel",)
"""Of kernels that choose their instruction set themselves."""
WIDEST = os.environ.get("SHIPFP_INSTRUCTION_SET")
"""Instruction set of a machine that the tests are to take this one for; by default all that it has."""


def _instruction_sets() -> list[str]:
    """Names of the sets up to the widest one asked for."""
    found = list(_core._instruction_sets())
    return found if WIDEST is None else found[: found.index(WIDEST) + 1]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of kernels with each instruction set."""
    name = metafunc.module.__name__
    if name.endswith(KERNEL_MODULES) and not name.endswith(OWN_CHOICE):
        metafunc.fixturenames.append("instruction_set")
        metafunc.parametrize("instruction_set", _instruction_sets(), indirect=True, scope="module")


@pytest.fixture(scope="module")
def instruction_set(request: pytest.FixtureRequest) -> Iterator[str]:
    """Let the kernels use an instruction set, and the widest one again afterwards."""
    _core._set_instruction_set(request.param)
    yield request.param
    _core._set_instruction_set(WIDEST)


@pytest.fixture(autouse=True)
def _no_wider_instruction_set(request: pytest.FixtureRequest) -> None:
    """Let the kernels of this process use no wider set than asked for, whatever the test before has chosen."""
    if WIDEST is not None and "instruction_set" not in request.fixturenames:
        _core._set_instruction_set(WIDEST)


@pytest.fixture(autouse=True)
def _no_figure_left_open() -> Iterator[None]:
    """Close what a test drew with pyplot, so that the next one starts without."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, for tests of pages; where it or Playwright is missing they are skipped."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install playwright")
    with playwright.sync_playwright() as driver:
        # As root, as in a container, Chromium runs without its sandbox or not at all.
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        running = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield running
        running.close()
