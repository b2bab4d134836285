"""Several relays of one site in the test's own process, each behind a peer listener that a test can cut off.

The listener does what nginx's does: TLS with the site's one certificate at both ends, and the proof for the relay.
"""

from __future__ import annotations

import asyncio
import copy
import ssl
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path

from fake_robot import HOST, FakeRobot, RobotSession
from relay_server import (
    FAST,
    SESSION_KEY,
    MemoryDatabase,
    RelayServer,
    cell_settings,
    running_relay,
    until,
)
from robotether_server.contract.robots import RobotObject
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.cells.keys import CERTIFICATE, KEY, PROOF_HEADER, PeerKeys
from robotether_server.relay.wiring import Relay
from tcp_service import TcpService
from tls_front import make_pair


def make_peer_keys(folder: Path) -> Path:
    names, usage = "subjectAltName=DNS:robotether-peer", "basicConstraints=critical,CA:FALSE"
    certificate, key = folder / CERTIFICATE, folder / KEY
    make_pair(certificate, key, "robotether-peer", "-addext", names, "-addext", usage)
    return folder


class PeerListener(TcpService):
    """Passes connections of other cells to a relay's peer port; cut, it breaks them, frozen it passes nothing on."""

    def __init__(self, folder: Path, proof: str, relay_port: int = 0) -> None:
        super().__init__()
        self.tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self.tls.load_cert_chain(folder / CERTIFICATE, folder / KEY)
        self.tls.load_verify_locations(folder / CERTIFICATE)
        self.tls.verify_mode = ssl.CERT_REQUIRED
        self._proof = proof
        self.relay_port = relay_port
        self._is_cut = False
        self._flows = asyncio.Event()
        self._flows.set()

    @asynccontextmanager
    async def cut(self) -> AsyncIterator[None]:
        self._is_cut = True
        await self.drop()
        yield
        self._is_cut = False

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Pass nothing on inside the block, as a network does that drops all."""
        self._flows.clear()
        yield
        self._flows.set()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            if not self._is_cut:
                head = await reader.readuntil(b"\r\n")
                to_relay, relay = await asyncio.open_connection(HOST, self.relay_port)
                try:
                    relay.write(head + f"{PROOF_HEADER}: {self._proof}\r\n".encode())
                    async with asyncio.TaskGroup() as group:
                        group.create_task(self._pipe(reader, relay))
                        group.create_task(self._pipe(to_relay, writer))
                finally:
                    relay.transport.abort()
        finally:
            writer.transport.abort()

    async def _pipe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError, ssl.SSLError):
            while data := await reader.read(65536):
                await self._flows.wait()
                writer.write(data)
                await writer.drain()
        writer.transport.abort()


class SiteCell:
    def __init__(
        self, name: str, database: MemoryDatabase, server: RelayServer, listener: PeerListener
    ) -> None:
        self.name = name
        self.database = database
        self.server = server
        self.listener = listener
        self.robots: list[FakeRobot] = []
        self.sessions: list[RobotSession] = []

    @property
    def relay(self) -> Relay:
        return self.server.relay

    def owner(self, robot: RelayRobot) -> str | None:
        peer = self.relay.peers.owner(robot.id)
        return None if peer is None else peer.name

    def shown(self, robot: RelayRobot) -> RobotObject:
        return self.relay.fleet_events.describe(robot)

    async def robot(self, robot: RelayRobot, mode: str = "guarded", epoch: int = 0) -> FakeRobot:
        fake = FakeRobot(robot.id, SESSION_KEY, mode)  # type: ignore[arg-type]  # one of its modes
        fake.epoch = epoch
        self.robots.append(fake)
        await fake.start(self.relay.session_port)
        await until(lambda: self.relay.registry.presence(robot.id).guard_mode != "unknown", "hello")
        return fake

    async def session(self, robot: RelayRobot, epoch: int) -> RobotSession:
        session = RobotSession(robot.id, kind="session", session_key=SESSION_KEY)
        self.sessions.append(session)
        await session.connect(self.relay.session_port)
        await session.wait_configured()
        session.send(type="hello", hostname="x", agent_version="0.2.0", guard="on", epoch=epoch)
        return session


class Site:
    """Cells that share their records, and see each other once they are started."""

    def __init__(self, folder: Path, memory_database: MemoryDatabase) -> None:
        self._folder = folder
        self._memory_database = memory_database
        self._stack = AsyncExitStack()
        self.cells: dict[str, SiteCell] = {}

    async def add(self, name: str, keys: PeerKeys) -> SiteCell:
        """Start a cell, and wait until all cells follow each other."""
        listener = await self._stack.enter_async_context(PeerListener(self._folder, keys.proof))
        # Each with a connection of its own to the same records, which a test takes away.
        database = copy.copy(self._memory_database)
        settings = cell_settings(name, peer_address=f"{HOST}:{listener.port}")
        server = await self._stack.enter_async_context(
            running_relay(database, FAST, cell=settings, peer_keys=keys)
        )
        listener.relay_port = server.relay.peer_port
        self.cells[name] = cell = SiteCell(name, database, server, listener)
        await self.connected()
        return cell

    async def connected(self) -> None:
        cells = self.cells.values()
        others = len(cells) - 1
        await until(lambda: all(each.relay.peers.count() == others for each in cells), "connected")

    async def stop(self) -> None:
        for cell in self.cells.values():
            for robot in cell.robots:
                await robot.stop()
            for session in cell.sessions:
                await session.close()
        await self._stack.aclose()
