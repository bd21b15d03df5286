"""A reader that crashes, hangs or devours memory costs the user one line; the session and the next file go on."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers import child_process
from shipfp_rs.logs.readers.child_process import end_idle, idle_process
from tests import ill_readers


@pytest.fixture
def file(tmp_path: Path):
    def write(on_open: str = "nothing", on_read: str = "nothing", name: str = "log") -> Path:
        path = tmp_path / f"{name}.ill"
        path.write_text(f"{on_open} {on_read}")
        return path

    return write


ILLS = {
    "crash": r"the package json crashes on it \(SIGSEGV\)",
    "exit": r"the package json crashes on it \(exit status 3\)",
    "hang": "not read within 1 s",
    "devour": "needs more memory than three times its size and 200 MB",
    "raise": r"can't be read as \.ill: 'two\\nlines'",
}


@pytest.mark.parametrize("ill", ILLS)
def test_an_ill_reader_is_one_line_on_opening_and_on_reading(file, ill: str) -> None:
    if ill == "devour" and sys.platform != "linux":
        pytest.skip("only Linux bounds a process's memory")

    def refused(call) -> str:
        with pytest.MonkeyPatch.context() as patch:
            if ill == "hang":  # what is well may take as long as a busy machine needs
                patch.setattr(child_process, "LIMIT_S", 1.0)
            with pytest.raises(InputError, match=ILLS[ill]) as caught:
                call()
        return str(caught.value)

    assert "\n" not in refused(lambda: Log.open(file(ill)))
    log = Log.open(file("nothing", ill))
    chunks = log.chunks("a", 100)
    np.testing.assert_array_equal(next(chunks), np.arange(100))
    refused(lambda: list(chunks))
    # What the damage does not reach can still be read, and so can the next file.
    np.testing.assert_array_equal(log.read("b", 0.0, 20.0), np.arange(200))
    np.testing.assert_array_equal(Log.open(file()).read("a"), np.arange(1000, dtype=np.int32), strict=True)


def test_one_process_serves_file_after_file(file) -> None:
    first, second = Log.open(file(name="first")), Log.open(file(name="second"))
    process = idle_process()
    assert str(process) in first.channels
    assert str(process) in second.channels
    np.testing.assert_array_equal(first.read("a"), second.read("b"))
    assert idle_process() == process


def test_channels_are_read_side_by_side(file) -> None:
    one, other = Log.open(file(name="one")), Log.open(file(name="other"))
    streams = [log.chunks(name, 7) for log in (one, other) for name in ("a", "b")]
    for blocks in zip(*streams, strict=True):
        for block in blocks[1:]:
            np.testing.assert_array_equal(block, blocks[0])


def test_threads_share_a_log(file) -> None:
    log = Log.open(file())
    found: list[int] = []
    threads = [
        threading.Thread(target=lambda: found.append(sum(map(np.sum, log.chunks("a", 10))))) for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [499_500] * 8


def test_a_file_replaced_under_a_read_ends_that_read(file) -> None:
    log = Log.open(file())
    chunks = log.chunks("a", 10)
    next(chunks)
    os.utime(file(), (1, 1))
    assert len(log.read("b")) == ill_readers.SAMPLES
    with pytest.raises(InputError, match="was replaced while channel 'a' was read; read it again"):
        next(chunks)


def test_a_read_that_is_left_off_leaves_the_next_one_whole(file) -> None:
    log = Log.open(file())
    chunks = log.chunks("a", 10)
    next(chunks)
    del chunks
    np.testing.assert_array_equal(log.read("a"), np.arange(1000))


@pytest.fixture
def ctrl_c():
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a job in the background has it ignored
    yield lambda thread: signal.pthread_kill(thread, signal.SIGINT)
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send to a thread")
def test_an_interrupt_ends_the_child_and_the_next_read_starts_another(file, ctrl_c) -> None:
    log = Log.open(file("nothing", "hang"))
    chunks = log.chunks("a", 100)
    next(chunks)
    # Sent to the process it may strike the timer's own thread, and leave the one that reads asleep.
    threading.Timer(0.5, ctrl_c, [threading.get_ident()]).start()
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        list(chunks)
    assert time.monotonic() - begin < child_process.LIMIT_S / 2
    np.testing.assert_array_equal(log.read("b", 0.0, 20.0), np.arange(200))


def test_what_a_package_prints_and_warns_stays_with_it(file, capfd: pytest.CaptureFixture[str]) -> None:
    np.testing.assert_array_equal(Log.open(file("print", "print")).read("a"), np.arange(1000))
    assert capfd.readouterr() == ("", "")
    with pytest.warns(LogWarning, match="one channel is left out") as caught:
        Log.open(file("warn"))
    assert len(caught) == 1


def test_a_file_that_was_replaced_is_opened_anew(file) -> None:
    log = Log.open(file())
    path = file("raise")
    os.utime(path, (1, 1))
    with pytest.raises(InputError, match="can't be read"):
        log.read("a")


def test_a_missing_package_is_named_with_its_remedy(tmp_path: Path) -> None:
    path = tmp_path / "log.lacking"
    path.write_text("x")
    with pytest.raises(InputError, match=r"a_package_that_nobody_has; pip install 'shipfp_rs\[lacking\]'"):
        Log.open(path)


def test_the_idle_child_can_be_ended(file) -> None:
    Log.open(file())
    process = idle_process()
    assert process is not None
    end_idle()
    assert idle_process() is None
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
