"""Checks robots' forwarded ports from the relay's side: what answers, and when one is free again.

`robot_link` gives each session a `LinkChecks`, all of a relay share one `PortChecker`. A check never
holds up the link, takes a bounded time, and reads only the first bytes of an answer.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable, Mapping

from robotether_common.services import ServiceName
from robotether_common.session import ServiceState

from robotether_server.db.fleet import RelayRobot
from robotether_server.tasks import end_tasks

log = logging.getLogger(__name__)

Note = Callable[[ServiceName, ServiceState], None]

# Time limit for a robot's answer, even behind a busy uplink; operators would not wait longer.
ANSWER_WITHIN_S = 3.0
CONNECT_WITHIN_S = 1.0
CHECK_EVERY_S = 5.0
# Maximum number of checks at once; a whole fleet asks after a restart.
CHECKS_AT_ONCE = 64

_REQUEST = (
    b"GET / HTTP/1.1\r\nHost: robot\r\nUser-Agent: robotether-relay\r\nConnection: close\r\n\r\n"
)
# What is sent to each service, and how its answer begins.
PROBES: Mapping[ServiceName, tuple[bytes, re.Pattern[bytes]]] = {
    # The guard answers 426, or 502 when rosbridge behind it does not.
    "ros": (_REQUEST, re.compile(rb"HTTP/1\.[01] [1-4]")),
    "video": (_REQUEST, re.compile(rb"HTTP/1\.[01] [1-5]")),
    "shell": (b"", re.compile(rb"SSH-")),
}
# Number of bytes of an answer that are enough: HTTP's status, SSH's name.
_LOOKED_AT = {True: len(b"HTTP/1.1 2"), False: len(b"SSH-")}
RELEASE_POLL_S = 0.02


class PortChecker:
    """Tries ports on sshd, a bounded number at once."""

    def __init__(
        self, tunnel_host: str, note: Note, *, answer_within_s: float = ANSWER_WITHIN_S
    ) -> None:
        self._host = tunnel_host
        self._note = note
        self._answer_within_s = answer_within_s
        self._slots = asyncio.Semaphore(CHECKS_AT_ONCE)

    async def check(self, robot: RelayRobot, *, video: bool) -> dict[str, ServiceState]:
        """Try the robot's ports beside each other; not the one of `video` when its connection is not open.

        Return what is behind each: `ok` its service, `down` nothing that answers as it should, `unknown` no forward.
        """
        ports = robot.ports if video else {**robot.ports, "video": None}
        async with self._slots:
            health = await asyncio.gather(*(self._try(name, ports[name]) for name in PROBES))
        return dict(zip(PROBES, health, strict=True))

    async def _try(self, service: ServiceName, port: int | None) -> ServiceState:
        health: ServiceState = "unknown"
        if port is not None:
            health = await self._ask(port, *PROBES[service])
        self._note(service, health)
        return health

    async def _ask(self, port: int, request: bytes, beginning: re.Pattern[bytes]) -> ServiceState:
        try:
            async with asyncio.timeout(CONNECT_WITHIN_S):
                reader, writer = await asyncio.open_connection(self._host, port, limit=1024)
        except OSError:  # TimeoutError is one: nobody listens, or sshd itself is away
            return "unknown"
        try:
            async with asyncio.timeout(self._answer_within_s):
                writer.write(request)
                answer = await reader.readexactly(_LOOKED_AT[bool(request)])
        except (OSError, asyncio.IncompleteReadError):
            return "down"
        finally:
            writer.transport.abort()
        return "ok" if beginning.match(answer) else "down"


class LinkChecks:
    """The checks of one session: never two at once, and a pause after each.

    Requests in between get one answer after the pause, about the newest forwards.
    """

    def __init__(self, check: Callable[[], Awaitable[None]]) -> None:
        self._check = check
        self._is_due = False
        self._task: asyncio.Task[None] | None = None

    def ask(self) -> None:
        """Check as soon as it is allowed."""
        self._is_due = True
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """Check no more."""
        if self._task is not None:
            await end_tasks([self._task])

    async def _run(self) -> None:
        while self._is_due:
            self._is_due = False
            try:
                await self._check()
            except Exception:
                log.exception("cannot check a robot's ports")
            await asyncio.sleep(CHECK_EVERY_S)
        self._task = None


async def wait_released(host: str, port: int, *, within_s: float) -> bool:
    """Return True as soon as a connection to `host:port` is refused, False when `within_s` is over.

    One that is slow says nothing: whoever holds the port, or this relay, may only be busy.
    """
    try:
        async with asyncio.timeout(within_s):
            while True:
                if not await _accepts(host, port):
                    return True
                await asyncio.sleep(RELEASE_POLL_S)
    except TimeoutError:
        return False


async def _accepts(host: str, port: int) -> bool:
    try:
        _, writer = await asyncio.open_connection(host, port)
    except TimeoutError:
        return True
    except OSError:  # refused, or sshd itself is away, and no port of it is taken
        return False
    writer.close()
    return True
