"""The stack that experiments run against: its ports, its API as an admin, its containers, and robots enrolled there.

`World.own()` starts a stack for itself and removes it. Robots join by the agent's own code against the server itself.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import shutil
import ssl
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path

from demo import ANSWERS_WITHIN_S, LiveServer
from docker.models.containers import Container
from namespaces import Namespace, make_joined, sweep
from openssh_server import wait_until
from robotether_agent import settings as agent_settings
from robotether_agent.enrolment.enroller import Enroller
from stack import Stack

_numbers = count(1)
# The server lets one robot in at a time; so many keys are made meanwhile.
AT_ONCE = 4
RECORDS_WITHIN_S = 10.0


class World(LiveServer):
    def __init__(self, container: Callable[[str], Container], folder: Path) -> None:
        super().__init__()
        self._container = container
        self._enrolled: list[Enrolled] = []
        self._tokens: dict[str, str] = {}
        # Robots' state and logs; gone at the end.
        self.folder = folder

    @classmethod
    @contextmanager
    def own(cls) -> Iterator[World]:
        # With a short name, as agents make sockets below it.
        with tempfile.TemporaryDirectory(prefix="rt-x-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            stack = Stack(folder / "stack")
            try:
                stack.up(robots=False)
                yield cls(stack.container, folder)
            finally:
                stack.down()

    @cached_property
    def tls_fingerprint(self) -> str:
        host, port = self.address.split(":")
        certificate = ssl.get_server_certificate((host, int(port)), timeout=ANSWERS_WITHIN_S)
        return hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate)).hexdigest()

    def container(self, service: str) -> Container:
        return self._container(service)

    def names(self, part: str, how_many: int) -> list[str]:
        """New names for a part's robots, not given before by this process."""
        return [f"x-{part}-{os.getpid()}-{next(_numbers)}" for _ in range(how_many)]

    def robots(self, how_many: int) -> list[Enrolled]:
        """The first robots of this world; those that are missing join now."""
        missing = how_many - len(self._enrolled)
        self._enrolled += self.enrol(self.names("robot", missing)) if missing > 0 else []
        return self._enrolled[:how_many]

    def enrol(self, names: Sequence[str]) -> list[Enrolled]:
        """Announce robots and let them join with a token of the admin's. None is online then."""
        made = [
            Enrolled(
                name=name,
                mac=local_mac(os.getpid(), next(_numbers)),
                server=self.address,
                tls_fingerprint=self.tls_fingerprint,
                folder=self.folder / name,
            )
            for name in names
        ]
        # As docs/howto/enrolment.md has it: the API takes no MAC that a machine gave itself.
        rows = ", ".join(f"('{robot.mac}', '{robot.name}')" for robot in made)
        statement = f"INSERT INTO robots (mac, name) VALUES {rows}"
        self.exec("mysql", "mariadb", "robotether", "-e", statement)
        asyncio.run(join_all(made, self.token))
        return made

    def record(self, robots: Sequence[str]) -> list[int]:
        """Start a recording of each robot, online now, and return their ids once all are written."""
        ids = [self.ask("POST", f"/robots/{robot}/recordings")["id"] for robot in robots]
        waiting = set(ids)

        def are_written() -> bool:
            for recording in sorted(waiting):
                if self.ask("GET", f"/recordings/{recording}")["state"] == "recording":
                    waiting.discard(recording)
            return not waiting

        wait_until(are_written, lambda: f"recordings {waiting}", RECORDS_WITHIN_S, every_s=0.25)
        return ids

    def stop_recordings(self, ids: Sequence[int]) -> None:
        for recording in ids:
            self.ask("POST", f"/recordings/{recording}/stop")

    def remove(self, robots: Sequence[Enrolled]) -> None:
        for robot in robots:
            self.ask("DELETE", f"/robots/{robot.name}")
            shutil.rmtree(robot.folder, ignore_errors=True)

    @contextmanager
    def uplinks(self, how_many: int) -> Iterator[list[Namespace]]:
        """So many networks of robots, whose only way out is a cable to this machine; needs root.

        Packets are routed and never translated, so that the server sees the address that the robot has; published ports
        are reached by the kernel's own translation, as from outside, and not by a proxy process.
        """
        sweep()
        with ExitStack() as made:
            yield [make_joined(made, "uplink")[0] for _ in range(how_many)]

    def admin_token(self, user: str) -> str:
        if user not in self._tokens:
            self.ask("POST", "/users", {"name": user, "role": "admin"})
            self._tokens[user] = self.token_of(user)
        return self._tokens[user]


@dataclass(frozen=True)
class Enrolled:
    name: str
    mac: str
    # HOST:PORT of the server's https, the same from every uplink: a robot may start behind any of them.
    server: str
    tls_fingerprint: str
    # With `state` in it; what runs writes its logs here.
    folder: Path

    @property
    def state_dir(self) -> Path:
        return self.folder / "state"

    @property
    def settings(self) -> dict[str, str]:
        return {
            "server": self.server,
            "tls_fingerprint": self.tls_fingerprint,
            "mac": self.mac,
            "allow_local_mac": "true",
            "state_dir": str(self.state_dir),
        }


def environment(settings: Mapping[str, object]) -> dict[str, str]:
    return {f"ROBOTETHER_{name.upper()}": str(value) for name, value in settings.items()}


def local_mac(pid: int, number: int) -> str:
    """A locally administered MAC of robot `number` of this process; both count to 16 million and 65,536."""
    digits = f"02{pid % (1 << 24):06x}{number % (1 << 16):04x}"
    return ":".join(digits[at : at + 2] for at in range(0, len(digits), 2))


async def join_all(robots: Sequence[Enrolled], token: str) -> None:
    """Let each make its key and join with the token, as an agent does at its first start."""
    slots = asyncio.Semaphore(AT_ONCE)

    async def join(robot: Enrolled) -> None:
        robot.folder.mkdir(mode=0o700)
        given = environment({**robot.settings, "token": token})
        async with slots:
            await Enroller(agent_settings.load(None, given)).join()

    await asyncio.gather(*map(join, robots))
