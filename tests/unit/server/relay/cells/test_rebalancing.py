"""A cell that has more robots than another, with robots on real sockets."""

from dataclasses import replace

import pytest
import pytest_asyncio
from relay_clients import configured, ended
from relay_server import FAST, cell_settings, running_relay, until
from robotether_server.db.cells import Cell
from robotether_server.relay.cells.rebalancing import BalanceRules

EMPTY = Cell("b", "b.example", 443, (2222,), None, "0.1.0", 0, False, True)
RULES = BalanceRules(robots=0, share=0, robots_per_s=50, look_every_s=0.05, stays_s=0.3)


@pytest.fixture
def memory_database(memory_database):
    memory_database.cells["b"] = EMPTY
    for robot_id, name in {8: "sim2", 9: "sim3"}.items():
        robot = memory_database.add_robot(robot_id, name, u1="drive")
        memory_database.robots[robot_id] = replace(robot, shell_port=robot.ros_port + 1)
    return memory_database


@pytest.fixture
def rules():
    return RULES


@pytest_asyncio.fixture
async def relay(memory_database, rules):
    cell = cell_settings("a", "a.example")
    async with running_relay(memory_database, replace(FAST, balance=rules), cell) as server:
        yield server


@pytest_asyncio.fixture
async def online(connect):
    async def open_session(robot_id=8, kind="session"):
        return await configured(await connect(kind, robot_id=robot_id))

    return open_session


async def stay(*sessions):
    seen = [session.pings for session in sessions]
    await until(
        lambda: all(item.pings > 1 + pings for item, pings in zip(sessions, seen, strict=True)),
        "time passes",
    )
    assert [session.bye for session in sessions] == [None] * len(sessions)


def listed_cells(session):
    return [(cell["host"], cell["rank"]) for cell in session.configs[-1]["cells"]]


@pytest.mark.parametrize("rules", [replace(RULES, robots=1)])
async def test_robots_go_until_cells_are_about_even(sim1, online):
    sessions = [await online(each) for each in (sim1.id, 8, 9)]
    await until(lambda: sum(item.bye is not None for item in sessions) == 2, "two have gone")
    gone = [item for item in sessions if item.bye is not None]
    assert [await ended(item) for item in gone] == ["rebalanced", "rebalanced"]
    for session in gone:
        assert [host for host, _ in listed_cells(session)] == ["b.example", "a.example"]
    await stay(*(item for item in sessions if item not in gone))


async def test_a_robot_that_somebody_may_use_stays(relay, start_robot, online, ros):
    watched = await start_robot(relay)
    async with ros():
        session, shell, idle = await online(), await online(kind="shell"), await online(9)
        assert await ended(idle) == "rebalanced"
        await stay(watched.session, session)
        assert shell.bye is None


async def test_a_robot_that_is_stopped_stays(relay, memory_database, online):
    """Whoever stops or releases it waits for its guard, which says nothing on the way."""
    stops = relay.relay.control.stops
    stops.stop(memory_database.robots[8], "ben")
    session = await online()
    await stay(session)
    await stops.release(memory_database.robots[8], "ben")
    assert await ended(session) == "rebalanced"


async def test_a_robot_that_comes_back_at_once_is_left_alone(online):
    """It cannot reach the other cell; the next time may be better."""
    assert await ended(await online()) == "rebalanced"
    again = await online()
    await stay(again)
    await again.close()
    assert await ended(await online()) == "rebalanced"


# Where nothing but a robot's question makes it go.
even = pytest.mark.parametrize("rules", [replace(RULES, robots=100)])


def ask_for_b(session):
    session.send(type="nearer", host="b.example", ports=[2222])


@even
async def test_robot_goes_to_a_nearer_cell_when_it_asks(online):
    """It goes there however far that looks to it later: the list names that cell alone as the best."""
    session = await online()
    await stay(session)
    ask_for_b(session)
    assert await ended(session) == "rebalanced"
    assert listed_cells(session) == [("b.example", 0), ("a.example", 1)]


@even
async def test_robot_stays_where_a_nearer_cell_does_not_take_it(relay, memory_database, online):
    """One with so many more robots would soon send it back."""
    session = await online()
    for change in (
        {"robots": 60},
        {"draining": True},
        {"is_alive": False},
        {"ssh_ports": (443,)},
        {"peer_address": "b.example:8444"},
    ):
        memory_database.cells["b"] = replace(EMPTY, **change)
        await relay.relay.cells.poll()
        ask_for_b(session)
        await stay(session)
