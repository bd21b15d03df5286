"""Who may ask the server for what: the page that has the secret, and nobody else."""

import json
import socket
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.logs.log import Log
from tests.view.serving import Caller, served
from tests.view.test_jobs import TRIAL


def save(
    caller: Caller, file: object = "TRIAL.toml", doc: int = 0, version: str = "", **changes: str
) -> dict:
    """Ask for a trial to be saved."""
    return caller.post("save", {"doc": doc, "draft": TRIAL | changes, "file": file, "version": version})


def filled(outer: Path) -> Path:
    """Return a folder with a log and a run, and something beside it that is nobody's business."""
    inner = outer / "trials"
    inner.mkdir()
    (outer / "secret.toml").write_text("secret = 1\n")
    (outer / "secret.html").write_text("secret")
    (inner / "run").mkdir()
    (inner / "run" / "fingerprint.json").write_text(json.dumps({"vessel": "tug", "verdict": ["Known: p."]}))
    (inner / "run" / "report.html").write_text("<p>a report</p>")
    (inner / "run" / "notes.html").write_text("not a result")
    (inner / "run" / "link.png").symlink_to(outer / "secret.html")
    samples = np.arange(60_000.0) % 7
    Log.from_arrays({"n": samples, "P": samples}, rate_hz=1000.0, units={"n": "rpm"}).write(
        inner / "log.parquet"
    )
    return inner


@pytest.fixture
def folder(tmp_path) -> Path:
    return filled(tmp_path)


@pytest.fixture
def caller(folder):
    """A server for a test that saves."""
    with served(folder) as caller:
        caller.server.desk.open(folder / "log.parquet")
        yield caller


@pytest.fixture(scope="module")
def asker(tmp_path_factory):
    """A server that is only asked."""
    folder = filled(tmp_path_factory.mktemp("asked"))
    with served(folder) as caller:
        caller.server.desk.open(folder / "log.parquet")
        yield caller


def test_the_page_is_served_with_a_policy_that_lets_nothing_else_in(asker):
    status, head, body = asker.ask(f"/{asker.server.token}/look.html")
    assert status == 200
    assert b"<script" in body
    policy = head["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'")
    assert "unsafe" not in policy
    assert (head["X-Content-Type-Options"], head["Referrer-Policy"]) == ("nosniff", "no-referrer")
    assert "Access-Control-Allow-Origin" not in head


def test_no_page_names_another_host():
    from shipfp_rs.view.server import PAGES

    for name, content in PAGES.items():
        text = content.decode()
        assert "http:" not in text and "https:" not in text, name  # noqa: PT018
        assert "innerHTML" not in text and "insertAdjacentHTML" not in text, name  # noqa: PT018


@pytest.mark.parametrize(
    "path", ["/", "/look.html", "/wrong/look.html", "/{token}x/look.html", "//look.html"]
)
def test_without_the_secret_nothing_is_told(asker, path):
    status, _, body = asker.ask(path.format(token=asker.server.token))
    assert status == 403
    assert asker.server.token.encode() not in body


def test_each_server_has_a_secret_of_its_own_and_listens_on_this_machine_only(folder):
    with served(folder) as one, served(folder) as other:
        assert one.server.token != other.server.token
        assert one.server.results_token != one.server.token
        assert one.server.server_port != other.server.server_port
        assert one.server.server_address[0] == "127.0.0.1"
        assert len(one.server.token) >= 32


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1:1"},
        {"Host": "localhost.evil.example:{port}"},
        {"Host": None},
    ],
)
def test_another_page_is_refused_even_with_the_secret(asker, headers):
    said = {name: value and value.format(port=asker.server.server_port) for name, value in headers.items()}
    status, _, body = asker.ask(f"/{asker.server.token}/api/document?doc=0", **said)
    assert status == 403
    assert b"refused" in body


@pytest.mark.parametrize(
    "path",
    [
        "/{token}/../secret.html", "/{token}/..%2fsecret.html", "/{token}/%2e%2e/secret.html", "/{token}/./look.html",
        "/{token}/api/../../secret.html", "/{token}/..\\secret.html", "/{token}//look.html", "/{token}/desk.py",
        "/{results}/{run}/../../secret.html", "/{results}/../secret.html", "/{results}/{run}/..%2f..%2fsecret.html",
        "/{results}/{run}/notes.html", "/{results}/{run}/link.png", "/{results}/api/document?doc=0",
        "/{token}/{run}/report.html",
    ],
)  # fmt: skip
def test_no_path_leads_out_of_what_is_listed(asker, path):
    (run,) = asker.get("results")["results"]
    told = {"token": asker.server.token, "results": asker.server.results_token, "run": run["id"]}
    status, _, body = asker.ask(path.format(**told))
    assert status in (403, 404)
    assert b"secret" not in body
    assert b"not a result" not in body


