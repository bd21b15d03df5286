"""Kernels obey Ctrl-C, and a panic inside one is an ordinary exception."""

import signal
import subprocess
import sys
import time

import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InternalError

LONG_KERNELS = {
    "spin": "_core._spin_for_test()",
    "plant": """
n_set = np.full(100_000, 1300.0 / 60.0)
_core.simulate_plant(twin.vector(), *twin.UNLIMITED, n_set, 0.01, 1_000_000, "rk4", "first", np.array([7.0, 0.0]))
""",
    "batch": """
parameters = np.tile(twin.vector(torque_exponent=2.17), (64, 1))
n_set, initial = np.full((1, 100_000), 1300.0 / 60.0), np.tile([7.0, 0.0], (64, 1))
_core.simulate_plant_batch(
    parameters, *twin.UNLIMITED, n_set, 0.01, 1_000_000, "rk4", "first", initial, 0
)
""",
}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
@pytest.mark.parametrize("kernel", LONG_KERNELS)
def test_ctrl_c_ends_a_kernel_that_would_run_for_hours(kernel):
    program = (
        "import numpy as np\nfrom shipfp_rs import _core\nfrom tests.twins import plant as twin\n"
        f"print('ready', flush=True)\n{LONG_KERNELS[kernel]}"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            time.sleep(0.3)
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=20.0)
        finally:
            process.kill()
    assert errors.rstrip().endswith("KeyboardInterrupt")


def test_a_panic_is_an_ordinary_exception(capfd):
    with pytest.raises(InternalError, match="internal error: propeller fell off; please report it") as raised:
        _core._panic_for_test("propeller fell off")
    assert isinstance(raised.value, Exception)
    assert "propeller fell off" in capfd.readouterr().err
