"""Connects to each of the site's other cells, and gives `peers` what they report.

One task a cell. A connection that is silent for 3 s is given up; a try follows within a second.
"""

from __future__ import annotations

import asyncio
import logging
import socket

from aiohttp import ClientError, ClientSession, ClientWebSocketResponse, TCPConnector

from robotether_server.problems import ProtocolError, reason_in
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.cells.feed import FLEET_PATH, receive
from robotether_server.relay.cells.keys import SERVER_NAME, PeerKeys
from robotether_server.relay.cells.messages import PeerHello, parse
from robotether_server.relay.cells.peers import Peers
from robotether_server.tasks import end_tasks
from robotether_server.times import delays

log = logging.getLogger(__name__)

CONNECT_WITHIN_S = 3.0
FIRST_RETRY_S = 0.25
MAX_RETRY_S = 1.0


class PeerDialer:
    """The connections to all other cells; without keys or an address of its own it has none."""

    def __init__(self, cells: Cells, peers: Peers, keys: PeerKeys | None) -> None:
        self._cells = cells
        self._peers = peers
        self._keys = keys
        self._tasks: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._client: ClientSession | None = None
        cells.listen(self._on_cells)

    def start(self) -> None:
        """Connect to the cells that are known, and to each that comes."""
        if self._keys is None or not self._cells.is_reachable:
            return
        self._client = ClientSession(
            connector=TCPConnector(limit=0, force_close=True, ssl=self._keys.tls)
        )
        self._on_cells()

    async def stop(self) -> None:
        """Leave all."""
        # First, so that a change of the cells meanwhile begins nothing.
        client, self._client = self._client, None
        tasks, self._tasks = [*self._tasks.values()], {}
        await end_tasks(tasks)
        if client is not None:
            await client.close()

    def _on_cells(self) -> None:
        if self._client is None:
            return
        addresses = {(cell.name, cell.peer_address or "") for cell in self._cells.peers()}
        for peer in self._tasks.keys() - addresses:
            self._tasks.pop(peer).cancel()
        for name, address in addresses - self._tasks.keys():
            self._tasks[name, address] = asyncio.create_task(
                self._follow(self._client, name, address), name=f"cell {name}"
            )

    async def _follow(self, client: ClientSession, name: str, address: str) -> None:
        """Connect again and again, as long as there is such a cell."""
        pauses, problem = delays(FIRST_RETRY_S, MAX_RETRY_S), ""
        while True:
            try:
                await self._connect(client, name, address)
                pauses, why = delays(FIRST_RETRY_S, MAX_RETRY_S), ""
            except ProtocolError as exc:
                why = exc.detail
            except (ClientError, OSError) as exc:
                why = reason_in(exc)
            except Exception:
                log.exception("the connection to cell %s failed", name)
                why = ""
            if why and why != problem:
                log.warning("cannot reach cell %s at %s: %s", name, address, why)
            problem = why
            await asyncio.sleep(next(pauses))

    async def _connect(self, client: ClientSession, name: str, address: str) -> None:
        """Follow the cell at the first of its addresses that answers; return when it no longer does."""
        problem: Exception
        for endpoint in await _resolve(address):
            connection = await self._open(client, endpoint)
            if not isinstance(connection, Exception):
                async with connection:
                    await self._read(connection, name, endpoint)
                return
            problem = connection
        raise problem

    async def _open(
        self, client: ClientSession, endpoint: str
    ) -> ClientWebSocketResponse | Exception:
        try:
            async with asyncio.timeout(CONNECT_WITHIN_S):
                return await client.ws_connect(
                    f"https://{endpoint}{FLEET_PATH}",
                    params={"cell": self._cells.name},
                    server_hostname=SERVER_NAME,
                    autoping=False,
                )
        except (ClientError, OSError) as exc:
            return exc

    async def _read(self, connection: ClientWebSocketResponse, name: str, endpoint: str) -> None:
        text = await receive(connection)
        hello = None if text is None else parse(text)
        if not isinstance(hello, PeerHello) or hello.cell != name:
            who = hello.cell if isinstance(hello, PeerHello) else "no cell"
            raise ProtocolError(f"{who} answers there; check PEER_ADDRESS of each cell")
        peer = self._peers.connected(name, endpoint)
        try:
            while (text := await receive(connection)) is not None:
                if (message := parse(text)) is not None:
                    self._peers.on_message(peer, message)
        finally:
            self._peers.disconnected(peer)


async def _resolve(address: str) -> list[str]:
    """Return the endpoints of host:port, as they are in a URL; nginx gets one of them, and looks no name up."""
    host, _, port = address.rpartition(":")
    loop = asyncio.get_running_loop()
    infos = await loop.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)
    addresses = [(family, str(at[0])) for family, *_, at in infos]
    return [
        f"[{ip}]:{port}" if family == socket.AF_INET6 else f"{ip}:{port}"
        for family, ip in addresses
    ]
