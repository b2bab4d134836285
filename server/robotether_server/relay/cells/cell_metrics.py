"""Reads the numbers of this cell for Prometheus, or has another cell send its own.

`app` answers with them on the inside port, and other cells with this one's. So a Prometheus that reaches one cell has
the numbers of all.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from aiohttp import ClientError, web
from prometheus_client import CONTENT_TYPE_LATEST

from robotether_server.problems import HttpError, reason_in
from robotether_server.relay.cells.cell_client import CellClient
from robotether_server.relay.cells.peers import Peers

PATH = "/cell/v1/metrics"


@dataclass(frozen=True)
class CellMetrics:
    """The numbers of all cells; `name` is this one's, `parts` writes its own. Without `cells` there are no others."""

    name: str
    parts: Callable[[], Iterator[bytes]]
    peers: Peers
    cells: CellClient | None

    async def show(self, request: web.Request) -> web.Response:
        """Answer Prometheus with the numbers of the cell that it names, or of this one."""
        return _answer(await self.read(request.query.get("cell")))

    async def show_own(self, _request: web.Request) -> web.Response:
        """Answer another cell with the numbers of this one."""
        return _answer(await self._own())

    async def read(self, cell: str | None = None) -> bytes:
        """Return the numbers of a cell, of this one if it is None, in Prometheus' text format; raise HttpError."""
        if cell is None or cell == self.name:
            return await self._own()
        peer = self.peers.find(cell)
        if peer is None or self.cells is None:
            raise HttpError(
                404, f"cannot read the metrics of cell {cell[:63]}: it is not connected"
            )
        try:
            return await self.cells.read(peer, PATH)
        except (ClientError, OSError) as exc:
            why = reason_in(exc)
            raise HttpError(503, f"cannot read the metrics of cell {cell}: {why}") from exc

    async def _own(self) -> bytes:
        parts = []
        for part in self.parts():
            parts.append(part)
            # All that is live has its turn.
            await asyncio.sleep(0)
        return b"".join(parts)


def _answer(body: bytes) -> web.Response:
    return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE_LATEST})
