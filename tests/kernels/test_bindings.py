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


LITTLE_MEMORY = """
import resource, sys
import numpy as np
from shipfp_rs import _core
dn_set = np.zeros(20_000_000)
resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
for kernel in (
    lambda: _core.run_recursion(np.ones((1, 11, 3)), np.zeros((1, 2)), dn_set, [0], 0.01),
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
@pytest.mark.parametrize(("program", "times"), [(LITTLE_MEMORY, 2), (NO_THREADS, 1)])
def test_breakage_b4_without_memory_or_threads_there_is_an_exception(program, times):
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("refused:") == times, done.stdout + done.stderr[-2000:]
