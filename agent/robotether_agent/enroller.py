"""Makes sure that this robot is enrolled: its key, its MAC, the join, the pinned host keys.

Used by the agent before each connection. An enrolled robot connects without asking, so that it comes up
fast and while the web is down; the server is asked again only when a connection gave a reason to.
"""

from __future__ import annotations

import logging
import socket
from dataclasses import replace

from robotether_agent import __version__
from robotether_agent.enrolment import Enrolment, EnrolmentStore
from robotether_agent.files import ensure_directory
from robotether_agent.identity import find_mac
from robotether_agent.join import Joined, JoinRequest, join
from robotether_agent.keys import KeyPair, ensure_key
from robotether_agent.problems import (
    AnswerInvalid,
    JoinRefused,
    ServerUnreachable,
    SettingsInvalid,
    StateUnusable,
    TlsUntrusted,
)
from robotether_agent.settings import Settings

# Tokens expire, and a token file may be gone after the first join: an enrolled robot's key needs none.
TOKEN_USELESS = frozenset({"settings_invalid", "token_invalid", "grant_missing"})
# Faults of the web, or of this robot's own files: what was pinned is enough for the tunnel.
HARMLESS_ONCE_ENROLLED = (
    ServerUnreachable,
    TlsUntrusted,
    AnswerInvalid,
    SettingsInvalid,
    StateUnusable,
)

log = logging.getLogger(__name__)


class Enroller:
    """The way from a fresh robot to an enrolment."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._store = EnrolmentStore(settings.state_dir)
        self._doubted = False
        self.known_hosts = self._store.known_hosts

    async def key(self) -> KeyPair:
        """Return the robot's key, made now if there is none."""
        ensure_directory(self._settings.state_dir, "state_dir", 0o700)
        return await ensure_key(self._settings.state_dir)

    async def enrolment(self, key: KeyPair) -> Enrolment:
        """Return what is known, or what the server answers to a join."""
        known = self._store.load(self._settings.server)
        if known is not None and not self._doubted:
            return known
        try:
            return await self._join(key, known)
        except HARMLESS_ONCE_ENROLLED as problem:
            if known is None:
                raise
            log.warning("%s", problem)
            return known

    async def _join(self, key: KeyPair, known: Enrolment | None) -> Enrolment:
        """Ask the server and keep its answer; a host key that is not the pinned one is raised."""
        settings = self._settings
        mac = settings.mac or (known.mac if known else None)
        if mac is None:
            mac = find_mac(settings.interface, allow_local=settings.allow_local_mac)
        answer = await self._ask(mac, key, is_enrolled=known is not None)
        if self._store.is_of_other_server(settings.server):
            log.warning(
                "the settings name another server now, %s: pinning its host keys", settings.server
            )
        enrolment = Enrolment(settings.server, answer.robot, mac, answer.ssh)
        self._store.keep(enrolment, answer.host_keys)
        self._doubted = False
        if enrolment != known:
            log.info("%s knows this robot as %s (MAC %s)", settings.server, answer.robot, mac)
        return enrolment

    async def _ask(self, mac: str, key: KeyPair, *, is_enrolled: bool) -> Joined:
        """Join with the token, and when only that is in the way of an enrolled robot, without it."""
        request = JoinRequest(
            mac=mac,
            public_key=key.public,
            hostname=socket.gethostname(),
            agent_version=__version__,
        )
        try:
            token = self._settings.join_token()
            return await join(self._settings, replace(request, token=token))
        except (SettingsInvalid, JoinRefused) as problem:
            if not is_enrolled or problem.code not in TOKEN_USELESS:
                raise
            log.warning("%s; joining without the token", problem)
        return await join(self._settings, request)

    def doubt(self) -> None:
        """Ask the server before the next connection: its address or ports may have changed."""
        self._doubted = True
