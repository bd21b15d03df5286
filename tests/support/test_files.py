"""Files appear whole or not at all, and nothing but a file is ever replaced by one."""

import os
import stat
import threading
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.errors import InputError
from shipfp_rs.identification.fingerprint import Identifiability
from shipfp_rs.support.files import replacing, write_text_atomically


def test_breakage_c6_a_device_stays_a_device(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.is_char_device():
        pytest.skip("this system has no /dev/full")
    with pytest.raises(InputError, match="/dev/full: can't be written, No space left on device"):
        write_text_atomically(full, "text")
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)
    link = tmp_path / "link.json"
    link.symlink_to(full)
    with pytest.raises(InputError, match="No space left"):
        write_text_atomically(link, "text")
    assert link.is_symlink()
    write_text_atomically(Path("/dev/null"), "text")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_breakage_c6_a_pipe_is_written_into(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write_text_atomically(pipe, "text")
    reader.join()
    assert read == ["text"]
    assert pipe.is_fifo()


def test_breakage_c6_a_link_stays_a_link(tmp_path: Path) -> None:
    file, link = tmp_path / "file.txt", tmp_path / "link.txt"
    file.write_text("old")
    link.symlink_to(file)
    write_text_atomically(link, "new")
    assert link.is_symlink()
    assert file.read_text() == "new"


def test_breakage_c6_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder, expected the name of a file"):
        write_text_atomically(tmp_path, "text")
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(InputError, match="circle"):
        write_text_atomically(circle / "out.txt", "text")


def test_what_goes_wrong_while_writing_is_told_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(OSError, match="cable"), replacing(path):
        raise OSError("cable")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_breakage_c6_no_log_is_replaced_by_what_has_another_kind_of_name(tmp_path: Path) -> None:
    log = fp.Log.from_arrays({"speed": np.ones(9)}, rate_hz=2.0).write(tmp_path / "log.parquet")
    before = log.read_bytes()
    found = fp.Fingerprint({}, {}, Identifiability(0, 0, 1.0), {}, {})
    steps = fp.signals.steps([1.0, -1.0], 1.0)
    record = fp.Experiment("S", 2.0, {"n_set": np.ones(9)}, {"n_set": 1.0})
    for write, ending in (
        (found.save, ".json"),
        (found.to_csv, ".csv"),
        (steps.to_csv, ".csv or .txt"),
        (lambda path: fp.write_experiments(path.with_suffix(".json"), [record]), ".parquet or .pq"),
    ):
        with pytest.raises(
            InputError, match=f"expected a name ending in {ending}, since such a file is written"
        ):
            write(log)
    assert log.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["log.parquet"]
    found.save(tmp_path / "ship")
