"""Shared by the tests: what is slow to make is made once."""

# ruff: noqa: E402
from __future__ import annotations

import os

# Before NumPy is loaded: each of the workers beside each other would take all cores, and so would what they start.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")

import pickle
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings

from shipfp_rs import _core
from shipfp_rs.reproduce import Reproduction

T = TypeVar("T")


def made_once(temporary: Path, name: str, make: Callable[[], T]) -> T:
    """Return what the first worker that needs it makes; the others wait, and read its file."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return make()
    file = temporary.parent / f"{name}.pickle"
    with FileLock(f"{file}.lock"):
        if not file.exists():
            file.write_bytes(pickle.dumps(make()))
    found: T = pickle.loads(file.read_bytes())
    return found


@pytest.fixture(scope="session")
def fullscale(tmp_path_factory: pytest.TempPathFactory) -> Reproduction:
    """Table 7.1, refitted."""
    from shipfp_rs.reproduce.fullscale import reproduce

    return made_once(tmp_path_factory.getbasetemp(), "fullscale", reproduce)


# How long a machine takes that others use, too, says nothing. A method has a new object for each parameter of its class.
settings.register_profile(
    "shared", deadline=None, suppress_health_check=[HealthCheck.differing_executors, HealthCheck.too_slow]
)
settings.load_profile("shared")

# In the background of a shell Ctrl-C is ignored, and so it would be by every command that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WIDEST = os.environ.get("SHIPFP_INSTRUCTION_SET")
"""Widest instruction set that the tests are to use; by default the widest that this machine has.

tests/kernels/test_instruction_sets.py compares the others with it.
"""


@pytest.fixture(autouse=True)
def _no_wider_instruction_set() -> None:
    """Let the kernels of this process use no wider set than asked for, whatever the test before has chosen."""
    if WIDEST is not None:
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
    if CHROMIUM is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        # As root, as in a container, Chromium runs without its sandbox or not at all.
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        running = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield running
        running.close()