def test_a_report_is_apart_from_the_page_that_shows_it(asker):
    (run,) = asker.get("results")["results"]
    assert run["files"] == ["fingerprint.json", "report.html"]
    status, head, body = asker.ask(f"/{asker.server.results_token}/{run['id']}/report.html")
    assert (status, body) == (200, b"<p>a report</p>")
    assert "sandbox allow-scripts" in head["Content-Security-Policy"]
    assert "connect-src" not in head["Content-Security-Policy"]  # 'none' by default-src


@pytest.mark.parametrize(
    "name",
    [
        "../secret.toml", "/etc/trial.toml", "a/b.toml", "..\\x.toml", ".toml", ".hidden.toml", "TRIAL.txt", "", None, 7,
        "C:x.toml", "a\0.toml", "run/TRIAL.toml", "x" * 200 + ".toml",
    ],
)  # fmt: skip
def test_nothing_is_written_but_toml_in_the_trials_folder(caller, folder, name):
    before = {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()}
    told = save(caller, name)
    assert told["status"] == 400
    assert "expected a name like TRIAL.toml" in told["error"]
    after = {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()}
    assert {path for path in after if path not in before} <= {folder / "log.parquet.shipfp-pyramid"}
    assert all(after[path] == content for path, content in before.items())


def test_a_link_is_not_written_through(caller, folder):
    (folder / "TRIAL.toml").symlink_to(folder.parent / "secret.toml")
    told = save(caller)
    assert told["status"] == 400
    assert (folder.parent / "secret.toml").read_text() == "secret = 1\n"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": None}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Content_Type": "text/plain"}, 415),
        ({"Content_Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content_Length": "99999999"}, 413),
        ({"Content_Length": None}, 413),
    ],
)
def test_only_the_page_itself_may_change_anything(caller, folder, headers, status):
    told = caller.post("save", {"doc": 0, "draft": TRIAL, "file": "TRIAL.toml", "version": ""}, **headers)
    assert told["status"] == status
    assert not (folder / "TRIAL.toml").exists()


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"[" * 100_000, b'"x"', b"\xff"])
def test_what_is_no_object_is_refused_in_a_line(asker, body):
    path = f"/{asker.server.token}/api/save"
    said = {"Origin": asker.server.origin, "Content_Type": "application/json"}
    status, _, answer = asker.ask(path, "POST", body, **said)
    assert status == 400
    assert "expected" in json.loads(answer)["error"]


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("document", {}), ("document", {"doc": 99}), ("document", {"doc": "-1"}), ("document", {"doc": "../0"}),
        ("tiles", {"doc": 0, "want": "0.0"}), ("tiles", {"doc": 0, "want": "9.0.0"}),
        ("tiles", {"doc": 0, "want": "0.99.0"}),
        ("tiles", {"doc": 0, "want": ",".join(["0.0.0"] * 300)}), ("tiles", {"doc": 0, "want": "0.0.99999"}),
        ("spectrum", {"doc": 0, "series": 0, "from": "nan", "to": 1}),
        ("spectrum", {"doc": 0, "series": 7, "from": 0, "to": 1}),
        ("spectrum", {"doc": 0, "series": 0, "from": 5, "to": 1}), ("windows", {"doc": 0, "column": "nothing"}),
        ("within", {"doc": 0, "driver": "n"}), ("mean", {"doc": 0, "series": 0, "from": 1e9, "to": 2e9}), ("job", {"id": 3}),
    ],
)  # fmt: skip
def test_an_odd_question_is_answered_in_a_line(asker, name, asked):
    asker.until_read()
    told = asker.get(name, **asked)
    assert told["status"] == 400
    assert "\n" not in told["error"]
    assert "internal" not in told["error"]


def test_two_pages_do_not_overwrite_each_other(caller, folder):
    first = save(caller)
    assert first["status"] == 200
    # Another page that opened the log before knows of no file.
    assert "exists already" in save(caller, name="other")["error"]
    opened = {"doc": first["doc"], "version": first["version"]}
    assert save(caller, name="second", **opened)["status"] == 200
    late = save(caller, name="late", **opened)
    assert "changed by another program" in late["error"]
    assert 'name = "second"' in (folder / "TRIAL.toml").read_text()


def test_a_page_that_says_nothing_holds_nobody_up(caller: Caller):
    silent = [socket.create_connection(("127.0.0.1", caller.server.server_port)) for _ in range(40)]
    assert caller.until_read()["status"] == 200
    for one in silent:
        one.close()
