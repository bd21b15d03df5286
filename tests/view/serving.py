"""A server over a folder, and requests that a browser would or would not make."""

import contextlib
import http.client
import json
from collections.abc import Iterator
from pathlib import Path

from shipfp_rs.view.desk import Desk
from shipfp_rs.view.server import Server, serving


class Caller:
    """Asks a server what it is told to ask, headers and all."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.host = f"127.0.0.1:{server.server_port}"

    def ask(self, path: str, method: str = "GET", body: bytes | None = None, **headers: str | None):
        """Status, headers and body of a request; a header of None is left out."""
        said = {"Host": self.host, **{key.replace("_", "-"): value for key, value in headers.items()}}
        connection = http.client.HTTPConnection("127.0.0.1", self.server.server_port, timeout=20)
        with contextlib.closing(connection):
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            if body is not None:
                said.setdefault("Content-Length", str(len(body)))
            for name, value in said.items():
                if value is not None:
                    connection.putheader(name, value)
            connection.endheaders(body)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()

    def get(self, name: str, **asked: object) -> dict:
        """The answer to a question of the page."""
        query = "&".join(f"{key}={value}" for key, value in asked.items())
        status, _, body = self.ask(f"/{self.server.token}/api/{name}?{query}")
        return {"status": status, **json.loads(body)}

    def post(self, name: str, content: object, **headers: str | None) -> dict:
        """What becomes of something that the page tells."""
        said = {"Origin": self.server.origin, "Content_Type": "application/json", **headers}
        body = json.dumps(content).encode()
        status, head, answer = self.ask(f"/{self.server.token}/api/{name}", "POST", body, **said)
        told = json.loads(answer) if head["Content-Type"] == "application/json" else {"text": answer.decode()}
        return {"status": status, **told}

    def until_read(self, doc: int = 0) -> dict:
        """The facts of a document, once it is read."""
        while (facts := self.get("document", doc=doc)).get("state") == "working":
            pass
        return facts


@contextlib.contextmanager
def served(folder: Path) -> Iterator[Caller]:
    """Serve a folder."""
    with serving(Desk(folder)) as server:
        yield Caller(server)
