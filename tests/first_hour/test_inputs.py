"""Bad and hostile inputs are safe: each costs one line, nothing hangs, nothing is shown or taken that is not the trial's."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy import io, sparse

import shipfp_rs as fp
from shipfp_rs import cli
from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.support.files import replacing_folder
from shipfp_rs.sweeps.store import opened
from shipfp_rs.tacho.speed import interval_gain, resample
from shipfp_rs.vessel.steady_state import steady_state
from tests.cli.small_trial import SMALL, SWEEP, refused, small_log
from tests.logger_files import hdf5_file
from tests.view.serving import served

SECRET = b"a line of another file\n" * 10
LONG = "1" * 5000
"""A whole number of more digits than Python turns into one."""
DEEP = "[" * 100_000


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a small trial, made once."""
    return small_log().write(tmp_path_factory.mktemp("small") / "log.parquet")


@pytest.fixture
def folder(tmp_path: Path, log_file: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a small trial."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.parquet").hardlink_to(log_file)
    (tmp_path / "TRIAL.toml").write_text(SMALL, encoding="utf-8")
    return tmp_path


def _external_storage(h5py, file) -> None:
    stored = file.create_dataset("u", (100,), dtype="i1", external=[("secret", 0, 100)])
    stored.attrs["rate_hz"] = 10.0


def _virtual_dataset(h5py, file) -> None:
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "u", (100,))
    file.create_virtual_dataset("u", layout).attrs["rate_hz"] = 10.0


def _external_link(h5py, file) -> None:
    # Words beside a table name its columns, wherever they stand.
    file.create_dataset("table", data=np.zeros((100, 2))).attrs["rate_hz"] = 10.0
    file["words"] = h5py.ExternalLink("other.h5", "/words")


def _external_group(h5py, file) -> None:
    file.create_dataset("u", data=np.zeros(100)).attrs["rate_hz"] = 10.0
    file.create_group("inner")["all"] = h5py.ExternalLink("other.h5", "/")


def _endless(h5py, file) -> None:
    file.create_dataset("u", (10**13,), dtype="f8", chunks=(1000,)).attrs["rate_hz"] = 10.0


