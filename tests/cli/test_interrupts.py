"""Ctrl-C and SIGTERM end every command within a second and leave nothing behind, whatever it is at.

`pytest tests/cli/test_interrupts.py -s` prints how long each end took; the limit is that of a machine with much else to do.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from shipfp_rs import cli
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.child_process import end_idle
from tests.cli.small_trial import SMALL
from tests.gallery.inputs import LAUNCH
from tests.sweeps.test_sweep_ends import ENDS, ended, started

BUSY_S = 1.3
"""Processor seconds after which the signal comes: half a second or so are those of imports."""
ENDS_WITHIN_S = 1.0
"""Processor seconds of the end."""
ENDS_AT_ALL_S = 20.0
"""Seconds of the end on a machine with much else to do."""
SAMPLES = 24_000_000
TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100
WRITES = {"convert": ".new.parquet.*"}
"""Commands whose signal comes as soon as a temporary file is there: how much work comes before it hangs on the machine."""
COMMANDS = {
    "inspect": ("log.parquet",),
    "convert": ("log.parquet", "new.parquet"),
    "init": ("new", "--log", "log.parquet"),
    "check": ("TRIAL.toml",),
    "run": ("TRIAL.toml",),
    "simulate": ("vessel.toml", "--duration", "60000"),
    "design": ("vessel.toml", "--duration", "20000"),
    "demo": ("--out", "out"),
    "view": ("log.parquet", "--no-browser"),
    "reproduce fullscale": ("--out", "out"),
    "reproduce virtual": ("--out", "out"),
    "reproduce twin": ("--draws", "50", "--out", "out"),
}
"""Commands with enough to do; a sweep has tests of its own, a comparison is done at once.

Every day some are ended, half of them by Ctrl-C and half by SIGTERM; at night each is ended by both.
"""
DAILY = {"convert", "check", "run", "simulate", "view", "reproduce twin"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Write a log of three channels that takes seconds to read, its trial, and a ship."""
    made = tmp_path_factory.mktemp("interrupted")
    time_s = np.arange(SAMPLES, dtype=np.float32) / np.float32(50.0)
    noise = np.random.default_rng(0).standard_normal(SAMPLES, dtype=np.float32)
    swing = np.sin(np.float32(0.3) * time_s) + np.float32(0.01) * noise
    log = Log.from_arrays(
        {"set point": 1183.8 + 40.0 * swing, "speed": 1183.8 + 39.0 * swing, "torque": 1725.0 + 80.0 * swing},
        rate_hz=50.0,
        units={"set point": "rpm", "speed": "rpm", "torque": "Nm"},
    )
    log.write(made / "log.parquet")
    last = f"stop_s = {SAMPLES / 50.0 - 1.0:g}"
    (made / "TRIAL.toml").write_text(SMALL.replace("stop_s = 39.0", last), encoding="utf-8")
    (made / "vessel.toml").write_text(LAUNCH, encoding="utf-8")
    return made


