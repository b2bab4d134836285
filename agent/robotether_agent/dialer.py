"""Opens one connection of a kind to whichever of the server's SSH ports answers.

Used by the agent for all its connections; the port that worked last is tried first by each of them.
"""

from __future__ import annotations

from dataclasses import replace

from robotether_agent.connection import Role, run_connection
from robotether_agent.enroller import Enroller
from robotether_agent.enrolment import Enrolment
from robotether_agent.keys import KeyPair
from robotether_agent.problems import ServerUnreachable
from robotether_agent.session import Config, Session
from robotether_agent.settings import Settings
from robotether_agent.ssh_command import SshFiles, Target


class Dialer:
    """Where the server is, and which of its ports is let through on this network."""

    def __init__(self, settings: Settings, enroller: Enroller) -> None:
        self._settings = settings
        self._enroller = enroller
        self._good_port: int | None = None

    async def connect(self, enrolment: Enrolment, key: KeyPair, role: Role) -> None:
        """Try the server's ports in order, until one answers; raise what ended the connection."""
        coming = await self._enroller.next_key()
        # The server may know either of them when a change of keys was cut short.
        keys = (key.path,) if coming is None else (key.path, coming.path)
        control = self._settings.run_dir / f"{role.kind}.ctl"
        files = SshFiles(keys, self._enroller.known_hosts, control)
        unreachable = [
            await self._unless_unreachable(target, files, role)
            for target in self.targets(enrolment)
        ]
        raise ServerUnreachable(
            "; ".join(problem.message for problem in unreachable), advice=unreachable[0].advice
        )

    def targets(self, enrolment: Enrolment) -> list[Target]:
        """Return the server's SSH addresses in the order in which they are tried."""
        settings, ssh = self._settings, enrolment.ssh
        host = settings.ssh_host or ssh.host or settings.server_host
        ports = settings.ssh_ports or ssh.ports
        in_order = sorted(ports, key=lambda port: port != self._good_port)
        return [Target(host, port, ssh.user) for port in in_order]

    async def _unless_unreachable(
        self, target: Target, files: SshFiles, role: Role
    ) -> ServerUnreachable:
        """Connect to `target`; return only if nothing answers there."""

        def on_up(at: Target, config: Config, session: Session) -> None:
            # On many networks only one of the ports is let out.
            self._good_port = at.port
            role.on_up(at, config, session)

        try:
            await run_connection(target, files, replace(role, on_up=on_up))
        except ServerUnreachable as problem:
            return problem
