"""What cells know of each other's robots and stops, through whole relays and real sockets."""

import pytest
from relay_clients import ended
from relay_server import until
from robotether_server.db.control import Stop
from robotether_server.times import utc_now


async def test_a_robot_of_another_cell_is_shown_as_that_cell_sees_it(cell_a, cell_b, sim1):
    robot = await cell_b.robot(sim1)
    await until(lambda: cell_a.shown(sim1).ros == "ok", "a shows its health")
    await until(lambda: cell_a.shown(sim1) == cell_b.shown(sim1), "and all else")
    assert cell_a.shown(sim1).address == "198.51.100.7"
    assert cell_a.owner(sim1) == "b"
    assert cell_b.owner(sim1) is None
    await robot.stop()
    await until(lambda: not cell_a.shown(sim1).online, "a shows it offline")
    assert cell_a.shown(sim1).since is not None
    assert cell_a.owner(sim1) is None


async def test_an_older_session_ends_when_a_newer_begins_at_another_cell(cell_a, cell_b, sim1):
    older = await cell_a.session(sim1, 1000)
    await until(lambda: cell_b.owner(sim1) == "a", "b knows of it")
    await cell_b.session(sim1, 1001)
    assert await ended(older) == "superseded"
    await until(lambda: cell_a.owner(sim1) == "b", "it belongs to b")
    await until(lambda: cell_b.owner(sim1) is None, "as b knows")


async def test_a_session_that_comes_late_ends_itself(cell_a, cell_b, sim1):
    newer = await cell_b.session(sim1, 1001)
    await until(lambda: cell_a.relay.peers.robot_count() == 1, "a knows of it")
    await until(lambda: cell_a.owner(sim1) == "b", "a knows of it")
    older = await cell_a.session(sim1, 1000)
    assert await ended(older) == "superseded"
    assert not newer.closed.is_set()
    assert cell_a.owner(sim1) == "b"


@pytest.mark.parametrize("how", ["cut", "frozen"])
async def test_robots_of_a_cell_that_is_gone_are_offline(cell_a, cell_b, sim1, how):
    cell_b.relay.control.stops.stop(sim1, "ben")
    await cell_b.robot(sim1)
    await until(lambda: cell_a.owner(sim1) == "b", "a knows of it")
    if how == "cut":
        async with cell_b.listener.cut():
            await until(lambda: cell_a.owner(sim1) is None, "b is gone")
            assert not cell_a.shown(sim1).online
            assert cell_a.relay.control.stops.of(sim1.id).by == "ben"
    else:
        with cell_b.listener.frozen():
            await until(lambda: cell_a.owner(sim1) is None, "b is gone")
    await until(lambda: cell_a.owner(sim1) == "b", "b is back")


async def test_a_robot_that_was_stopped_offline_is_stopped_wherever_it_connects(
    cell_a, cell_b, sim1
):
    cell_a.database.down = cell_b.database.down = True
    cell_a.relay.control.stops.stop(sim1, "ben", reason="smoke")
    await until(lambda: cell_b.relay.control.stops.of(sim1.id), "b knows of it")
    robot = await cell_b.robot(sim1)
    await until(lambda: robot.session.stopped_by == "ben", "the robot is stopped")
    assert cell_b.relay.control.stops.of(sim1.id).reason == "smoke"
    cell_a.database.down = cell_b.database.down = False


async def test_no_answer_of_the_database_keeps_later_stops_or_robots_out(
    cell_a, cell_b, sim1, monkeypatch
):
    asked = []

    async def broken(robot_id=None):
        asked.append(robot_id)
        raise LookupError

    async with cell_a.listener.cut():
        await until(lambda: cell_b.relay.peers.count() == 0, "b is alone")
        with monkeypatch.context() as broken_database:
            broken_database.setattr(cell_b.database, "stored_control", broken)
            robot = await cell_b.robot(sim1)
            await until(lambda: None in asked, "b asked for the stops of others")
        cell_b.database.stops.append(Stop(sim1.id, utc_now(), "ben"))
        await until(lambda: robot.session.stopped_by == "ben", "the robot is stopped")


async def test_a_stop_that_a_release_did_not_see_outlives_a_partition(cell_a, cell_b, sim1):
    """While the cells are apart, one stops the robot and the other releases it from the stop before."""
    robot = await cell_b.robot(sim1)
    cell_b.relay.control.stops.stop(sim1, "ann")
    await until(lambda: cell_a.relay.control.stops.of(sim1.id), "a knows")
    async with cell_a.listener.cut(), cell_b.listener.cut():
        await until(
            lambda: cell_a.relay.peers.count() + cell_b.relay.peers.count() == 0, "they are apart"
        )
        cell_a.relay.control.stops.stop(sim1, "ben")
        await cell_b.relay.control.stops.release(sim1, "carl")
        assert not robot.session.stopped
    await until(lambda: robot.session.stopped_by == "ben", "the robot is stopped again")
    await until(lambda: cell_a.relay.registry.robot(sim1.id).stops.ended, "a knows of the release")
    stops = [cell.relay.registry.robot(sim1.id).stops for cell in (cell_a, cell_b)]
    assert [[stop.by for stop in each.in_force.values()] for each in stops] == [["ben"], ["ben"]]


async def test_a_stop_that_only_the_database_has_is_read_with_the_session(cell_a, cell_b, sim1):
    """The cells cannot reach each other, and the robot goes from one to the other."""
    async with cell_a.listener.cut(), cell_b.listener.cut():
        await until(lambda: cell_b.relay.peers.count() == 0, "they are apart")
        cell_a.relay.control.stops.stop(sim1, "ben")
        cell_a.database.stops.append(cell_a.relay.control.stops.of(sim1.id))
        cell_a.database.fences[sim1.id] = 41
        robot = await cell_b.robot(sim1)
        assert robot.session.leases[0] == {"type": "lease", "fence": 41, "held": False}
        assert robot.session.stopped_by == "ben"
