"""What can't be used is refused by name, and nothing that a caller asks for ends the process."""

import subprocess
import sys

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.twins import engine_side, ship
from tests.twins.drive_train import detail

TRAIN = (ship.vector(), detail(), np.ones(6), np.empty((3, 0)))


KERNELS = {
    "simulate_ship_by": (ship.vector(), np.ones(4), 0.01, 1, "rk4", "zero", np.ones(2), [0]),
    "simulate_detailed_ship": (*TRAIN, np.ones(4), 0.01, 1, "zero", [0]),
    "simulate_ship": (ship.vector(load_gain=1.0), np.ones(4), np.zeros(4), 0.01, 1, "zero", [0]),
    "run_recursion": (np.full((2, 4, 3), 0.1), np.zeros((2, 2)), np.ones(5), [0], 0.1),
    "find_spikes": (np.ones(9), 2, 1, 3, 5.0, 0.1),
    "running_median": (np.ones(9), 3),
    "slope_at_even_times": (np.arange(5.0), np.ones((4, 4)), 0.0, 2.0, 8),
    "taken_by_limits": (engine_side.vector(), *[np.ones(4)] * 3, 0.01),
    "pulse_levels": (np.ones(9),),
    "interval_speeds": (np.arange(4.0), np.ones(3, dtype=np.int64), *[np.ones(1)] * 4, 0.0),
    "pulses_are_even": (np.arange(9.0), 0.6, 1.6),
}


def misaligned(array):
    """The same values one byte off."""
    raw = np.zeros(array.nbytes + 1, dtype=np.uint8)
    moved = raw[1:].view(array.dtype).reshape(array.shape)
    moved[...] = array
    return moved


def spoilt(arguments):
    """Each array of a call replaced in turn by one that can't be used, with what that is."""
    for place, argument in enumerate(arguments):
        if not isinstance(argument, np.ndarray):
            continue
        others = {"text": np.array(["port"]), "object": np.array([None]), "list": [1.0, 2.0], "none": None}
        others["complex"] = argument.astype(complex)
        if argument.dtype == np.float64:
            others["other byte order"] = argument.astype(">f8")
        if argument.size and argument.dtype != bool:
            others["misaligned"] = misaligned(argument)
        if argument.size > 1:
            others["strided"] = np.repeat(argument, 2, axis=-1)[..., ::2]
        others["one axis more"] = argument[None]
        for fault, other in others.items():
            yield fault, (*arguments[:place], other, *arguments[place + 1 :])


@pytest.mark.parametrize("kernel", KERNELS)
def test_breakage_b4_arrays_that_can_not_be_used_are_named(kernel):
    call = getattr(_core, kernel)
    call(*KERNELS[kernel])
    for fault, arguments in spoilt(KERNELS[kernel]):
        with pytest.raises(InputError) as raised:
            call(*arguments)
        message = str(raised.value)
        assert "\n" not in message, (fault, message)
        assert "expected" in message, (fault, message)


def test_breakage_b4_a_misaligned_array_is_said_to_be_one():
    with pytest.raises(InputError, match=r"u: found float64 of shape \[4\], not aligned, expected"):
        _core.simulate_ship(ship.vector(), misaligned(np.ones(4)), np.zeros(4), 0.01, 1, "zero", [0])


@pytest.mark.parametrize("total", [10**12, 2**63, 2**64 - 1])
def test_breakage_b4_a_filter_makes_no_more_than_its_samples_tell(total):
    decimator = _core.Decimator(np.ones(5), 1, 2)
    made = decimator.feed(np.arange(100.0))
    with pytest.raises(InputError, match=r"total: found .* outputs of 100 samples"):
        decimator.finish(total)
    # A refusal changes nothing.
    assert len(made) + len(decimator.finish(50)) == 50


