"""A cell that is taken out of service, with robots on real sockets."""

import asyncio
from dataclasses import replace

import pytest
from fake_robot import FakeRobot
from relay_clients import closing, ended, session_of
from relay_server import FAST, SESSION_KEY, cell_settings, running_relay, until
from robotether_server.db.cells import Cell
from robotether_server.relay.cells.drain import DrainRules

QUICK = DrainRules(robots_per_s=50, drives_last_s=60, stays_s=0)
OTHER = Cell("b", "b.example", 443, (2222,), None, "0.1.0", 3, False, True)
DRAINED = replace(OTHER, name="a", host="a.example", draining=True)
ROBOTS = {8: "sim2", 9: "sim3"}
# What is used stays so for 10 s; nothing here waits for that.
CELL = cell_settings("a", "a.example")


@pytest.fixture
def memory_database(memory_database):
    memory_database.cells["b"] = OTHER
    for robot_id, name in ROBOTS.items():
        memory_database.add_robot(robot_id, name, u1="drive", u2="observe")
    return memory_database


def timing(**changes):
    return replace(FAST, drain=replace(QUICK, **changes))


def set_draining(memory_database, *, on):
    memory_database.cells["a"] = replace(memory_database.cells["a"], draining=on)


async def test_robots_are_told_where_to_go_and_leave(memory_database, sim1):
    """Each gets a list with this cell last before its bye; its other connections end with it."""
    async with running_relay(memory_database, timing(), CELL) as relay:
        robot = FakeRobot(sim1.id, SESSION_KEY)
        await robot.start(relay.relay.session_port)
        assert [cell["host"] for cell in robot.session.configs[-1]["cells"]] == [
            "a.example",
            "b.example",
        ]
        set_draining(memory_database, on=True)
        assert await ended(robot.session) == await ended(robot.media) == "cell_draining"
        assert [cell["host"] for cell in robot.session.configs[-1]["cells"]] == [
            "b.example",
            "a.example",
        ]
        await until(lambda: not relay.relay.registry.online_count(), "nobody is left")
        await robot.stop()


async def test_unused_robots_leave_first_and_the_driven_last(memory_database, sim1, http):
    """A driver drives on, who watches loses the link, and a robot that nobody uses goes before both."""
    left = []
    async with running_relay(memory_database, timing(), CELL) as relay:
        robot, watched = FakeRobot(sim1.id, SESSION_KEY), FakeRobot(8, SESSION_KEY)
        await robot.start(relay.relay.session_port)
        await watched.start(relay.relay.session_port)
        idle = await session_of(relay, 9)
        relay.relay.registry.listen(
            lambda change: left.append(change.robot_id) if change.what == "disconnected" else None
        )
        driver = await http.ws_connect(relay.ros_url(sim1))
        observer = await http.ws_connect(relay.ros_url(memory_database.robots[8], "observe"))
        await until(lambda: robot.clients and watched.clients, "both are connected")
        set_draining(memory_database, on=True)
        assert (await closing(observer))[0] == 4505
        await until(lambda: len(left) == 2, "two have left")
        assert left == [9, 8]
        assert relay.relay.registry.presence(sim1.id).online
        await driver.close()
        assert await ended(robot.session) == "cell_draining"
        for each in (robot, watched):
            await each.stop()
        await idle.close()


async def test_one_begins_to_drive_only_while_no_other_cell_takes_robots(
    memory_database, sim1, http
):
    """A robot that has yet to leave would take the drive along; if the others died, it stays."""
    memory_database.cells |= {"a": DRAINED, "b": replace(OTHER, is_alive=False)}
    async with running_relay(memory_database, timing(stays_s=60), CELL) as relay:
        robot = FakeRobot(sim1.id, SESSION_KEY)
        await robot.start(relay.relay.session_port)
        async with http.ws_connect(relay.ros_url(sim1)):
            await until(lambda: relay.relay.control.driver(sim1.id), "somebody drives")
        memory_database.cells["b"] = OTHER
        await until(relay.relay.cells.robots_leave, "b is back")
        reason = "cannot let you drive sim1: its server goes out of service; try again shortly"
        assert await closing(await http.ws_connect(relay.ros_url(sim1))) == (4510, reason)
        async with http.ws_connect(relay.ros_url(sim1, "observe")):
            await until(lambda: robot.clients, "one may still observe")
        await robot.stop()


async def test_a_drive_that_began_while_no_other_took_robots_has_its_time(
    memory_database, sim1, http
):
    memory_database.cells |= {"a": DRAINED, "b": replace(OTHER, is_alive=False)}
    async with running_relay(memory_database, timing(drives_last_s=0.6), CELL) as relay:
        robot = FakeRobot(sim1.id, SESSION_KEY)
        await robot.start(relay.relay.session_port)
        driver = await http.ws_connect(relay.ros_url(sim1))
        await until(lambda: robot.clients, "the driver is connected")
        await asyncio.sleep(0.7)
        memory_database.cells["b"] = OTHER
        await until(relay.relay.cells.robots_leave, "b is back")
        began = asyncio.get_running_loop().time()
        assert (await closing(driver))[0] == 4505
        assert asyncio.get_running_loop().time() - began > 0.3
        assert await ended(robot.session) == "cell_draining"
        await robot.stop()


@pytest.mark.parametrize("change", [{"stays_s": 60}, {}])
async def test_a_robot_that_could_go_nowhere_stays(memory_database, change):
    """It has come to a drained cell, so that it found no other; or there is none."""
    memory_database.cells["a"] = DRAINED
    if not change:
        memory_database.cells["b"] = replace(OTHER, is_alive=False)
    async with running_relay(memory_database, timing(**change), CELL) as relay:
        first, second = await session_of(relay, 8), await session_of(relay, 9)
        await until(lambda: first.pings > 3, "time passes")
        assert (first.bye, second.bye) == (None, None)
        for each in (first, second):
            await each.close()
