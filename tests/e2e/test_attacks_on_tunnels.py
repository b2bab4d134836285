"""What somebody with a stolen robot key leads its driver to: nowhere but to that robot.

What sshd lets such a key do: tests/images/test_sshd.py; what the relay takes from it: tests/unit/server/relay/robots.

The stolen key is that of an active robot of its own, so that the thief has all that the key gives. What it gives away
is that robot alone: who holds the key is that robot, until an admin disables it.
"""

from __future__ import annotations

import asyncio
import json
import queue
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import pytest
from programs import Program
from robot_key import RobotKey
from stack import Stack

USER = "tunnel@127.0.0.1"
STOLEN = "stolen"
MAC = "00:00:5e:00:53:70"


@pytest.fixture
def key(stack: Stack, tmp_path: Path) -> Iterator[RobotKey]:
    """The stolen key, of a new robot that is active, and gone afterwards."""
    stack.robotether("robot", "add", STOLEN, "--mac", MAC)
    try:
        stolen = RobotKey(stack, tmp_path, STOLEN)
        status, _ = stolen.join(MAC)
        assert status == 202
        stack.robotether("robot", "approve", STOLEN, "--yes")
        yield stolen
    finally:
        stack.robotether("robot", "remove", STOLEN, "--yes")


class Session:
    """The thief's session: lines to the relay and from it."""

    def __init__(self, key: RobotKey) -> None:
        self._key = key
        self._control = str(key.file.with_suffix(".control"))
        self._running = key.start("-M", "-S", self._control, USER, "session")
        self._lines: queue.Queue[dict[str, Any] | None] = queue.Queue()
        # As an agent does: no driver is connected to a robot that does not.
        self.answers_pings = False
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._running.stdout is not None
        for line in self._running.stdout:
            # The last one may be cut, where the session ends at once.
            if line.endswith("\n"):
                said = json.loads(line)
                if self.answers_pings and said["type"] == "ping":
                    self.send({"type": "pong", "seq": said["seq"]})
                self._lines.put(said)
        self._lines.put(None)

    def send(self, *lines: object) -> None:
        """Send lines; a text as it stands. One that the relay no longer takes is lost."""
        assert self._running.stdin is not None
        texts = (line if isinstance(line, str) else json.dumps(line) for line in lines)
        try:
            self._running.stdin.write("".join(f"{text}\n" for text in texts))
            self._running.stdin.flush()
        except BrokenPipeError:
            pass

    def wait_for(self, kind: str, seconds: float = 10) -> dict[str, Any]:
        """The next line of this type; `end` when the session ends first."""
        end = time.monotonic() + seconds
        while True:
            line = self._lines.get(timeout=max(0.01, end - time.monotonic()))
            if line is None:
                return {"type": "end"}
            if line["type"] == kind:
                return line

    def forward(self, port: int, here: int) -> None:
        """Lead the robot's port to a port of this machine, as its agent does on a live connection."""
        wanted = f"0.0.0.0:{port}:127.0.0.1:{here}"
        done = self._key.ssh("-S", self._control, "-O", "forward", "-R", wanted, USER)
        assert done.returncode == 0, done.stderr

    def close(self) -> None:
        """End it."""
        # Not killed: the client takes its control socket away, which the next one needs.
        self._running.terminate()
        self._reader.join(10)
        # Everything was read: closes the pipes and waits.
        with self._running:
            pass


@contextmanager
def session(key: RobotKey) -> Iterator[Session]:
    """A session that has its configuration, and has said hello as an agent does."""
    running = Session(key)
    try:
        assert running.wait_for("config")["robot"] == key.name
        running.send(
            {"type": "hello", "hostname": "thief", "agent_version": "0.1.0", "guard": "on"}
        )
        yield running
    finally:
        running.close()


class Answering:
    """A port of this machine at which everybody gets the same answer; `asked` are their first bytes."""

    def __init__(self, data: bytes) -> None:
        self.asked: list[bytes] = []
        self._data = data
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.2)
        self.port: int = self._server.getsockname()[1]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._thread.join(10)
        self._server.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            try:
                way, _ = self._server.accept()
            except TimeoutError:
                continue
            # Who asks may give up meanwhile.
            with way, suppress(OSError):
                way.settimeout(2)
                self.asked.append(way.recv(4096))
                way.sendall(self._data)


async def test_a_robot_leads_its_driver_nowhere(key: RobotKey, stack: Stack) -> None:
    """Whoever drives the thief's robot is not sent on, to another robot's port or to what is inside."""
    driver = Program(stack, stack.token("misled"))
    ros, video = key.ports()
    to_video = f"HTTP/1.1 302 Found\r\nLocation: http://sshd:{video}/\r\nContent-Length: 0\r\n\r\n"
    with (
        Answering(to_video.encode()) as here,
        Answering(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n") as elsewhere,
        session(key) as stolen,
    ):
        stolen.forward(ros, here.port)
        stolen.forward(video, elsewhere.port)
        # A session of which nothing is heard for 5 s is ended, and the forwards take their time on a busy machine.
        stolen.send({"type": "ping", "seq": 19, "t_ms": 3.0})
        stolen.answers_pings = True
        async with driver.connect(STOLEN) as socket:
            frame = await asyncio.wait_for(socket.receive(), 10)
        assert socket.close_code in {4503, 4504}, frame
        # The relay may have given up before the question was there.
        await asyncio.to_thread(
            stack.wait,
            "the robot is asked for its rosbridge",
            lambda: any(b"Upgrade: websocket" in asked for asked in here.asked),
            "relay",
        )
        assert elsewhere.asked == []