def busy_s(number: int) -> float:
    """Return the processor seconds of a process so far."""
    fields = Path(f"/proc/{number}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def children_s() -> float:
    """Return the processor seconds of all processes that have been waited for."""
    import resource  # not on Windows

    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def is_due(folder: Path, command: str, number: int) -> bool:
    """Whether a command is far enough for the signal."""
    if command in WRITES:
        return any(folder.glob(WRITES[command]))
    return busy_s(number) >= BUSY_S


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="no processor seconds of another process are told"
)
@pytest.mark.parametrize(
    ("command", "number", "status"),
    [
        pytest.param(
            command, *end, marks=() if command in DAILY and (place + way) % 2 == 0 else pytest.mark.slow
        )
        for place, command in enumerate(COMMANDS)
        for way, end in enumerate(ENDS)
    ],
)
def test_a_command_ends_at_once_and_leaves_nothing(folder, command, number, status):
    before = {path.name for path in folder.iterdir()}
    shared = set(Path("/dev/shm").iterdir()) if Path("/dev/shm").is_dir() else set()
    end_idle()  # else its seconds may be counted along
    process = started(folder, *command.split(), *COMMANDS[command])
    while command != "view" and process.poll() is None and not is_due(folder, command, process.pid):
        time.sleep(0.02)
    if command == "view":
        assert "127.0.0.1" in process.stdout.readline() + process.stdout.readline()
    before_s = children_s() + busy_s(process.pid) if process.poll() is None else children_s()
    took, told = ended(process, number)
    spent_s = children_s() - before_s
    print(f"{command}, {number.name}: {took:.2f} s, {spent_s:.2f} s of a processor")
    left = {path.name for path in folder.iterdir()} - before - {"log.parquet.shipfp-pyramid"}
    if (folder / "new.parquet").exists():
        assert len(pq.ParquetFile(folder / "new.parquet").read(columns=[0])) == SAMPLES
    for path in [folder / name for name in left]:  # what a command that was done before the signal has made
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert "Traceback" not in told
    # The command was done, and its result in place, but the interpreter had not ended yet.
    whole = left and not any(name.startswith(".") for name in left)
    late = whole and (process.returncode == -number or command in WRITES)
    if (process.returncode == 0 or late) and command != "view":
        pytest.skip("this machine was through with it when the signal came")
    # A signal before the command has begun ends it as it ends any process.
    expected = {status, -number} | ({0} if command == "view" else set())
    assert process.returncode in expected
    assert "leaked" not in told
    assert left == set()
    if shared:
        assert not {path for path in Path("/dev/shm").iterdir() if path.name.startswith("sem.")} - shared
    assert spent_s < ENDS_WITHIN_S
    assert took < ENDS_AT_ALL_S


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
@pytest.mark.parametrize("module", ["typer", "shipfp_rs.cli.view"])
def test_ctrl_c_while_modules_are_imported_leaves_no_traceback(module):
    program = f"""
import os, signal, sys
class Striking:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Striking())
import shipfp_rs.cli
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


@pytest.mark.parametrize("handler", ["default_int_handler", "SIG_IGN"])
def test_ctrl_c_is_what_it_was_once_all_is_imported(handler):
    """A shell's background commands ignore it, and go on doing so."""
    program = f"""
import signal
signal.signal(signal.SIGINT, signal.{handler})
import shipfp_rs.cli
assert signal.getsignal(signal.SIGINT) == signal.{handler}
"""
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize(("number", "status"), ENDS)
def test_an_interrupt_in_a_callback_of_the_interpreter_comes_again_and_is_not_printed(
    monkeypatch, capsys, number, status
):
    class Held:
        pass

    def app(*_, **__):
        held = Held()
        kept = weakref.ref(held, lambda _: os.kill(os.getpid(), number))
        del held
        assert kept() is None
        time.sleep(5.0)

    monkeypatch.setattr(cli, "app", app)
    hook = sys.unraisablehook
    assert cli.main([]) == status
    assert capsys.readouterr().err.count("\n") == 1
    assert sys.unraisablehook is hook


@pytest.mark.parametrize(("number", "status"), ENDS)
def test_an_error_that_a_signal_led_to_is_none(monkeypatch, capsys, number, status):
    """Libraries turn an interrupt into errors of their own."""

    def app(*_, **__):
        try:
            os.kill(os.getpid(), number)
            time.sleep(1.0)
        except KeyboardInterrupt:
            raise RuntimeError("Error calling __set_name__") from None

    monkeypatch.setattr(cli, "app", app)
    assert cli.main([]) == status
    assert "internal error" not in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers that send signals")
@pytest.mark.parametrize(("number", "status"), ENDS)
def test_an_interrupt_that_a_library_swallows_comes_again(monkeypatch, number, status):
    """Code in C that asks whether something can be imported takes an interrupt for a no."""
    went_on = []

    def app(*_, **__):
        for _ in range(3):
            try:
                os.kill(os.getpid(), number) if not went_on else None
                time.sleep(5.0)
            except KeyboardInterrupt:
                went_on.append(time.monotonic())
        time.sleep(30.0)

    monkeypatch.setattr(cli, "app", app)
    before = signal.getsignal(signal.SIGALRM)
    began = time.monotonic()
    assert cli.main([]) == status
    assert len(went_on) == 3
    assert time.monotonic() - began < 5.0
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.parametrize(("number", "status"), ENDS)
def test_what_an_interrupted_command_puts_in_order_is_left_in_peace(monkeypatch, number, status):
    done = []

    def app(*_, **__):
        try:
            os.kill(os.getpid(), number)
            time.sleep(5.0)
        finally:
            time.sleep(0.7)
            done.append("in order")

    monkeypatch.setattr(cli, "app", app)
    assert cli.main([]) == status
    assert done == ["in order"]
