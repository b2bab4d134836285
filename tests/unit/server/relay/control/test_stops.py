"""Stopping and releasing robots through the whole relay, with guards that behave and guards that do not."""

import asyncio

import pytest
from fake_robot import FakeRobot
from relay_clients import audit_lines, closing
from relay_server import SESSION_KEY, running_relay, until, utc
from robotether_server.db.control import Stop, StopEntry
from stopwatch import Stopwatch

NOON = utc(2026, 1, 1, 12, 0)


def control(relay, sim1):
    return relay.relay.control.describe(sim1.id)


async def test_a_stop_ends_the_drive_and_reaches_the_guard(
    relay, guarded, sim1, http, memory_database
):
    """The driver hears 4003 with a name, the guard has it, and the row is written."""
    stops = relay.relay.control.stops
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        with Stopwatch() as stopwatch:
            stops.stop(sim1, "ben", reason="smoke")
            assert await stops.confirmation(sim1.id)
            code, reason = await closing(socket)
    assert stopwatch.s < 0.3
    assert code == 4003
    assert reason.startswith("ben stopped sim1 at ")
    assert control(relay, sim1).stopped.confirmed is True
    assert guarded.session.stopped_by == "ben"
    await until(
        lambda: [e for e in memory_database.written if isinstance(e, StopEntry)], "it is written"
    )
    await until(
        lambda: "robot_stopped" in {e.kind for e in audit_lines(memory_database)}, "so is the log"
    )


async def test_nobody_drives_a_stopped_robot_before_its_guard_has_released_it(
    relay, guarded, sim1, http
):
    """A drive connection is closed with 4003; an observer comes in."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ben")
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert (await closing(socket))[0] == 4003
    async with http.ws_connect(relay.ros_url(sim1, "observe")):
        await guarded.connections(1)
    await stops.release(sim1, "ann")
    assert control(relay, sim1).stopped is None
    assert [order["type"] for order in guarded.session.orders] == ["stop", "release"]
    async with http.ws_connect(relay.ros_url(sim1)):
        await until(lambda: relay.relay.control.driver(sim1.id) == "ann", "ann drives")


async def test_two_may_release_a_robot_at_once(relay, guarded, sim1):
    """The second one finds it released, and nobody is told of another stop."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ben")
    await asyncio.gather(stops.release(sim1, "ann"), stops.release(sim1, "carl"))
    assert stops.of(sim1.id) is None


@pytest.mark.parametrize("name", ["ben", "b" * 63, "somebody at the robot (ben)"])
async def test_a_name_that_only_a_robot_tells_is_shown_as_such(relay, guarded, sim1, name):
    """Nobody's action is made up by a robot; a name that went to it and came back stays as it was."""
    stops = relay.relay.control.stops
    guarded.session.stopped, guarded.session.stopped_by = True, name
    guarded.session.send_guard_status()
    await until(lambda: stops.of(sim1.id), "it is stopped")
    shown = control(relay, sim1).stopped.by
    assert shown.startswith("somebody at the robot (b")
    assert shown.count("(") == 1
    assert len(shown) <= 63


async def test_a_relay_knows_stops_before_it_serves(memory_database, sim1):
    memory_database.stops = [Stop(sim1.id, NOON, "ben")]
    async with running_relay(memory_database) as server:
        assert server.relay.control.stops.of(sim1.id).by == "ben"
        robot = FakeRobot(sim1.id, SESSION_KEY, "guarded")
        await robot.start(server.relay.session_port)
        await until(lambda: robot.session.stopped, "the robot is told")
        await robot.stop()
