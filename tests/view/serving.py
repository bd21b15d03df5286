"""A server over a folder, and requests that a browser would or would not make."""

import contextlib
import http.client
import io
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from shipfp_rs import signals
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log
from shipfp_rs.vessel.vessel import Vessel
from shipfp_rs.view.desk import Desk
from shipfp_rs.view.server import Server, serving

RATE_HZ = 500.0
STEADY_S = 40.0
CHIRP_S = 50.0


def write_csv(path: Path, seed: int = 0) -> Path:
    """Write the log of a tug."""
    path.write_bytes(csv_of(seed))
    return path


@cache
def csv_of(seed: int) -> bytes:
    """Set point [rpm], torque [Nm] and one pulse a turn of the engine [V], with relay jumps and radio spikes."""
    sensors = Sensors(rate_hz=RATE_HZ)
    chirp = signals.chirp(0.04, 1.5, CHIRP_S, 40.0, rate_hz=RATE_HZ, name="chirp")
    log, _ = simulate_raw_log(
        Vessel.load("stan-tug-1205"), chirp, sensors=sensors, faults=("C", "D1"), steady_s=STEADY_S, seed=seed
    )
    columns = (
        np.arange(log.channel("PTM_e").samples) / RATE_HZ,
        sensors.set_point(log.read("U_setpoint")),
        sensors.torque(log.read("U_torque")),
        log.read("PTM_e"),
    )
    text = io.BytesIO()
    np.savetxt(
        text, np.column_stack(columns), fmt=["%.4f", "%.3f", "%.2f", "%.3f"], delimiter=",", comments="",
        header="time [s],n_set [rpm],shaft torque [Nm],PTM_e [V]",
    )  # fmt: skip
    return text.getvalue()


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
