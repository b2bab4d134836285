"""How far the server's machines are, and which of them a robot tries first and asks for."""

import asyncio
from contextlib import AsyncExitStack

import pytest
from fake_cloud import eventually
from fake_proxy import FakeProxy
from robotether_agent.fields import ListedCell
from robotether_agent.net.http_proxy import proxy_of
from robotether_agent.net.server_dialer import ServerDialer
from robotether_agent.tunnel import distances as module
from robotether_agent.tunnel.distances import Distances
from tcp_service import TcpService

HOST = "127.0.0.1"
A, B, C = (ListedCell(f"{name}.example", (2222,)) for name in "abc")


class Listener(TcpService):
    async def _talk(self, reader, _):
        await reader.read()


class SlowProxy(FakeProxy):
    """Emulates a distance: each way to a port takes its own time."""

    def __init__(self, delays_s):
        super().__init__()
        self._delays_s = delays_s

    async def _join(self, host, port, reader, writer):
        await asyncio.sleep(self._delays_s[port])
        writer.write(b"HTTP/1.1 200 Connection established\r\n\r\n")


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    for name in ("FIRST_AFTER_S", "CHECK_EVERY_S"):
        monkeypatch.setattr(module, name, (0.01, 0.02))


@pytest.fixture
async def cells():
    async with AsyncExitStack() as ends:
        listeners = [await ends.enter_async_context(Listener()) for _ in range(3)]
        yield [ListedCell(HOST, (listener.port,)) for listener in listeners]


def known(**rtts_ms):
    distances = Distances(ServerDialer())
    distances._rtts_s = {
        ListedCell(f"{name}.example", (2222,)): rtt_ms / 1000 for name, rtt_ms in rtts_ms.items()
    }
    return distances


@pytest.mark.parametrize(("begin", "nearest"), [(0, 0), (0, 2), (2, 1)])
async def test_robot_is_at_its_nearest_cell_within_one_move(cells, spawn, begin, nearest):
    delays_s = {cell.ports[0]: 0.01 if at == nearest else 0.2 for at, cell in enumerate(cells)}
    places = [cells[begin]]
    async with SlowProxy(delays_s) as proxy:
        distances = Distances(ServerDialer(proxy_of(proxy.url)))
        asking = spawn(distances.keep_asking(lambda: (places[-1], cells), places.append))
        await eventually(
            lambda: places[-1] == cells[nearest] and len(distances._rtts_s) == 3,
            lambda: str(places),
        )
        await asyncio.sleep(0.1)
        asking.cancel()
    assert places == [cells[begin]] + ([] if begin == nearest else [cells[nearest]])
    assert distances.by_distance(cells)[0] == cells[nearest]


def test_server_decides_among_cells_about_equally_near():
    """So a fleet beside three machines spreads over all of them."""
    distances = known(a=3, b=1, c=90)
    assert distances.by_distance([A, C, B]) == [A, B, C]
    assert [distances.nearer(here, [A, B, C]) for here in (A, B, C)] == [None, None, B]
    assert known(c=90).by_distance([C, B, A]) == [C, B, A]
    assert known(c=90).nearer(A, [A, B, C]) is None


def test_rank_comes_before_distance():
    """A region's cells, and one to which the server sends the robot, win; a drained one is never chosen."""
    distances = known(a=200, b=1, c=100)
    cells = [A, C, ListedCell(B.host, B.ports, rank=1)]
    assert distances.by_distance(cells) == [C, A, B]
    assert distances.nearer(C, cells) is None
    cells.remove(C)
    assert distances.nearer(A, cells) is None
    assert known(a=1, b=200).nearer(B, cells) == A
