"""Connects to the server at whichever cell and port answers.

One for all connections of an agent. It tries the cells in the order of the server's newest list, and at each the port
that worked last first; video and shell go to the session's cell. While nothing answers, it asks the web now and then
where the server is, without delaying the attempts.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from time import monotonic
from typing import NoReturn

from robotether_common.session import Kind

from robotether_agent.backoff import Repeats
from robotether_agent.enrolment.enroller import Enroller, Enrolment
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.enrolment.keys import KeyPair
from robotether_agent.fields import ListedCell
from robotether_agent.net.happy_eyeballs import combined_problem
from robotether_agent.net.http_proxy import proxy_of
from robotether_agent.net.server_dialer import NEXT_CELL_AFTER_S, ServerDialer, SshAddress
from robotether_agent.problems import (
    AgentError,
    LinkError,
    LinkLostError,
    NoAnswerError,
    Retry,
    ServerKeyChangedError,
    ServerSilentError,
    ServerUnreachableError,
    SessionEndedError,
)
from robotether_agent.settings import Settings
from robotether_agent.tasks import first_of
from robotether_agent.tunnel.connection import Role, run_connection
from robotether_agent.tunnel.distances import Distances
from robotether_agent.tunnel.openssh import SshFiles
from robotether_agent.tunnel.session import NO_RELAY_BYES, Session, SessionConfig

# Time without a connection before the agent asks web for the server's address; shorter cuts are
# mostly the network's.
ASK_WEB_AFTER_S = 15.0
ASK_WEB_EVERY_S = 30.0
# Maximum age of a cell's silence that counts as its time to answer.
JUST_SILENT_S = 3.0
# Time after which a log-in counts as hanging; OpenSSH gives it up after 10 to 15 s, and a rejection
# comes sooner.
HANGS_AFTER_S = 8.0
OTHERS_ADVICE = (
    "SOMEBODY MAY BE POSING AS THE SERVER there: ask the server's administrator whether that address is one of its "
    "machines; the agent goes on with the other addresses"
)


class Connector:
    """Where the server is, which of its cells has the session, and which ports this network lets through."""

    def __init__(self, settings: Settings, enroller: Enroller) -> None:
        self._settings = settings
        self._enroller = enroller
        self._good_port: int | None = None
        self._server_dialer = ServerDialer(
            proxy_of(settings.http_proxy), https_port=settings.server_port
        )
        self._distances = Distances(self._server_dialer)
        self._silent_since: float | None = None
        self._asked_at = 0.0
        # Where the session is, or was last.
        self._cell: ListedCell | None = None
        self._cell_left = asyncio.Event()
        # When a cell last led to no session, for those since the last one.
        self._failed_at: dict[ListedCell, float] = {}
        self._fell_silent: tuple[ListedCell | None, float] = (None, 0.0)
        self._repeats = Repeats()

    async def connect(self, enrolment: Enrolment, key: KeyPair, role: Role) -> None:
        """Connect where the server answers; raise what ended the connection."""
        if role.kind == "session":
            await self._connect(enrolment.ssh, key, role)
        else:
            await first_of(self._connect(enrolment.ssh, key, role), self._until_cell_left())

    async def _connect(self, ssh: SshAccess, key: KeyPair, role: Role) -> None:
        coming = await self._enroller.next_key()
        # The server may know either of them when a change of keys was cut short.
        keys = (key.path,) if coming is None else (key.path, coming.path)
        control = self._settings.run_dir / f"{role.kind}.ctl"
        files = SshFiles(keys, self._enroller.known_hosts, control)
        left = self.targets(ssh, role.kind)
        failed: list[AgentError] = []
        while left:
            try:
                target = await self._find(left)
            except (NoAnswerError, ServerUnreachableError) as problem:
                failed.append(problem)
                break
            began = monotonic()
            failed.append(await self._unless_unreachable(target, files, role, ssh))
            left.remove(target)
            if isinstance(failed[-1], ServerKeyChangedError):
                left = [other for other in left if other.cell != target.cell]
            elif monotonic() - began > HANGS_AFTER_S:
                # Its other ports lead to the same sshd.
                left.sort(key=lambda other: other.cell == target.cell)
        raise _why_nowhere(failed, len(ssh.in_order(self._settings)))

    def targets(self, ssh: SshAccess, kind: Kind) -> list[SshAddress]:
        """Return the server's SSH addresses in the order in which they are tried.

        Of cells with one rank, those that are clearly farther than another come after it. A cell that let the robot
        begin and led to no session, or whose relay hangs or is gone, comes after all others: it may be alive and
        useless.
        """
        if kind != "session" and self._cell is not None:
            cells = [self._cell]
        else:
            cells = self._distances.by_distance(ssh.in_order(self._settings))
            cells.sort(key=lambda cell: self._failed_at.get(cell, 0.0))
        return [
            SshAddress(cell.host, port, ssh.user, self._server_dialer, cell)
            for cell in cells
            for port in sorted(cell.ports, key=lambda port: port != self._good_port)
        ]

    async def ask_for_nearer(self, session: Session) -> NoReturn:
        """Measure how far the cells are, and ask the server for a move to one that is clearly nearer."""
        first = await session.new_config(None)

        def place() -> tuple[ListedCell | None, Sequence[ListedCell]]:
            # Addresses of an admin's are no choice of the robot's.
            is_set = self._settings.ssh_host or self._settings.ssh_ports
            return self._cell, () if is_set else (session.config or first).cells

        def ask(cell: ListedCell) -> None:
            session.send({"type": "nearer", "host": cell.host, "ports": list(cell.ports)})

        await self._distances.keep_asking(place, ask)

    async def _until_cell_left(self) -> None:
        """Raise when the session is at another cell than before, where its video and shell belong too."""
        await self._cell_left.wait()
        why = "the robot's session is at another machine of the server now"
        raise LinkLostError(f"left the connection: {why}", retry=Retry.AT_ONCE)

    def _is_at(self, cell: ListedCell | None) -> None:
        self._failed_at.clear()
        self._repeats.forget()
        if cell != self._cell:
            self._cell = cell
            self._cell_left.set()
            self._cell_left = asyncio.Event()

    async def _find(self, targets: list[SshAddress]) -> SshAddress:
        """Return where the server answers, and know since when it did not."""
        cell, at = self._fell_silent
        is_silent = cell == targets[0].cell and monotonic() - at < JUST_SILENT_S
        unreached_s = NEXT_CELL_AFTER_S if is_silent else 0.0
        find = self._server_dialer.find(targets, unreached_s=unreached_s)
        try:
            is_long = self._is_silent_for_long()
            target = await (first_of(find, self._ask_web()) if is_long else find)
        except NoAnswerError:
            self._silent_since = self._silent_since or monotonic()
            raise
        except ServerUnreachableError:
            self._silent_since = None
            raise
        self._silent_since = None
        return target

    def _is_silent_for_long(self) -> bool:
        now, since = monotonic(), self._silent_since
        if since is None or now - since < ASK_WEB_AFTER_S or now - self._asked_at < ASK_WEB_EVERY_S:
            return False
        self._asked_at = now
        return True

    async def _ask_web(self) -> NoReturn:
        """Learn the server's address and ports again, if the web answers; the next attempt goes by them."""
        await self._enroller.refresh()
        # Ends with the attempt beside it.
        await asyncio.Event().wait()
        raise AssertionError("nothing ends this wait")

    async def _unless_unreachable(
        self, target: SshAddress, files: SshFiles, role: Role, ssh: SshAccess
    ) -> ServerUnreachableError | ServerKeyChangedError:
        """Connect to `target`; return only if no SSH server of ours lets us begin there."""
        was_up = False

        def on_up(at: SshAddress, config: SessionConfig, session: Session) -> None:
            nonlocal was_up
            was_up = True
            # On many networks only one of the ports is let out.
            self._good_port = at.port
            if role.kind == "session":
                self._is_at(at.cell)
            role.on_up(at, config, session)

        try:
            await run_connection(
                target, files, self._followed(replace(role, on_up=on_up), target, ssh)
            )
        except ServerUnreachableError as problem:
            return problem
        except ServerKeyChangedError as problem:
            if len(ssh.in_order(self._settings)) > 1:
                self._repeats.log_problem(role.kind, _among_others(problem.message))
            return problem
        except LinkError as problem:
            if role.kind == "session":
                self._note_end(target.cell, problem, was_up=was_up)
            raise

    def _followed(self, role: Role, target: SshAddress, ssh: SshAccess) -> Role:
        """Return the role of a session that follows the server's newest list; that of any other connection as it is."""
        if role.kind != "session":
            return role

        def on_config(config: SessionConfig) -> None:
            nonlocal ssh
            if config.cells:
                ssh = replace(ssh, cells=config.cells)
            self._enroller.follow(config.robot, config.cells)
            if role.on_config is not None:
                role.on_config(config)

        def elsewhere() -> list[SshAddress]:
            return [other for other in self.targets(ssh, "session") if other.cell != target.cell]

        return replace(role, on_config=on_config, elsewhere=elsewhere)

    def _note_end(self, cell: ListedCell | None, problem: LinkError, *, was_up: bool) -> None:
        if isinstance(problem, ServerSilentError):
            self._fell_silent = (cell, monotonic())
        if cell is not None and (not was_up or has_no_relay(problem)):
            self._failed_at[cell] = monotonic()


def has_no_relay(problem: AgentError) -> bool:
    """Return whether a session ended because its cell's relay hangs or is gone, though the way to the cell is good."""
    if isinstance(problem, ServerSilentError):
        # With Retry.AT_ONCE nothing that was sent is acknowledged, or this robot slept: it may be the network.
        return problem.retry is not Retry.AT_ONCE
    return isinstance(problem, SessionEndedError) and problem.code in NO_RELAY_BYES


def _why_nowhere(failed: Sequence[AgentError], cells: int) -> AgentError:
    """Return one problem for all; a wrong host key ends the agent only if each of the `cells` has one."""
    wrong = [problem for problem in failed if isinstance(problem, ServerKeyChangedError)]
    if not wrong:
        return combined_problem(failed)
    if len(wrong) >= cells:
        return wrong[0]
    return _among_others("; ".join(problem.message for problem in failed))


def _among_others(message: str) -> ServerKeyChangedError:
    return ServerKeyChangedError(message, advice=OTHERS_ADVICE, retry=Retry.SOON)
