"""A cell that has more robots than another, with robots on real sockets."""

from dataclasses import replace

import pytest
from fake_robot import FakeRobot
from relay_clients import ended, session_of
from relay_server import FAST, SESSION_KEY, cell_settings, running_relay, until
from robotether_server.db.cells import Cell
from robotether_server.relay.cells.rebalancing import BalanceRules

EMPTY = Cell("b", "b.example", 443, (2222,), None, "0.1.0", 0, False, True)
RULES = BalanceRules(robots=0, share=0, robots_per_s=50, look_every_s=0.05, stays_s=0.3)
CELL = cell_settings("a", "a.example")


@pytest.fixture
def memory_database(memory_database):
    memory_database.cells["b"] = EMPTY
    for robot_id, name in {8: "sim2", 9: "sim3"}.items():
        memory_database.add_robot(robot_id, name, u1="drive")
    return memory_database


def timing(**changes):
    return replace(FAST, balance=replace(RULES, **changes))


async def stay(*sessions):
    seen = [session.pings for session in sessions]
    await until(
        lambda: all(item.pings > 1 + pings for item, pings in zip(sessions, seen, strict=True)),
        "time passes",
    )
    assert [session.bye for session in sessions] == [None] * len(sessions)


async def test_robots_go_until_cells_are_about_even(memory_database, sim1):
    async with running_relay(memory_database, timing(robots=1), CELL) as relay:
        sessions = [await session_of(relay, each) for each in (sim1.id, 8, 9)]
        await until(lambda: sum(item.bye is not None for item in sessions) == 2, "two have gone")
        gone = [item for item in sessions if item.bye is not None]
        assert [await ended(item) for item in gone] == ["rebalanced", "rebalanced"]
        for session in gone:
            assert [cell["host"] for cell in session.configs[-1]["cells"]] == [
                "b.example",
                "a.example",
            ]
        await stay(*(item for item in sessions if item not in gone))
        for session in sessions:
            await session.close()


async def test_a_robot_that_somebody_may_use_stays(memory_database, sim1, http):
    """Whoever is connected to it would lose the connection; so might who works in its shell."""
    with_shell = memory_database.robots[8]
    memory_database.robots[8] = replace(with_shell, shell_port=with_shell.ros_port + 1)
    async with running_relay(memory_database, timing(), CELL) as relay:
        watched = FakeRobot(sim1.id, SESSION_KEY)
        await watched.start(relay.relay.session_port)
        async with http.ws_connect(relay.ros_url(sim1)):
            session, shell, idle = [
                await session_of(relay, robot_id, kind)
                for robot_id, kind in ((8, "session"), (8, "shell"), (9, "session"))
            ]
            assert await ended(idle) == "rebalanced"
            await stay(watched.session, session)
            assert shell.bye is None
        for each in (session, shell, idle):
            await each.close()
        await watched.stop()


async def test_a_robot_that_is_stopped_stays(memory_database):
    """Whoever stops or releases it waits for its guard, which says nothing on the way."""
    async with running_relay(memory_database, timing(), CELL) as relay:
        stops = relay.relay.control.stops
        stops.stop(memory_database.robots[8], "ben")
        session = await session_of(relay, 8)
        await stay(session)
        await stops.release(memory_database.robots[8], "ben")
        assert await ended(session) == "rebalanced"
        await session.close()


async def test_a_cell_that_does_not_follow_this_one_gets_no_robots(memory_database):
    """Here they would count as offline."""
    memory_database.cells["b"] = replace(EMPTY, peer_address="b.example:8444")
    async with running_relay(memory_database, timing(), CELL) as relay:
        session = await session_of(relay, 8)
        await stay(session)
        await session.close()


async def test_a_robot_that_comes_back_at_once_is_left_alone(memory_database):
    """It cannot reach the other cell; the next time may be better."""
    async with running_relay(memory_database, timing(), CELL) as relay:
        session = await session_of(relay, 8)
        assert await ended(session) == "rebalanced"
        again = await session_of(relay, 8)
        await stay(again)
        await again.close()
        later = await session_of(relay, 8)
        assert await ended(later) == "rebalanced"
        for each in (session, later):
            await each.close()


def ask_for_b(session):
    session.send(type="nearer", host="b.example", ports=[2222])


async def test_robot_goes_to_a_nearer_cell_when_it_asks(memory_database):
    """It goes there however far that looks to it later: the list names that cell alone as the best."""
    async with running_relay(memory_database, timing(robots=100), CELL) as relay:
        session = await session_of(relay, 8)
        await stay(session)
        ask_for_b(session)
        assert await ended(session) == "rebalanced"
        assert [(cell["host"], cell["rank"]) for cell in session.configs[-1]["cells"]] == [
            ("b.example", 0),
            ("a.example", 1),
        ]
        await session.close()


@pytest.mark.parametrize(
    "change",
    [
        {"robots": 60},
        {"draining": True},
        {"is_alive": False},
        {"ssh_ports": (443,)},
        {"peer_address": "b.example:8444"},
    ],
)
async def test_robot_stays_where_a_nearer_cell_does_not_take_it(memory_database, change):
    """One with so many more robots would soon send it back."""
    memory_database.cells["b"] = replace(EMPTY, **change)
    async with running_relay(memory_database, timing(robots=100), CELL) as relay:
        session = await session_of(relay, 8)
        ask_for_b(session)
        await stay(session)
        await session.close()


async def test_robot_that_is_stopped_goes_to_no_nearer_cell(memory_database):
    """Nor one that somebody uses, by the same rule."""
    async with running_relay(memory_database, timing(robots=100), CELL) as relay:
        relay.relay.control.stops.stop(memory_database.robots[8], "ben")
        session = await session_of(relay, 8)
        ask_for_b(session)
        await stay(session)
        await session.close()
