"""Somebody inside: a container on the stack's tunnel network, with no secret of the stack in its hands."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

from docker.models.containers import Container
from inside import run_inside
from stack import PROJECT, Stack

# Sends bytes, and prints as JSON what came back until it was silent, or why nothing could be sent.
PROBE = """
import json, socket, sys
host, port, data = sys.argv[1], int(sys.argv[2]), bytes.fromhex(sys.argv[3])
try:
    way = socket.create_connection((host, port), 3)
except OSError as error:
    print(json.dumps({"unreachable": type(error).__name__})); sys.exit()
way.sendall(data)
way.settimeout(10)
got = b""
try:
    while len(got) < 4096:
        piece = way.recv(4096)
        if not piece:
            break
        got += piece
        way.settimeout(1)
except OSError:
    pass
print(json.dumps({"got": got.decode("latin-1")}))
"""
UNREACHABLE = "unreachable"


class Insider:
    """The container, and what it can ask of others on the network."""

    def __init__(self, container: Container) -> None:
        self._container = container

    def send(self, host: str, port: int, data: bytes) -> str:
        """Send bytes to a port; what came back, or UNREACHABLE."""
        done = run_inside(self._container, "python3", "-c", PROBE, host, str(port), data.hex())
        assert done.returncode == 0, done.stderr
        answer: dict[str, str] = json.loads(done.stdout)
        return answer.get("got", UNREACHABLE)

    def get(
        self, host: str, port: int, path: str = "/", method: str = "GET", **headers: str
    ) -> str:
        """Send an HTTP request; the status line of the answer, or what `send` says."""
        named = {"Host": host, "Content-Length": "0", **headers}
        spelt = [f"{name.replace('_', '-')}: {value}" for name, value in named.items()]
        request = "\r\n".join([f"{method} {path} HTTP/1.1", *spelt, "", ""])
        return self.send(host, port, request.encode()).split("\r\n", 1)[0]

    def upgrade(self, host: str, port: int, **headers: str) -> str:
        """Ask for a WebSocket; the status line of the answer."""
        asked = {
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec_WebSocket_Version": "13",
            "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
        }
        return self.get(host, port, **asked, **headers)


@contextmanager
def insider(stack: Stack) -> Iterator[Insider]:
    """Start the container, and remove it at the end."""
    container = stack.engine.containers.run(
        stack.container("relay").image,
        ["infinity"],
        entrypoint="sleep",
        network=f"{PROJECT}_tunnel",
        name=f"{PROJECT}-insider",
        detach=True,
    )
    try:
        yield Insider(container)
    finally:
        container.remove(force=True)
