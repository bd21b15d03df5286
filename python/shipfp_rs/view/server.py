"""Local server of the pages for one user; other users have no access, and the pages send no requests to other hosts."""

from __future__ import annotations

import contextlib
import hmac
import html
import json
import secrets
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from shipfp_rs.errors import InputError, ShipfpError
from shipfp_rs.support.files import finite, parsed_json
from shipfp_rs.view.desk import Desk

HOST = "127.0.0.1"
LARGEST_BODY = 1 << 20
IDLE_S = 60.0
JSON = "application/json"
UNSHARED = 0o077
"""Permission bits of group and others, which must be cleared."""
TYPES = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy of the page: only its own files, no inline content."""
REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts"
)
"""Content security policy of reports, which may be untrusted: isolated from the page, no requests."""


class Refused(Exception):
    """Request that is rejected."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class Server(ThreadingHTTPServer):
    """Server of a desk under a secret address."""

    daemon_threads = True
    request_queue_size = 32

    def __init__(self, desk: Desk) -> None:
        super().__init__((HOST, 0), _Handler)
        self.desk = desk
        self.token, self.results_token = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        """Secret in the address of the page, and another in that of reports, which must not learn the page's."""
        self.origin = f"http://{HOST}:{self.server_port}"
        self.first_page = "folder.html"

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return f"{self.origin}/{self.token}/{self.first_page}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors, since a closed page breaks its connections."""

    def close(self) -> None:
        """Stop listening, and end every job."""
        self.shutdown()
        self.server_close()
        self.desk.jobs.stop_all()


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    timeout = IDLE_S
    server_version, sys_version = "shipfp", ""

    def setup(self) -> None:
        super().setup()
        # Answers are small; Nagle's algorithm costs 40 ms each.
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)

    def log_message(self, format: str, *args: Any) -> None:
        """Write no log to the terminal."""

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def _answer(self, act: Callable[[list[str]], tuple[str, bytes, str]]) -> None:
        status, policy = HTTPStatus.OK, POLICY
        try:
            kind, body, policy = act(self._path())
        except Refused as refusal:
            # The request's body is not read, so the connection must be closed.
            self.close_connection = True
            status, kind, body = refusal.status, "text/plain; charset=utf-8", str(refusal).encode()
        except (ShipfpError, OSError) as error:
            status = HTTPStatus.BAD_REQUEST
            kind, body = JSON, _json({"error": " ".join(str(error).split()) or type(error).__name__})
        except Exception as error:  # the page shows the error; there is no traceback or broken connection
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            kind, body = JSON, _json({"error": f"internal error: {type(error).__name__}: {error}"})
        self._send(status, kind, body, policy)

    def _send(self, status: HTTPStatus, kind: str, body: bytes, policy: str) -> None:
        head = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        self.send_response(status)
        for name, value in head.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def _path(self) -> list[str]:
        """Authorise the request and return the parts of the path after the secret, starting with its kind."""
        host = self.headers.get_all("Host") or []
        if host != [f"{HOST}:{self.server.server_port}"]:
            # Refused: a foreign host name that resolves to this machine (DNS rebinding).
            raise Refused(HTTPStatus.FORBIDDEN, "refused: not the address of this server")
        if self.headers.get("Origin", self.server.origin) != self.server.origin:
            raise Refused(HTTPStatus.FORBIDDEN, "refused: another page's request")
        site = self.headers.get("Sec-Fetch-Site", "none")
        if site not in ("none", "same-origin") and not self._is_opened():
            raise Refused(HTTPStatus.FORBIDDEN, "refused: another page's request")
        parts = urlsplit(self.path).path.split("/")[1:]
        for kind, token in (("page", self.server.token), ("results", self.server.results_token)):
            if hmac.compare_digest(parts[0].encode(), token.encode()):
                if any(part in ("", ".", "..") or "%" in part or "\\" in part for part in parts[1:]):
                    raise Refused(HTTPStatus.NOT_FOUND, "refused: no such page")
                return [kind, *parts[1:]]
        raise Refused(HTTPStatus.FORBIDDEN, "refused: open the address that shipfp view printed")

    def _is_opened(self) -> bool:
        """Whether a browser tab opens a page, such as by a redirect; a foreign page can cause this but not read the page."""
        opens = (self.headers.get("Sec-Fetch-Mode"), self.headers.get("Sec-Fetch-Dest"))
        return self.command == "GET" and opens == ("navigate", "document") and ".html" in self.path

    def _get(self, path: list[str]) -> tuple[str, bytes, str]:
        match path:
            case ["results", key, name]:
                found = self.server.desk.results.file(key, name)
                if found is not None:
                    return found[1], found[0].read_bytes(), REPORT_POLICY
            case ["page", "api", "tiles"]:
                return "application/octet-stream", self.server.desk.tiles(self._asked()), POLICY
            case ["page", "api", name] if name in self.server.desk.asked:
                told = self.server.desk.asked[name](self._asked())
                if name == "results":
                    told = {**told, "base": f"{self.server.origin}/{self.server.results_token}/"}
                return JSON, _json(told), POLICY
            case ["page", name] if name in PAGES:
                return TYPES[name.rpartition(".")[2]], PAGES[name], POLICY
        raise Refused(HTTPStatus.NOT_FOUND, "refused: no such page")

    def _asked(self) -> dict[str, str]:
        return dict(parse_qsl(urlsplit(self.path).query, keep_blank_values=True))

    def _post(self, path: list[str]) -> tuple[str, bytes, str]:
        if self.headers.get("Origin") != self.server.origin:
            raise Refused(HTTPStatus.FORBIDDEN, "refused: not from a page of this server")
        if self.headers.get_content_type() != JSON:
            raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "refused: expected application/json")
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > LARGEST_BODY:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "refused: too long, or of unknown length")
        match path:
            case ["page", "api", name] if name in self.server.desk.told:
                content = parsed_json(self.rfile.read(int(length)), "what was sent", "an object")
                if not isinstance(content, dict):
                    raise InputError("found no JSON object, expected one")
                return JSON, _json(self.server.desk.told[name](content)), POLICY
        raise Refused(HTTPStatus.NOT_FOUND, "refused: no such page")


