"""Opens one connection of a kind to whichever of the server's SSH ports answers.

Used by the agent for all its connections; the port that worked last is tried first by each of them. While nothing
answers it asks the web now and then where the server is, beside the attempts, which never wait for that.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from time import monotonic

from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.enrolment.enrolment_store import Enrolment
from robotether_agent.enrolment.keys import KeyPair
from robotether_agent.net.happy_eyeballs import combined_problem
from robotether_agent.net.http_proxy import proxy_of
from robotether_agent.net.server_dialer import ServerDialer, Target
from robotether_agent.problems import NoAnswer, Problem, ServerUnreachable
from robotether_agent.settings import Settings
from robotether_agent.tasks import first_of
from robotether_agent.tunnel.connection import Role, run_connection
from robotether_agent.tunnel.session import Session, SessionConfig
from robotether_agent.tunnel.ssh_command import SshFiles

# A cut is mostly the network's: only after a longer one the server may have moved.
ASK_WEB_AFTER_S = 15.0
ASK_WEB_EVERY_S = 30.0


class Connector:
    """Where the server is, and which of its ports is let through on this network."""

    def __init__(self, settings: Settings, enroller: Enroller) -> None:
        self._settings = settings
        self._enroller = enroller
        self._good_port: int | None = None
        self._server_dialer = ServerDialer(
            proxy_of(settings.http_proxy), https_port=settings.server_port
        )
        self._silent_since: float | None = None
        self._asked_at = 0.0

    async def connect(self, enrolment: Enrolment, key: KeyPair, role: Role) -> None:
        """Connect where the server answers; raise what ended the connection."""
        coming = await self._enroller.next_key()
        # The server may know either of them when a change of keys was cut short.
        keys = (key.path,) if coming is None else (key.path, coming.path)
        control = self._settings.run_dir / f"{role.kind}.ctl"
        files = SshFiles(keys, self._enroller.known_hosts, control)
        left = self.targets(enrolment)
        failed: list[Problem] = []
        while left:
            try:
                target = await self._find(left)
            except (NoAnswer, ServerUnreachable) as problem:
                raise combined_problem([*failed, problem]) from problem
            left.remove(target)
            failed.append(await self._unless_unreachable(target, files, role))
        raise combined_problem(failed)

    def targets(self, enrolment: Enrolment) -> list[Target]:
        """Return the server's SSH addresses in the order in which they are tried."""
        settings, ssh = self._settings, enrolment.ssh
        host = settings.ssh_host or ssh.host or settings.server_host
        ports = settings.ssh_ports or ssh.ports
        in_order = sorted(ports, key=lambda port: port != self._good_port)
        return [Target(host, port, ssh.user, self._server_dialer) for port in in_order]

    async def _find(self, targets: list[Target]) -> Target:
        """Return where the server answers, and know since when it did not."""
        found: list[Target] = []

        async def find() -> None:
            found.append(await self._server_dialer.find(targets))

        try:
            await first_of(find(), *([self._ask_web()] if self._is_silent_for_long() else []))
        except NoAnswer:
            self._silent_since = self._silent_since or monotonic()
            raise
        except ServerUnreachable:
            self._silent_since = None
            raise
        self._silent_since = None
        return found[0]

    def _is_silent_for_long(self) -> bool:
        now, since = monotonic(), self._silent_since
        if since is None or now - since < ASK_WEB_AFTER_S or now - self._asked_at < ASK_WEB_EVERY_S:
            return False
        self._asked_at = now
        return True

    async def _ask_web(self) -> None:
        """Learn the server's address and ports anew, if the web answers; the next attempt goes by them."""
        await self._enroller.refresh()
        # Ends with the attempt that it stands beside.
        await asyncio.Event().wait()

    async def _unless_unreachable(
        self, target: Target, files: SshFiles, role: Role
    ) -> ServerUnreachable:
        """Connect to `target`; return only if no SSH server lets us begin there."""

        def on_up(at: Target, config: SessionConfig, session: Session) -> None:
            # On many networks only one of the ports is let out.
            self._good_port = at.port
            role.on_up(at, config, session)

        try:
            await run_connection(target, files, replace(role, on_up=on_up))
        except ServerUnreachable as problem:
            return problem
