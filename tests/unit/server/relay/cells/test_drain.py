"""A cell that is taken out of service, with robots on real sockets."""

import asyncio
from dataclasses import replace

import pytest
import pytest_asyncio
from relay_clients import closing, configured, ended
from relay_server import FAST, cell_settings, running_relay, until
from robotether_server.db.cells import Cell
from robotether_server.relay.cells.drain import DrainRules

QUICK = DrainRules(robots_per_s=50, drives_last_s=60, stays_s=0)
OTHER = Cell("b", "b.example", 443, (2222,), None, "0.1.0", 3, False, True)
DRAINED = replace(OTHER, name="a", host="a.example", draining=True)
ALONE = {"a": DRAINED, "b": replace(OTHER, is_alive=False)}


@pytest.fixture
def cells():
    return {"b": OTHER}


@pytest.fixture
def memory_database(memory_database, cells):
    memory_database.cells |= cells
    for robot_id, name in {8: "sim2", 9: "sim3"}.items():
        memory_database.add_robot(robot_id, name, u1="drive", u2="observe")
    return memory_database


@pytest.fixture
def rules():
    return QUICK


@pytest_asyncio.fixture
async def relay(memory_database, rules):
    cell = cell_settings("a", "a.example")
    async with running_relay(memory_database, replace(FAST, drain=rules), cell) as server:
        yield server


def drain(memory_database):
    memory_database.cells["a"] = replace(memory_database.cells["a"], draining=True)


async def test_robots_are_told_where_to_go_and_leave(relay, memory_database, start_robot):
    robot = await start_robot(relay)
    drain(memory_database)
    assert await ended(robot.session) == await ended(robot.media) == "cell_draining"
    lists = [[cell["host"] for cell in config["cells"]] for config in robot.session.configs]
    assert (lists[0], lists[-1]) == (["a.example", "b.example"], ["b.example", "a.example"])
    await until(lambda: not relay.relay.registry.online_count(), "nobody is left")


async def test_unused_robots_leave_first_and_the_driven_last(
    *, relay, memory_database, sim1, http, start_robot, connect, ros
):
    left = []
    robot, watched = await start_robot(relay), await start_robot(relay, robot_id=8)
    await configured(await connect(robot_id=9))
    relay.relay.registry.listen(
        lambda change: left.append(change.robot_id) if change.what == "disconnected" else None
    )
    driver = await ros()
    observer = await http.ws_connect(relay.ros_url(memory_database.robots[8], "observe"))
    await until(lambda: robot.clients and watched.clients, "both are connected")
    drain(memory_database)
    assert (await closing(observer))[0] == 4505
    await until(lambda: len(left) == 2, "two have left")
    assert left == [9, 8]
    assert relay.relay.registry.presence(sim1.id).online
    await driver.close()
    assert await ended(robot.session) == "cell_draining"


@pytest.mark.parametrize("cells", [ALONE])
@pytest.mark.parametrize("rules", [replace(QUICK, stays_s=60)])
async def test_one_begins_to_drive_only_while_no_other_cell_takes_robots(
    relay, memory_database, sim1, start_robot, ros
):
    """A robot that has yet to leave would take the drive along; if the others died, it stays."""
    robot = await start_robot(relay)
    async with ros():
        await until(lambda: relay.relay.control.driver(sim1.id), "somebody drives")
    memory_database.cells["b"] = OTHER
    await until(relay.relay.cells.robots_leave, "b is back")
    reason = "cannot let you drive sim1: its server goes out of service; try again shortly"
    assert await closing(await ros()) == (4510, reason)
    async with ros("observe"):
        await until(lambda: robot.clients, "one may still observe")


@pytest.mark.parametrize("cells", [ALONE])
@pytest.mark.parametrize("rules", [replace(QUICK, drives_last_s=0.6)])
async def test_a_drive_that_began_while_no_other_took_robots_has_its_time(
    relay, memory_database, start_robot, ros
):
    robot = await start_robot(relay)
    driver = await ros()
    await until(lambda: robot.clients, "the driver is connected")
    await asyncio.sleep(0.7)
    began = asyncio.get_running_loop().time()
    memory_database.cells["b"] = OTHER
    await until(relay.relay.cells.robots_leave, "b is back")
    assert (await closing(driver))[0] == 4505
    assert asyncio.get_running_loop().time() - began > 0.3
    assert await ended(robot.session) == "cell_draining"


@pytest.mark.parametrize(
    ("cells", "rules"), [({"a": DRAINED, "b": OTHER}, replace(QUICK, stays_s=60)), (ALONE, QUICK)]
)
async def test_a_robot_that_could_go_nowhere_stays(connect, cells, rules):
    """It has come to a drained cell, so that it found no other; or there is none."""
    sessions = [await configured(await connect(robot_id=robot_id)) for robot_id in (8, 9)]
    await until(lambda: sessions[0].pings > 3, "time passes")
    assert [session.bye for session in sessions] == [None, None]