def _json(content: Any) -> bytes:
    # ASCII, since a file's name need not be valid UTF-8.
    return json.dumps(finite(content), allow_nan=False).encode()


def _pages() -> dict[str, bytes]:
    folder = resources.files("shipfp_rs.view").joinpath("pages")
    return {
        file.name: file.read_bytes() for file in folder.iterdir() if file.name.rpartition(".")[2] in TYPES
    }


PAGES = _pages()
"""Files of the page by name; no other file is reachable."""


@contextlib.contextmanager
def serving(desk: Desk, first_page: str = "folder.html") -> Iterator[Server]:
    """Serve a desk on a thread until the end of the `with` block."""
    server = Server(desk)
    server.first_page = first_page
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.close()
        thread.join()


@contextlib.contextmanager
def handed_over(address: str, beside: Path) -> Iterator[str]:
    """Yield the address of a private file that redirects to the page: all users may read a browser's arguments."""
    with _private_folder(beside) as folder:
        file = Path(folder) / "view.html"
        file.write_text(
            f'<meta http-equiv="refresh" content="0; url={html.escape(address)}">', encoding="utf-8"
        )
        yield file.as_uri()


def _private_folder(beside: Path) -> tempfile.TemporaryDirectory[str]:
    """Private temporary folder, in `beside` if possible, since a sandboxed browser can't read the system's."""
    try:
        made = tempfile.TemporaryDirectory(prefix=".shipfp-view-", dir=beside)
    except OSError:
        return tempfile.TemporaryDirectory()
    if Path(made.name).stat().st_mode & UNSHARED:  # a disk without permissions
        made.cleanup()
        return tempfile.TemporaryDirectory()
    return made


def end_asked_for() -> threading.Event:
    """Event that is set on SIGINT (Ctrl-C) or SIGTERM."""
    ended = threading.Event()

    def end(*_: object) -> None:
        ended.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    return ended
