"""People and robots for the tests of the account `jump`: rows in the running stack's database, and a robot's sshd.

The rows are written with SQL, so that the tests ask what sshd makes of the records, whoever writes them.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from socketserver import BaseRequestHandler, ThreadingTCPServer
from typing import Any

from robot_key import RobotKey, first_line
from stack import Stack

JUMP = "jump@127.0.0.1"
TUNNEL = "tunnel@127.0.0.1"
BANNER = b"SSH-2.0-the_robots_own\r\n"
# The watch of the server looks once a second; more is what a busy machine takes.
ENDED_WITHIN_S = 20
PING_EVERY_S = 1.0


class _Banner(BaseRequestHandler):
    def handle(self) -> None:
        self.request.sendall(BANNER)
        while data := self.request.recv(4096):
            self.request.sendall(data)


class RobotSshd(ThreadingTCPServer):
    """What stands on a robot's port 22: says an SSH server's first line, then echoes."""

    daemon_threads = True
    allow_reuse_address = True

    @classmethod
    @contextmanager
    def running(cls) -> Iterator[int]:
        with cls(("127.0.0.1", 0), _Banner) as server:
            thread = threading.Thread(target=server.serve_forever, args=(0.05,))
            thread.start()
            try:
                yield server.server_address[1]
            finally:
                server.shutdown()
                thread.join()


class ShellRobot:
    """An active robot with a shell port; `listening` opens its forward as an agent does."""

    def __init__(self, stack: Stack, folder: Path, name: str) -> None:
        self.stack = stack
        self.name = name
        self.key = RobotKey(stack, folder, name)
        self._control = folder / f"{name}.control"

    @classmethod
    @contextmanager
    def added(cls, stack: Stack, folder: Path, name: str, mac: str) -> Iterator[ShellRobot]:
        """Add a robot, and remove it whatever happens: names and MACs come again in the next module."""
        robot = cls(stack, folder, name)
        key = " ".join(robot.key.public.split()[:2])
        stack.sql(
            "INSERT INTO robots (mac, name, state, public_key, fingerprint, shell) "
            f"VALUES ('{mac}', '{name}', 'active', '{key}', '{robot.key.fingerprint}', TRUE)"
        )
        try:
            yield robot
        finally:
            stack.sql(f"DELETE FROM robots WHERE name = '{name}'")

    @property
    def shell_port(self) -> int:
        [[port]] = self.stack.sql(f"SELECT shell_port FROM robots WHERE name = '{self.name}'")
        return int(port)

    @contextmanager
    def listening(self, kind: str = "shell") -> Iterator[subprocess.Popen[str]]:
        """Have the robot's connection with its forward to a robot's sshd."""
        port = self.shell_port
        with RobotSshd.running() as target:
            running = self.key.start("-M", "-S", str(self._control), TUNNEL, kind)
            try:
                assert '"config"' in first_line(running)
                forward = ("-O", "forward", "-R", f"0.0.0.0:{port}:127.0.0.1:{target}")
                done = self.key.ssh("-S", str(self._control), *forward, TUNNEL)
                assert done.returncode == 0, done.stderr
                with heartbeat(running):
                    yield running
            finally:
                end(running)


@contextmanager
def heartbeat(running: subprocess.Popen[str]) -> Iterator[None]:
    """Ping the relay, as an agent does, until the connection ends; ends it with the block."""
    ended = threading.Event()

    def keep_pinging() -> None:
        assert running.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            for seq in itertools.count():
                ping = {"type": "ping", "seq": seq, "t_ms": time.monotonic() * 1000}
                running.stdin.write(json.dumps(ping) + "\n")
                running.stdin.flush()
                if ended.wait(PING_EVERY_S):
                    break

    thread = threading.Thread(target=keep_pinging)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        running.terminate()
        thread.join()


class Person:
    def __init__(self, stack: Stack, folder: Path, name: str) -> None:
        self.stack = stack
        self.name = name
        self.key = RobotKey(stack, folder, name)

    @classmethod
    @contextmanager
    def added(
        cls, stack: Stack, folder: Path, name: str, levels: Mapping[ShellRobot, str]
    ) -> Iterator[Person]:
        """Add a user with a key and grants, and remove them at the end."""
        person = cls(stack, folder, name)
        key = " ".join(person.key.public.split()[:2])
        try:
            stack.sql(f"INSERT INTO users (name, password_hash) VALUES ('{name}', 'x')")
            stack.sql(
                "INSERT INTO user_ssh_keys (user_id, name, fingerprint, public_key) "
                f"SELECT id, 'laptop', '{person.key.fingerprint}', '{key}' FROM users WHERE name = '{name}'"
            )
            for robot, level in levels.items():
                person.grant(robot, level)
            yield person
        finally:
            stack.sql(f"DELETE FROM users WHERE name = '{name}'")

    def grant(self, robot: ShellRobot, level: str) -> None:
        self.stack.sql(
            "REPLACE INTO grants (user_id, robot_id, level) SELECT u.id, r.id, "
            f"'{level}' FROM users u, robots r WHERE u.name = '{self.name}' AND r.name = '{robot.name}'"
        )

    def lose_grants(self) -> None:
        mine = f"u.name = '{self.name}'"
        self.stack.sql(f"DELETE g FROM grants g JOIN users u ON u.id = g.user_id WHERE {mine}")

    def reach(self, port: int) -> subprocess.CompletedProcess[str]:
        return self.key.ssh("-W", f"127.0.0.1:{port}", JUMP)

    @contextmanager
    def connected(self, port: int) -> Iterator[subprocess.Popen[str]]:
        running = self.key.start("-W", f"127.0.0.1:{port}", JUMP)
        try:
            assert first_line(running).encode() == BANNER.replace(b"\r\n", b"\n")
            yield running
        finally:
            end(running)


def end(running: subprocess.Popen[str]) -> str:
    # Not SIGTERM: a client (OpenSSH 9.2, `-N -D`) was seen to live on for 10 s after one.
    running.kill()
    return running.communicate(timeout=10)[1]


def ended(running: subprocess.Popen[Any], seconds: float = ENDED_WITHIN_S) -> bool:
    try:
        running.wait(timeout=seconds)
    except subprocess.TimeoutExpired:
        return False
    return True


def lives(running: subprocess.Popen[str], word: str) -> bool:
    assert running.stdin is not None
    running.stdin.write(f"{word}\n")
    running.stdin.flush()
    return first_line(running) == f"{word}\n"