@pytest.mark.parametrize(
    ("write", "said"),
    [
        pytest.param(_external_storage, "in another file", id="d5-external-storage"),
        pytest.param(_virtual_dataset, "in another file", id="d5-virtual-dataset"),
        pytest.param(_external_link, "leads into another file", id="d5-external-link"),
        pytest.param(_external_group, "leads into another file", id="d5-external-link-to-a-group"),
        pytest.param(_endless, "announces 1e+13 samples", id="d6-more-samples-than-bytes-can-hold"),
    ],
)
def test_an_hdf5_file_shows_its_own_bytes_only(
    write: Callable[..., None], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    monkeypatch.chdir(tmp_path)
    Path("secret").write_bytes(SECRET)
    with h5py.File("other.h5", "w") as file:
        file.create_dataset("u", data=np.arange(100.0))
        file.create_dataset("words", data=["one", "two"], dtype=h5py.string_dtype())
    with h5py.File("log.h5", "w") as file:
        write(h5py, file)
    with pytest.raises(InputError, match=said.replace("+", r"\+")):
        Log.open("log.h5")


def test_an_hdf5_file_with_links_of_its_own_is_read(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("u", data=np.arange(100.0)).attrs["rate_hz"] = 10.0
        file["same"] = h5py.SoftLink("/u")
        file["one"], file["two"] = h5py.SoftLink("/two"), h5py.SoftLink("/one")
        file["inner/all"] = file["/"]
    assert Log.open(tmp_path / "log.h5").read("u")[-1] == 99.0


@pytest.mark.parametrize(
    "sandbox", [False, True], ids=["d5-token", "d5-token-where-no-file-can-stand-beside-the-log"]
)
def test_the_pages_secret_is_not_among_the_arguments_of_the_browser(
    sandbox: bool, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened = []
    ended = threading.Event()
    ended.set()
    monkeypatch.setattr("shipfp_rs.view.server.end_asked_for", lambda: ended)

    def open_browser(address: str) -> None:
        file = Path(address.removeprefix("file://"))
        opened.append((address, file.read_text(), file.parent.stat().st_mode & 0o777))

    monkeypatch.setattr("webbrowser.open", open_browser)
    if sandbox:
        monkeypatch.setattr("shipfp_rs.view.server.UNSHARED", 0o7777)
    assert cli.main(["view", "log.parquet"]) == 0
    ((address, text, rights),) = opened
    shown = capsys.readouterr().out.split()[1]
    assert shown.split("/")[3] not in address
    assert (shown in text, rights) == (True, 0o700)
    assert sorted(path.name for path in folder.iterdir()) == ["TRIAL.toml", "log.parquet"]


def test_d5_the_file_that_is_handed_over_opens_the_page(folder: Path, browser) -> None:
    from shipfp_rs.view.server import handed_over

    with served(folder) as caller, handed_over(caller.server.address, folder) as file:
        page = browser.new_page()
        page.goto(file)
        page.wait_for_url(caller.server.address)
        page.wait_for_selector("body[data-ready]")


ODD_FILES: dict[str, Callable[[Path], object]] = {
    "d5-fifo": lambda path: os.mkfifo(path / "x.toml"),
    "d5-folder": lambda path: (path / "x.toml").mkdir(),
    "d5-dangling-link": lambda path: (path / "x.toml").symlink_to("nowhere"),
    "d2-links-in-a-loop": lambda path: (path / "x.toml").symlink_to("x.toml"),
    "d2-links-in-a-loop-as-the-trials-log": lambda path: (
        (path / "y").symlink_to("y"),
        (path / "x.toml").write_text('[trial]\nlog = "y"'),
    ),
    "d5-device": lambda path: (path / "x.toml").symlink_to("/dev/zero"),
    "d5-device-as-a-log": lambda path: (path / "x.csv").symlink_to("/dev/zero"),
    "d2-deep-toml": lambda path: (path / "x.toml").write_text("a = " + DEEP),
    "d2-numbers-of-thousands-of-digits": lambda path: (path / "x.toml").write_text(f"a = {LONG}"),
    "d2-a-log-with-a-nul-in-its-name": lambda path: (path / "x.toml").write_text('[trial]\nlog = "a\\u0000"'),
    "d2-trial-that-is-a-number": lambda path: (path / "x.toml").write_text("trial = 1"),
    "d2-name-that-is-not-utf-8": lambda path: (
        (path / os.fsdecode(b"\xff.csv")).write_text("t\n1\n"),
        (path / os.fsdecode(b"\xff.toml")).write_text(""),
    ),
    "d5-fingerprint-is-a-fifo": lambda path: os.mkfifo(path / "run/fingerprint.json"),
    "d5-fingerprint-is-deep": lambda path: (path / "run/fingerprint.json").write_text('{"a":' + DEEP),
    "d5-fingerprint-with-half-a-character": lambda path: (path / "run/fingerprint.json").write_text(
        '{"vessel": "\\ud800"}'
    ),
    "d2-fingerprint-whose-verdict-is-a-number": lambda path: (path / "run/fingerprint.json").write_text(
        '{"verdict": 5, "vessel": [1], "structure": 2}'
    ),
    "d2-fingerprint-with-a-number-of-thousands-of-digits": lambda path: (
        path / "run/fingerprint.json"
    ).write_text(f'{{"usable": {LONG}}}'),
    "d2-summary-whose-draws-are-lists": lambda path: (path / "run/summary.json").write_text(
        '{"draws": {"total": [[]], "done": null}}'
    ),
    "d6-pyramid-is-a-fifo": lambda path: os.mkfifo(path / "log.parquet.shipfp-pyramid"),
}


@pytest.mark.parametrize("odd", ODD_FILES.values(), ids=ODD_FILES)
def test_one_odd_file_does_not_disable_the_page(odd: Callable[[Path], object], folder: Path) -> None:
    for name in ("run", "well"):
        (folder / name).mkdir()
    odd(folder)
    (folder / "well" / "fingerprint.json").write_text('{"vessel": "tug", "verdict": ["Known: p."]}')
    with served(folder) as caller:
        told = caller.get("folder")
        assert told["status"] == 200, told
        assert "log.parquet" in [log["name"] for log in told["logs"]]
        assert [trial["name"] for trial in told["trials"]] in (["TRIAL.toml"], ["TRIAL.toml", "x.toml"])
        results = caller.get("results")
        assert results["status"] == 200
        assert "Known: p." in [one["verdict"] for one in results["results"]]
        doc = next(trial["doc"] for trial in told["trials"] if trial["name"] == "TRIAL.toml")
        assert "draft" in caller.get("draft", doc=doc)
        assert caller.until_read(doc)["state"] == "done"


POSTS = {
    "d2-half-a-character-as-a-key": '{"\\ud800": 1}',
    "d2-half-a-character-as-a-file": '{"doc": 0, "file": "\\udcff.toml", "draft": {}}',
    "d2-half-a-character-in-a-draft": '{"doc": 0, "file": "x.toml", "draft": {"name": "\\udfff"}}',
    "d2-bytes-that-are-not-utf-8": '{"doc": 0, "file": "\udcff.toml", "draft": {}}',
    "d2-number-of-thousands-of-digits": f'{{"doc": {LONG}}}',
    "d2-deep-draft": '{"doc": 0, "file": "x.toml", "draft": {"name": ' + "[" * 900 + "]" * 900 + "}}",
    "d2-nan": '{"doc": NaN, "file": "x.toml"}',
}


@pytest.mark.parametrize("name", ["save", "preview", "process", "job", "stop"])
@pytest.mark.parametrize("body", POSTS.values(), ids=POSTS)
def test_an_odd_post_is_answered_in_a_line(name: str, body: str, page: SimpleNamespace) -> None:
    status, _, answer = page.caller.ask(
        f"/{page.caller.server.token}/api/{name}", "POST", body.encode("utf-8", "surrogateescape"),
        Origin=page.caller.server.origin, Content_Type="application/json",
    )  # fmt: skip
    told = json.loads(answer)["error"]
    assert status == 400, told
    assert "\n" not in told
    assert "internal" not in told
    assert [path.name for path in page.folder.iterdir() if path.suffix == ".toml"] == []


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, log_file: Path):
    """A page of a folder with one log."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "log.parquet").hardlink_to(log_file)
    with served(folder) as caller:
        caller.server.desk.open(folder / "log.parquet")
        yield SimpleNamespace(caller=caller, folder=folder)


DESCRIPTIONS = {
    "d1-number-of-thousands-of-digits": SMALL.replace("scale = 1.0 }", f"scale = {LONG} }}"),
    "d1-vessel-is-an-endless-device": SMALL.replace('"stan-tug-1205"', '"/dev/zero"'),
    "d1-vessel-is-a-terminal": SMALL.replace('"stan-tug-1205"', '"/dev/tty"'),
    "d1-vessel-with-a-nul-in-its-name": SMALL.replace('"stan-tug-1205"', '"a\\u0000.toml"'),
    "d1-thousands-of-windows": SMALL
    + "".join(
        f'[[windows]]\nname = "W{k}"\nkind = "chirp"\nstart_s = 1.0\nstop_s = 39.0\n' for k in range(2000)
    ),
    "d1-log-is-an-endless-device": SMALL.replace("log.parquet", "/dev/zero"),
}


@pytest.mark.parametrize("text", DESCRIPTIONS.values(), ids=DESCRIPTIONS)
def test_a_trial_that_can_not_be_read_to_its_end_costs_one_line(
    text: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "TRIAL.toml").write_text(text)
    refused(["check", "TRIAL.toml"], capsys)


@pytest.fixture(scope="module")
def record() -> fp.Experiment:
    """A launch in a chirp."""
    chirp = fp.signals.chirp(0.05, 1.0, 40.0, 39.0, rate_hz=50.0)
    noise = {"n_e": 0.02, "M_b": 0.02, "M_g": 0.02, "X_f": 0.02}
    record = fp.simulate(fp.Vessel.load("stan-launch-804"), chirp, noise=noise, seed=1)
    return replace(record, signals={name: record.signals[name] for name in ("n_set", *noise)})


ASKED: dict[str, tuple[dict[str, Any], str]] = {
    "d1-fixed-of-zero": ({"fixed": {"tau_n": 0.0}}, "tau_n: fixed at 0, expected more than 0"),
    "d1-ratio-fixed-at-zero": ({"fixed": {"v": 0.0}}, "v: fixed at 0, expected more than 0"),
    "d1-limit-fixed-at-zero": ({"fixed": {"M_max": 0.0}}, "M_max: fixed at 0, expected more than 0"),
    "d1-dead-time-fixed-without-end": ({"fixed": {"T_d": 1e15}}, "fixed.T_d: found 1e+15, expected 0 to 2"),
    "d1-prior-without-width": (
        {"priors": {"T_d": (0.1, 0.0)}},
        "priors.T_d: found a standard deviation of 0",
    ),
    "d1-prior-far-away": (
        {"priors": {"tau_n": (1e9, 1.0)}},
        "priors.tau_n: found 1e+09, expected 0.003 to 300",
    ),
    "d3-outputs-without-speed": ({"outputs": ["dM"]}, "no 'dn', expected the speed among them"),
    "d6-output-not-known": ({"outputs": ["dQ"]}, "no 'dQ', expected some of dn, dM, dX, dE"),
    "d6-output-not-measured": ({"outputs": ["dn", "dE"]}, "'dE' was not measured in every experiment"),
    "d6-no-outputs": ({"outputs": []}, "no 'dn', expected the speed among them"),
}


@pytest.mark.parametrize(("asked", "said"), ASKED.values(), ids=ASKED)
def test_what_no_ship_can_have_is_refused_before_the_fit(
    asked: dict[str, Any], said: str, record: fp.Experiment
) -> None:
    with pytest.raises(InputError) as caught:
        fp.identify(record, torque="brake", **asked)
    assert said in str(caught.value)


@pytest.mark.parametrize("torque", ["brake", "gauge"])
def test_d6_a_speed_that_never_moves_is_refused(torque: Any, record: fp.Experiment) -> None:
    still = np.full_like(record.signals["n_e"], record.operating_point["n_e"])
    with pytest.raises(InputError, match="n_e does not follow the set point"):
        fp.identify(replace(record, signals={**record.signals, "n_e": still}), torque=torque)


def test_d3_a_ship_of_which_the_torque_alone_is_compared_is_fitted(record: fp.Experiment) -> None:
    structure = fp.Structure.ship(torque="brake", outputs=["dM"])
    found = fp.identify(record, structure, starts=1, intervals="symmetric", time_limit_s=1.0)
    assert found.structure["outputs"] == ["dM"]


def test_a_limit_that_is_known_is_fitted_with_its_element(record: fp.Experiment) -> None:
    others = dict.fromkeys(("rack_rate", "twist"), False)
    known = {"M_max": 3.0, "T_d": 0.0, "T_set": 0.0, "tau_act": 0.0}
    found = fp.identify(record, fixed=known, elements=others, intervals="symmetric", time_limit_s=0.2)
    assert found.parameters["M_max"].value == 3.0


@pytest.mark.parametrize(
    ("matrix", "left_out"),
    [
        pytest.param(sparse.csc_matrix(np.eye(3)), "S", id="d6-sparse-matrix"),
        pytest.param(np.arange(9.0) + 1j, r"S \(complex\)", id="d7-complex-numbers"),
    ],
)
def test_what_is_no_channel_of_a_matlab_file_is_left_out_with_a_word(
    matrix: Any, left_out: str, tmp_path: Path
) -> None:
    io.savemat(tmp_path / "log.mat", {"u": np.arange(9.0), "fs": 10.0, "S": matrix})
    with pytest.warns(LogWarning, match=f"no vectors of numbers: {left_out}"):
        log = Log.open(tmp_path / "log.mat")
    assert list(log.channels) == ["u"]


@pytest.mark.parametrize("closed", ["stdout", "stderr", "stdin"], ids=lambda name: f"d3-closed-{name}")
def test_a_stream_that_the_caller_has_closed_ends_no_command(
    closed: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, closed, None)
    assert cli.main(["convert", "log.parquet", "again.parquet"]) == 0
    getattr(sys, closed).close()
    assert Log.open("again.parquet").channels == Log.open("log.parquet").channels
    monkeypatch.setattr(sys, closed, None)
    assert cli.main(["convert", "nothing.parquet", "new.parquet"]) == 2
    getattr(sys, closed).close()


@pytest.mark.parametrize(("given", "left"), [("4,2", "4"), ("nope", "1"), ("", "1"), ("3", "3")])
def test_d6_numbers_of_threads_are_such_as_libraries_read(
    given: str, left: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", given)
    monkeypatch.setenv("MPLBACKEND", "nope")
    assert cli.main(["--version"]) == 0
    assert (os.environ["OMP_NUM_THREADS"], os.environ["MPLBACKEND"]) == (left, "agg")


def test_d6_reproduce_alone_says_that_a_command_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce"]) == 2
    assert (
        capsys.readouterr().err
        == "shipfp: error: no command given, expected one; see shipfp reproduce --help\n"
    )


@pytest.mark.parametrize(
    "command",
    [["inspect", "log.parquet"], ["init", "new", "--log", "log.parquet"]],
    ids=["d2-time-of-inspect", "d2-time-of-init"],
)
def test_an_empty_name_of_the_time_is_none(
    command: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "time is empty" in refused([*command, "--time", ""], capsys)


def test_d2_a_scheduler_that_does_not_answer_leaves_no_folder(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    (folder / "SWEEP.toml").write_text(SWEEP)
    refused(["sweep", "SWEEP.toml", "--out", "sw", "--address", "nowhere"], capsys)
    assert not (folder / "sw").exists()


MANIFESTS: dict[str, Callable[[Path], object]] = {
    "d6-fifo": os.mkfifo,
    "d6-device": lambda path: path.symlink_to("/dev/zero"),
    "d6-deep": lambda path: path.write_text(DEEP),
    "d6-half-a-character": lambda path: path.write_text('{"format": 1, "sweep": {"\\ud800": 1}}'),
    "d6-format-alone": lambda path: path.write_text('{"format": 1}'),
    "d6-negative-part": lambda path: path.write_text('{"format": 1, "part_draws": -5, "sweep": {}}'),
}


@pytest.mark.parametrize("write", MANIFESTS.values(), ids=MANIFESTS)
def test_what_is_no_manifest_is_refused(
    write: Callable[[Path], object], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "SWEEP.toml").write_text(SWEEP)
    (folder / "sw").mkdir()
    write(folder / "sw" / "manifest.json")
    refused(["sweep", "SWEEP.toml", "--out", "sw"], capsys)


SCHEMA = pa.schema([("index", pa.int64()), ("x", pa.float64())])


def _flipped(one: Path, other: Path) -> None:
    content = bytearray(one.read_bytes())
    content[content.index(np.float64(1.5).tobytes()) + 6] ^= 1
    one.write_bytes(content)


def _swapped(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


@pytest.mark.parametrize(
    ("damage", "whole"),
    [
        pytest.param(lambda one, other: None, 2, id="as-written"),
        pytest.param(_flipped, 1, id="d7-flipped-byte"),
        pytest.param(_swapped, 0, id="d7-swapped-files"),
    ],
)
def test_parts_of_a_sweep_that_are_not_as_written_are_made_again(
    damage: Callable[[Path, Path], object], whole: int, tmp_path: Path
) -> None:
    record = {"seed": 1}
    with opened(tmp_path / "sw", record, SCHEMA, draws=range(9), part_draws=3) as store:
        for part in (0, 1):
            rows = {"index": [*store.draws_of(part)], "x": [1.5, 2.5 + part, 3.5]}
            store.add(part, pa.RecordBatch.from_pydict(rows, schema=SCHEMA))
    damage(*sorted((tmp_path / "sw").rglob("0*.parquet")))
    with opened(tmp_path / "sw", record, SCHEMA, draws=range(9), part_draws=3) as store:
        assert store.rows == 3 * whole


HUGE = (1e308, 1e15, float("inf"), 10**400, 2**70)
TRAIN = np.where(np.arange(2000) % 100 < 30, 5.0, 0.0)
TIMES = np.arange(100) * 0.05
LARGE_CALLS: dict[str, Callable[[Any], object]] = {
    "substeps": lambda value: fp.simulate(LAUNCH, STEPS, substeps=value),
    "set-point": lambda value: fp.simulate(LAUNCH, STEPS, n_e_rpm=value),
    "steady-state": lambda value: steady_state(LAUNCH, n_e_rpm=value),
    "resample-rate": lambda value: resample(fp.tacho.speed_from_pulses(TIMES, 4), value, 0.0, 4.0),
    "resample-stop": lambda value: resample(fp.tacho.speed_from_pulses(TIMES, 4), 100.0, 0.0, value),
    "pulses-a-turn": lambda value: fp.tacho.speed_from_pulses(TIMES, value),
    "reflectors": lambda value: fp.tacho.reflector_angles(TIMES, value),
    "multisine-period": lambda value: fp.signals.multisine([0.5, 1.0], value, 39.0),
    "multisine-iterations": lambda value: fp.signals.multisine([0.5, 1.0], 4.0, 39.0, iterations=value),
}
LAUNCH = fp.Vessel.load("stan-launch-804")
STEPS = fp.signals.steps([13.0, -13.0], 1.0)


@pytest.mark.parametrize("value", HUGE, ids=lambda value: f"{float(min(value, 1e308)):.0e}")
@pytest.mark.parametrize("call", LARGE_CALLS.values(), ids=lambda call: "d4")
def test_numbers_that_nothing_has_are_refused(call: Callable[[Any], object], value: float) -> None:
    with pytest.raises(InputError) as caught:
        call(value)
    assert "expected" in str(caught.value) or "lower the set point" in str(caught.value)


def test_d4_a_number_that_overflows_on_the_way_is_an_input_error() -> None:
    with pytest.raises(InputError, match="pulse_times: a number is too large"):
        fp.tacho.pulse_times(TRAIN, 1000.0, window_s=1e308)


def test_d7_masked_samples_are_gaps() -> None:
    swing = np.sin(np.pi * np.arange(500) / 10.0)
    masked = np.ma.array(np.where(np.arange(500) // 10 == 7, 50.0, swing), mask=np.arange(500) // 10 == 7)
    log = Log.from_arrays({"a": masked, "b": np.ma.masked_equal(np.arange(500), 3)}, rate_hz=10.0)
    assert np.isnan(log.read("a")).sum() == 10
    assert np.isnan(log.read("b")).sum() == 1
    signals = {"n_set": np.full(500, 1300.0), "n_e": 1300.0 + masked}
    point = {"n_set": 1300.0, "n_e": 1300.0}
    assert np.isnan(fp.Experiment("S", 25.0, signals, point).signals["n_e"]).sum() == 10
    assert np.isnan(fp.Calibration(scale=2.0)(masked)).sum() == 10
    assert fp.frequency.fit_sine(masked, 10.0, near_hz=0.5).amplitude[0] == pytest.approx(1.0)


def test_d7_small_whole_numbers_do_not_wrap() -> None:
    intervals = fp.tacho.speed_from_pulses(TIMES, 4)
    speed, _ = resample(intervals, np.int8(100), np.int8(0), np.int8(4))
    np.testing.assert_array_equal(speed, resample(intervals, 100.0, 0.0, 4.0)[0])
    gain = interval_gain(np.array([60, 120], dtype=np.int8), np.int8(4), np.int8(20))
    np.testing.assert_array_equal(gain, interval_gain([60.0, 120.0], 4, 20.0))


def _in_the_field(path: Path) -> None:
    field = pa.field("u", pa.float64(), metadata={b"sample_rate_hz": b"10", b"made by": b"a logger"})
    pq.write_table(pa.table([np.arange(9.0)], schema=pa.schema([field])), path)


def _in_the_table(path: Path) -> None:
    pq.write_table(pa.table({"u": np.arange(9.0)}).replace_schema_metadata({"sample_rate_hz": "10"}), path)


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(_in_the_field, id="c7-rate-in-a-fields-metadata"),
        pytest.param(_in_the_table, id="c7-rate-in-a-tables-metadata"),
    ],
)
def test_what_a_logger_wrote_about_its_rate_is_read(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / "log.parquet")
    log = Log.open(tmp_path / "log.parquet")
    assert log.channel("u").rate_hz == pytest.approx(10.0)
    np.testing.assert_array_equal(log.read("u"), np.arange(9.0))


def test_c7_two_swapped_first_rows_are_told(tmp_path: Path) -> None:
    times = [1, 0, *range(2, 400)]
    rows = [f"{time / 10.0:.1f},{time}.0" for time in times]
    (tmp_path / "log.csv").write_text("\n".join(["time,u", *rows, ""]))
    with pytest.warns(LogWarning, match="clock set back at samples 1 to 1"):
        assert Log.open(tmp_path / "log.csv").channel("u").rate_hz == pytest.approx(10.0)


def test_c7_the_sign_of_degrees_stays_what_it_is(tmp_path: Path) -> None:
    with hdf5_file(tmp_path / "log.h5") as file:
        stored = file.create_dataset("u", data=np.arange(9.0))
        stored.attrs["rate_hz"], stored.attrs["unit"] = 10.0, np.bytes_("°C".encode("latin-1"))
    (tmp_path / "log.csv").write_bytes("time,u [°C]\n0,1\n1,2\n2,3\n".encode("latin-1"))
    assert [Log.open(tmp_path / f"log.{suffix}").channel("u").unit for suffix in ("h5", "csv")] == [
        "°C",
        "°C",
    ]


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no terminals that are closed")
def test_d6_a_closed_terminal_ends_a_command_in_order(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def app(*_: object, **__: object) -> None:
        with replacing_folder(tmp_path / "out", marker="done") as folder:
            (folder / "done").write_text("")
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(5.0)

    monkeypatch.setattr(cli, "app", app)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored, and so it stays
    try:
        assert cli.main([]) == cli.ENDED
    finally:
        signal.signal(signal.SIGHUP, before)
    assert capsys.readouterr().err == "shipfp: ended from outside\n"
    assert list(tmp_path.iterdir()) == []