KNOTS = np.arange(3.0)
SENSELESS = [
    *[(_core.Decimator, (np.ones(3), *ratio), "up, down: found") for ratio in ((10**12, 1), (1, 10**12), (2**63, 2**63))],
    (_core.Decimator, (np.ones(1), 0, 1), "up, down: found 0 and 1"),
    (_core.Decimator, (np.ones(1), 1, 0), "found 1 and 0"),
    (_core.Decimator, (np.ones(2), 1, 1), "taps: found 2"),
    (_core.Decimator, (np.array([1.0, np.nan, 1.0]), 1, 1), "taps"),
    (_core.Decimator(np.ones(1), 1, 1).finish, (3,), "none were fed"),
    *[(_core.slope_at_even_times, (np.array([0.0, 50.0, 100.0]), np.ones((4, 2)), *times), "rate")
      for times in ((0.0, 1e12, 10**13), (1e18, 1e9, 2**62), (0.0, 1e300, 5), (-1e300, 1.0, 9))],
    (_core.slope_at_even_times, (KNOTS, np.zeros((4, 3)), 0.0, 1.0, 5), r"coefficients: found .* \[4, 3\], expected"),
    *[(_core.slope_at_even_times, (np.arange(9.0), np.ones(shape), 0.0, 1.0, 9),
       r"coefficients: found an array of shape .*, expected \[4, 8\]") for shape in ((8, 4), (2, 16), (1, 32))],
    (_core.slope_at_even_times, (np.array([1.0, 0.0]), np.zeros((4, 1)), 0.0, 1.0, 5), "ascend"),
    (_core.slope_at_even_times, (np.array([0.0, 1.0]), np.zeros((4, 1)), 0.0, 0.0, 5), "the rate positive"),
    *[(_core.running_median, (np.ones(5), window), "window: found") for window in (0, 2, 2**31 - 1, 2**31 + 1, 2**62 + 1)],
    (_core.find_spikes, (np.zeros(9), 0, 1, 3, 6.0, 0.05), "longest, stride: found 0 and 1"),
    *[(_core.find_spikes, (np.ones(5), longest, 1, 3, 5.0, 0.1), "longest") for longest in (2**62, 2**64 - 1)],
    *[(_core.find_spikes, (np.ones(9), 2, 1, 3, *pair), r"threshold|least")
      for pair in ((np.nan, 0.1), (5.0, np.nan), (np.inf, 0.1), (-1.0, 0.1))],
]  # fmt: skip


@pytest.mark.parametrize(("call", "arguments", "message"), SENSELESS)
def test_breakage_b4_b5_what_makes_no_sense_is_refused_by_name(call, arguments, message):
    with pytest.raises(InputError, match=message):
        call(*arguments)


LITTLE_MEMORY = """
import resource, sys
import numpy as np
from shipfp_rs import _core
dn_set = np.zeros(20_000_000)
resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
for kernel in (
    lambda: _core.run_recursion(np.ones((1, 11, 3)), np.zeros((1, 2)), dn_set, [0], 0.01),
    lambda: _core.slope_at_even_times(np.array([0.0, 1e6]), np.ones((4, 1)), 0.0, 1000.0, 10**9),
    lambda: _core.running_median(dn_set, 60_000_001),
    lambda: _core.interval_speeds(
        np.arange(401.0), np.full(400, 10**6), np.ones(1), np.ones(1), np.ones(1), np.ones(1), 1.0
    ),
):
    try:
        kernel()
    except MemoryError as error:
        print("refused:", str(error).splitlines()[0])
"""
NO_THREADS = """
import threading
import numpy as np
from shipfp_rs import _core
from shipfp_rs.errors import InternalError
import resource
resource.setrlimit(resource.RLIMIT_AS, (resource.getrlimit(resource.RLIMIT_AS)[0],) * 2)
n = 5_000_000
dn_set = np.zeros(n)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
# Room for what is simulated, none for a thread's stack.
resource.setrlimit(resource.RLIMIT_AS, (used + 8 * n + (1 << 20),) * 2)
try:
    _core.run_recursion(np.full((1, 3, 3), 0.1), np.zeros((1, 2)), dn_set, [0], 0.01)
except InternalError as error:
    print("refused:", error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
@pytest.mark.parametrize(("program", "times"), [(LITTLE_MEMORY, 4), (NO_THREADS, 1)])
def test_breakage_b4_without_memory_or_threads_there_is_an_exception(program, times):
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("refused:") == times, done.stdout + done.stderr[-2000:]


def test_breakage_b6_a_finished_filter_takes_no_more():
    decimator = _core.Decimator(np.ones(5), 1, 2)
    decimator.feed(np.arange(10.0))
    decimator.finish(5)
    for call in (lambda: decimator.feed(np.ones(3)), lambda: decimator.finish(5)):
        with pytest.raises(InputError, match="is finished; make a new one"):
            call()


STOPPED = """
import signal, threading, time
import numpy as np
from shipfp_rs import _core
from shipfp_rs.errors import InputError
decimator = _core.Decimator(np.ones(60_001), 1, 1)
signal.signal(signal.SIGALRM, lambda *_: (_ for _ in ()).throw(KeyboardInterrupt()))
signal.setitimer(signal.ITIMER_REAL, 0.4)
try:
    decimator.feed(np.zeros(8_000_000))
except KeyboardInterrupt:
    print("stopped")
try:
    decimator.feed(np.zeros(10))
except InputError as error:
    print("refused:", error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGALRM to send")
def test_breakage_b6_a_stopped_filter_is_not_gone_on_with():
    done = subprocess.run(
        [sys.executable, "-c", STOPPED], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.stdout.splitlines() == [
        "stopped",
        "refused: this object was stopped amid a piece; make a new one and feed it again",
    ], done.stderr[-2000:]
