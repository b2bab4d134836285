"""What a relay knows of the cells, from records that a test changes."""

import asyncio
import logging
from dataclasses import replace

import pytest
from fake_robot import WAIT_S
from relay_server import MemoryDatabase, cell_settings
from robotether_server.db.cells import Cell
from robotether_server.problems import RecordExistsError
from robotether_server.relay.cells import cells as relay_cells
from robotether_server.relay.cells.cells import Cells
from robotether_server.tasks import end_tasks

OTHER = Cell("b", "b.example", 443, (2222,), "b.example:8444", "0.1.0", 3, False, True)


@pytest.fixture
def memory_database():
    memory_database = MemoryDatabase()
    memory_database.cells["b"] = OTHER
    return memory_database


@pytest.fixture
def cells(memory_database):
    return Cells(cell_settings("a", "a.example", "a.example:8444"), memory_database, lambda: 2)


async def test_a_robot_that_is_sent_elsewhere_comes_back_if_it_cannot_get_there(
    cells, memory_database
):
    """A third cell would send it on to the one that it cannot reach, and so to and fro."""
    memory_database.cells["c"] = replace(OTHER, name="c", host="c.example")
    await cells.poll()
    found = {tuple(address.host for address in cells.addresses(each, "b")) for each in range(20)}
    assert found == {("b.example", "a.example", "c.example")}


async def test_a_dead_peer_is_still_one_and_one_without_an_address_is_none(cells, memory_database):
    memory_database.cells["b"] = replace(OTHER, is_alive=False)
    memory_database.cells["c"] = replace(OTHER, name="c", peer_address=None)
    await cells.poll()
    assert [peer.name for peer in cells.peers()] == ["b"]
    assert [address.host for address in cells.addresses(7)] == ["a.example", "b.example"]


async def test_other_cells_get_a_while_to_come_back_with_the_database(
    cells, memory_database, monkeypatch
):
    """They could not write their heartbeats either."""
    for alive_s, hosts in ((relay_cells.ALIVE_S, ["a.example", "b.example"]), (0.0, ["a.example"])):
        monkeypatch.setattr(relay_cells, "ALIVE_S", alive_s)
        memory_database.cells["b"] = OTHER
        for is_down in (False, True):
            memory_database.down = is_down
            await cells.poll()
        memory_database.down = False
        memory_database.cells["b"] = replace(OTHER, is_alive=False)
        await cells.poll()
        assert [address.host for address in cells.addresses(7)] == hosts


async def test_disk_and_recorders_are_said_while_they_are_known(
    cells, memory_database, monkeypatch, tmp_path
):
    await cells.poll()
    assert memory_database.cells["a"].disk_free is memory_database.cells["a"].recorders is None
    cells.count_recorders = lambda: 1
    watch = asyncio.create_task(cells.watch_disk(tmp_path))
    try:
        async with asyncio.timeout(WAIT_S):
            while memory_database.cells["a"].disk_free is None:
                await asyncio.sleep(0.01)
                await cells.poll()
        assert 0 < memory_database.cells["a"].disk_free < 1
        assert memory_database.cells["a"].recorders == 1
        # A disk that hangs says nothing more.
        monkeypatch.setattr(relay_cells, "DISK_CURRENT_S", -1)
        await cells.poll()
        assert memory_database.cells["a"].disk_free is None
    finally:
        await end_tasks([watch])


class Taken(MemoryDatabase):
    async def heartbeat(self, *_):
        raise RecordExistsError("cannot take part as cell a: another relay has this name")


async def test_a_name_that_another_relay_has_is_reported_once(caplog):
    cells = Cells(cell_settings("a"), Taken(), lambda: 0)
    for _ in range(3):
        await cells.poll()
    errors = [record.message for record in caplog.records if record.levelno == logging.ERROR]
    assert errors == ["cannot take part as cell a: another relay has this name"]


async def test_surplus_is_against_the_emptiest_cell(memory_database, monkeypatch):
    """An old count is none: the other cell may have got robots since."""
    memory_database.cells["b"] = replace(OTHER, region="us")
    memory_database.cells["c"] = replace(OTHER, name="c", robots=1)
    memory_database.cells["d"] = replace(OTHER, name="d", robots=0, is_alive=False)
    settings = cell_settings("a", "a.example", region="eu")
    cells = Cells(settings, memory_database, lambda: 9, region_of={7: "eu", 8: "us"}.get)
    assert cells.surplus() == (0, "a")
    await cells.poll()
    assert cells.surplus() == (8, "c")
    assert {robot_id: cells.surplus(robot_id) for robot_id in (7, 8, 9)} == {
        7: (0, "a"),
        8: (6, "b"),
        9: (8, "c"),
    }
    with monkeypatch.context() as later:
        later.setattr(relay_cells, "CURRENT_S", 0.0)
        assert cells.surplus() == (0, "a")
    memory_database.down = True
    await cells.poll()
    assert cells.surplus() == (0, "a")


@pytest.mark.parametrize(
    ("own", "other", "ahead_s"),
    [(0.1, 1.7, 1.6), (1.7, 0.1, 0.0), (0.1, 0.4, 0.0), (None, 1.7, 0.0), (0.1, None, 0.0)],
)
async def test_a_clock_that_is_ahead_elsewhere_is_known(
    cells, memory_database, own, other, ahead_s
):
    memory_database.cells["b"] = replace(OTHER, clock_ahead_s=other)
    await cells.poll()
    cells._cells = {**cells._cells, "a": replace(cells._cells["a"], clock_ahead_s=own)}
    assert cells.clocks_ahead_s() == pytest.approx(ahead_s)
