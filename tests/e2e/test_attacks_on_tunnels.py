"""What somebody with a stolen robot key tries; none of it reaches another robot.

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
from attackers import OPEN, raw
from programs import Program
from robot_key import RobotKey
from stack import Stack, wait_until_back

USER = "tunnel@127.0.0.1"
VICTIM, STOLEN = "sim1", "stolen"
MAC = "00:00:5e:00:53:70"


@contextmanager
def stolen_key(stack: Stack, folder: Path, name: str, mac: str) -> Iterator[RobotKey]:
    """The key of a new robot that is active, and gone afterwards."""
    stack.robotether("robot", "add", name, "--mac", mac)
    try:
        stolen = RobotKey(stack, folder, name)
        status, _ = stolen.join(mac)
        assert status == 202
        stack.robotether("robot", "approve", name, "--yes")
        yield stolen
    finally:
        stack.robotether("robot", "remove", name, "--yes")


@pytest.fixture(scope="module")
def key(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotKey]:
    """The stolen key."""
    with stolen_key(stack, tmp_path_factory.mktemp("keys"), STOLEN, MAC) as stolen:
        yield stolen


@pytest.fixture
def liar(stack: Stack, tmp_path: Path) -> Iterator[RobotKey]:
    """Another stolen key, whose robot stays stopped afterwards."""
    with stolen_key(stack, tmp_path, "liar", "00:00:5e:00:53:72") as stolen:
        yield stolen


@pytest.fixture(scope="module")
def admin(stack: Stack) -> dict[str, str]:
    """The header of an admin, who drives and stops; the victim is there, whatever other tests did to it."""
    wait_until_back(stack, VICTIM)
    stack.wait_until_free(VICTIM)
    return {"Authorization": f"Bearer {stack.token('attacked')}"}


@pytest.fixture(scope="module")
def driver(stack: Stack) -> Program:
    """Somebody who means to drive the robot whose key is stolen."""
    return Program(stack, stack.token("misled"))


@pytest.fixture(autouse=True)
def victim_stays(stack: Stack, admin: dict[str, str]) -> Iterator[None]:
    """After each attempt the other robot is what it was: online, not stopped, driven by nobody."""
    yield
    listed = json.loads(raw(stack, "GET", "/api/v1/robots", headers=admin).body)["robots"]
    assert [robot["online"] for robot in listed if robot["name"] == VICTIM] == [True]
    control = control_of(stack, VICTIM, admin)
    assert (control["stopped"], control["driver"], control["guard"]) == (None, None, "ready")


def control_of(stack: Stack, robot: str, admin: dict[str, str]) -> dict[str, Any]:
    answer = raw(stack, "GET", f"/api/v1/robots/{robot}/control", headers=admin)
    assert answer.code == OPEN, answer
    return dict(json.loads(answer.body))


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


LISTENS = {
    "another robot's rosbridge": "0.0.0.0:{victim_ros}:127.0.0.1:9",
    "another robot's video": "0.0.0.0:{victim_video}:127.0.0.1:9",
    "the next port": "0.0.0.0:{next}:127.0.0.1:9",
    "any port": "0.0.0.0:0:127.0.0.1:9",
    "sshd's own": "0.0.0.0:2222:127.0.0.1:9",
    "the relay's": "0.0.0.0:8091:127.0.0.1:9",
    "a socket file": "/tmp/attack:127.0.0.1:9",
}


@pytest.mark.parametrize("attempt", LISTENS)
def test_a_stolen_key_listens_for_nobody_else(key: RobotKey, stack: Stack, attempt: str) -> None:
    """What is sent to another robot never comes to the thief."""
    [[ros, video]] = stack.sql(f"SELECT ros_port, video_port FROM robots WHERE name = '{VICTIM}'")
    forward = LISTENS[attempt].format(victim_ros=ros, victim_video=video, next=max(key.ports()) + 1)
    done = key.ssh("-N", "-R", forward, USER)
    assert done.returncode == 255
    assert "remote port forwarding failed" in done.stderr or "remote forward" in done.stderr


REACHES = [
    "mysql:3306", "relay:8091", "relay:8080", "relay:9100", "web:8000", "nginx:8443", "127.0.0.1:2222",
    "127.0.0.1:{victim_ros}", "sshd:{victim_ros}", "127.0.0.1:{own_ros}",
]  # fmt: skip


@pytest.mark.parametrize("target", REACHES)
def test_a_stolen_key_reaches_nothing(key: RobotKey, stack: Stack, target: str) -> None:
    """No service of the server, and no robot's port, its own included."""
    [[ros]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    done = key.ssh("-W", target.format(victim_ros=ros, own_ros=key.ports()[0]), USER)
    assert done.returncode != 0
    assert "administratively prohibited" in done.stderr


RUNS: list[tuple[str, ...]] = [
    (), ("sh",), ("session 1",), ("session;id",), ("media --robot 1",), ("session\nid",), ("$(id)",), ("-t", "sh"),
    ("/usr/lib/robotether/session 1 SHA256:x 20000",), ("-s", "sftp"),
]  # fmt: skip


@pytest.mark.parametrize("command", RUNS, ids=repr)
def test_a_stolen_key_runs_nothing(key: RobotKey, command: tuple[str, ...]) -> None:
    """Only its own sessions; who it is comes from the key, and not from what is asked for."""
    options = [part for part in command if part.startswith("-")]
    words = [part for part in command if not part.startswith("-")]
    done = key.ssh(*options, USER, *words)
    assert done.returncode != 0
    assert "uid=" not in done.stdout
    assert '"config"' not in done.stdout


JOINS: dict[str, tuple[dict[str, object], str]] = {
    "as another robot": ({"mac": "02:00:00:00:51:01"}, "409 key_in_use"),
    "as a new robot": ({"mac": "00:00:5e:00:53:71"}, "409 key_in_use"),
    "with a name": ({"name": VICTIM}, "200 open"),
    "with a forged rotation": (
        {
            "mac": "02:00:00:00:51:01",
            "previous_key": {"fingerprint": "SHA256:" + "A" * 43, "signature": "x"},
        },
        "409 key_in_use",
    ),
}


@pytest.mark.parametrize("attempt", JOINS)
def test_a_stolen_key_joins_as_itself_only(key: RobotKey, stack: Stack, attempt: str) -> None:
    """The key belongs to one MAC; a wish for another name changes nothing."""
    fields, expected = dict(JOINS[attempt][0]), JOINS[attempt][1]
    body = key.join_body(str(fields.pop("mac", MAC)), **fields)
    answer = raw(stack, "POST", "/api/v1/join", body=body)
    assert answer.said == expected
    assert VICTIM not in answer.body


GUARD = {
    "type": "guard", "state": "ready", "stopped": False, "by": "", "moving": False, "answers": None,
    "refused": {"old": 0, "fence": 0, "stopped": 0, "shape": 0, "held": 0},
}  # fmt: skip
BREAKING: dict[str, list[object]] = {
    "a flood": [{"type": "ping", "seq": number, "t_ms": 1.0} for number in range(5000)],
    "a long line": [{"type": "health", "ros": "ok", "video": "ok", "detail": "x" * 70_000}],
    "rubbish": ["rubbish"],
    "depth": ["[" * 30_000],
    "no type": ["{}"],
    "a hello of another kind": [
        {"type": "hello", "hostname": "x", "agent_version": "1", "guard": "maybe"}
    ],
    "a guard in no state": [{**GUARD, "state": "driving"}],
    "a guard half stopped": [{**GUARD, "stopped": "no"}],
    "a guard with a long name": [{**GUARD, "stopped": True, "by": "x" * 10_000}],
    "a moment beyond time": ['{"type": "ping", "seq": 1, "t_ms": 1e999}'],
    "a moment that is none": ['{"type": "ping", "seq": 1, "t_ms": NaN}'],
}


@pytest.mark.parametrize("attempt", BREAKING)
def test_lines_that_break_the_protocol_end_the_session(key: RobotKey, attempt: str) -> None:
    """The thief's own, and no other."""
    with session(key) as stolen:
        stolen.send(*BREAKING[attempt])
        bye = stolen.wait_for("bye")
        # Lines that the relay no longer reads may reset its connection, and its bye with it.
        assert bye.get("code", "end") in {"protocol_error", "relay_lost", "end"}


IGNORED: dict[str, object] = {
    "another preface": {
        "type": "preface", "kind": "session", "robot_id": 1, "fingerprint": "", "ports": [], "address": "",
        "session_key": "",
    },
    "a configuration": {"type": "config", "robot": VICTIM, "ros_port": 20000, "video_port": 20001},
    "a lease": {"type": "lease", "fence": 999, "held": True, "robot": VICTIM},
    "a stop": {"type": "stop", "id": "1", "by": "thief", "robot": VICTIM},
    "a release": {"type": "release", "id": "1", "by": "thief", "robot": VICTIM},
    "a checked": {"type": "checked", "ros": "ok", "video": "ok", "robot": VICTIM},
    "a bye": {"type": "bye", "code": "superseded", "detail": "x", "robot": VICTIM},
}  # fmt: skip


@pytest.mark.parametrize("attempt", IGNORED)
def test_lines_of_the_relay_mean_nothing_from_a_robot(key: RobotKey, attempt: str) -> None:
    """They are passed over, whomever they name, and the session goes on."""
    with session(key) as stolen:
        stolen.send(IGNORED[attempt], {"type": "ping", "seq": 17, "t_ms": 1.0})
        assert stolen.wait_for("pong")["seq"] == 17


def test_a_guard_that_lies_releases_nothing(
    liar: RobotKey, stack: Stack, admin: dict[str, str]
) -> None:
    """A robot that says that it is not stopped, or answers what nobody asked, stays stopped at the server."""
    stop, release = (f"/api/v1/robots/{liar.name}/{deed}" for deed in ("stop", "release"))
    with session(liar) as stolen:
        stolen.send(GUARD)
        assert raw(stack, "POST", stop, headers=admin, body={}).code == OPEN
        asked = stolen.wait_for("stop")
        stolen.send({**GUARD, "answers": "another"}, {**GUARD, "answers": asked["id"]}, GUARD)
        stolen.send({"type": "ping", "seq": 18, "t_ms": 2.0})
        assert stolen.wait_for("pong")["seq"] == 18
        stopped = control_of(stack, liar.name, admin)["stopped"]
        assert stopped is not None
        assert stopped["confirmed"] is False
        assert raw(stack, "POST", release, headers=admin).said == "504 guard_silent"
        assert control_of(stack, liar.name, admin)["stopped"] is not None


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


async def test_a_robot_leads_its_driver_nowhere(
    key: RobotKey, stack: Stack, driver: Program
) -> None:
    """Whoever drives the thief's robot is not sent on, to another robot's port or to what is inside."""
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
