"""Kernels obey Ctrl-C, and a panic inside one is an ordinary exception."""

import signal
import subprocess
import sys
import time

import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InternalError
from tests.kernels.long_kernels import KERNELS, SAME

ENDS_WITHIN_S = 0.5
"""Processor seconds, on cores that others use, too; Ctrl-C is to end a command within one."""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
def test_ctrl_c_ends_a_kernel_that_would_run_for_long():
    """`-s` shows how long the end took; the limit is that of a machine with much else to do."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.kernels.long_kernels", "simulate_ship"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            time.sleep(0.5)
            assert process.poll() is None
            began = time.monotonic()
            process.send_signal(signal.SIGINT)
            told, errors = process.communicate(timeout=20.0)
        finally:
            process.kill()
    took = time.monotonic() - began
    print(f"{took:.2f} s")
    assert told == ""
    assert errors.rstrip().endswith("KeyboardInterrupt")
    assert took < 10.0


def test_every_kernel_is_among_those_that_are_stopped():
    kernels = {name for name in dir(_core) if not name.startswith("_") and callable(getattr(_core, name))}
    assert kernels == (set(KERNELS) | set(SAME)) - {"spin"}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGPROF")
def test_every_kernel_ends_within_little_work():
    """`-s` shows how much, of one stop of each soon after it has begun; `python -m benches.bench_looks` makes more."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.kernels.long_kernels", "all", "1"],
        capture_output=True,
        text=True,
        timeout=300.0,
        check=True,
    )
    lines = [line.split() for line in done.stdout.splitlines()[1:]]
    longest = {kernel: float(took) for kernel, took in lines}
    print(longest)
    assert longest.keys() == KERNELS.keys() - {"spin"}
    assert {kernel: took for kernel, took in longest.items() if took >= ENDS_WITHIN_S} == {}


def test_a_panic_is_an_ordinary_exception(capfd):
    with pytest.raises(InternalError, match="internal error: propeller fell off; please report it") as raised:
        _core._panic_for_test("propeller fell off")
    assert isinstance(raised.value, Exception)
    assert "propeller fell off" in capfd.readouterr().err
