"""Accepts robots' sessions from sshd, checks their preface, and runs their links.

`wiring` starts it on a port that only the network `tunnel` reaches. A connection that does not prove
itself at once gets no answer.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import get_args

from robotether_common.session import MAX_LINE_BYTES, ByeCode, Kind

from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.logs import set_connection_id
from robotether_server.problems import ProtocolError, StoreUnavailableError
from robotether_server.relay.robots import session_messages as lines
from robotether_server.relay.robots.authorization import NotAuthorizedError, authorize
from robotether_server.relay.robots.port_checks import PortChecker
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot_link import FAREWELL_S, LinkRules, RobotLink
from robotether_server.relay.robots.session_messages import Preface, WrongKeyError
from robotether_server.tasks import end_tasks

log = logging.getLogger(__name__)

PREFACE_WITHIN_S = 5.0
# Maximum number of connections that wait to be accepted; a whole fleet reconnects after a restart.
BACKLOG = 2048


class SessionServer:
    """The TCP server for robots' sessions."""

    def __init__(
        self,
        *,
        registry: SessionRegistry,
        snapshot: Callable[[], Snapshot],
        refresh: Callable[[], Awaitable[None]],
        rules: LinkRules,
        checker: PortChecker,
        refused: Callable[[str], None],
    ) -> None:
        self._registry = registry
        self._snapshot = snapshot
        self._refresh = refresh
        self._rules = rules
        self._checker = checker
        self._refused = refused
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._live: dict[RobotLink, None] = {}
        # Number of log-ins through sshd that came here and were accepted.
        self.logins: Counter[str] = Counter(dict.fromkeys(get_args(Kind), 0))

    async def start(self, host: str, port: int) -> int:
        """Listen; port 0 is any that is free. Return the port."""
        self._server = await asyncio.start_server(
            self._accept, host, port, limit=MAX_LINE_BYTES, backlog=BACKLOG
        )
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Say bye to all robots and listen no more."""
        if self._server is not None:
            self._server.close()
        for link in list(self._live):
            link.end("relay_stopping", "the relay is stopping; connect again in a moment")
        if self._tasks:
            _, running = await asyncio.wait(self._tasks, timeout=2 * FAREWELL_S)
            await end_tasks(running)

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """End the links of robots that may no longer connect; send others their new settings."""
        for link in list(self._live):
            _apply(snapshot, link)

    def on_cells(self) -> None:
        """Send robots where they connect, if that has changed."""
        for link in list(self._live):
            link.on_cells()

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.get_running_loop().create_task(self._handle(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _handle(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._serve(reader, writer)
        except Exception:
            log.exception("a robot's connection failed")
        finally:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(PREFACE_WITHIN_S):
                preface = lines.parse_preface(
                    await reader.readline(), self._rules.settings.session_key
                )
            robot = await self._authorize(preface)
        except (TimeoutError, ConnectionError, ValueError, ProtocolError, WrongKeyError) as exc:
            self._refused("preface")
            log.warning("a connection to the session port is closed: %s", _describe_error(exc))
        except NotAuthorizedError as refusal:
            self._refused(refusal.code)
            await _say_bye(writer, refusal.code, refusal.detail)
        except StoreUnavailableError as problem:
            self._refused("not_ready")
            await _say_bye(writer, "not_ready", problem.detail)
        else:
            await self._run_link(preface, robot, reader, writer)

    async def _authorize(self, preface: Preface) -> RelayRobot:
        """Find the robot; sshd has just found it in the database, so it may be newer than the snapshot."""
        try:
            return authorize(self._snapshot(), preface)
        except NotAuthorizedError:
            await self._refresh()
            return authorize(self._snapshot(), preface)

    async def _run_link(
        self,
        preface: Preface,
        robot: RelayRobot,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        link = RobotLink(
            preface,
            robot,
            reader=reader,
            writer=writer,
            registry=self._registry,
            rules=self._rules,
            checker=self._checker,
        )
        set_connection_id(preface.connection_id)
        self._live[link] = None
        self.logins[preface.kind] += 1
        try:
            await link.run()
        finally:
            del self._live[link]


def _apply(snapshot: Snapshot, link: RobotLink) -> None:
    try:
        link.reconfigure(authorize(snapshot, link.preface))
    except NotAuthorizedError as refusal:
        link.end(refusal.code, refusal.detail)


async def _say_bye(writer: asyncio.StreamWriter, code: ByeCode, detail: str) -> None:
    writer.write(lines.bye_line(code, detail))
    writer.close()
    try:
        async with asyncio.timeout(FAREWELL_S):
            await writer.wait_closed()
    except (TimeoutError, ConnectionError):
        log.debug("a rejected robot did not read its bye")


def _describe_error(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return f"no preface in {PREFACE_WITHIN_S:g} s"
    return str(error) or "it broke"
