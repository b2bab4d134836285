"""Stopping and releasing robots through the whole relay, with guards that behave and guards that do not."""

from __future__ import annotations

import asyncio

import pytest
from fake_robot import FakeRobot
from relay_clients import audit_lines, closing, misbehaving
from relay_server import SESSION_KEY, running_relay, until, utc
from robotether_server.contract.control import ShownStop
from robotether_server.db.control import Stop, StopEntry
from robotether_server.problems import GuardSilentError, NotPossibleError, RobotOfflineError
from robotether_server.relay.control import stops as stops_module
from robotether_server.relay.robots.robot import GuardReport
from stopwatch import Stopwatch

NOON = utc(2026, 1, 1, 12, 0)


def control(relay, sim1):
    return relay.relay.control.describe(sim1.id)


def orders(robot: FakeRobot) -> list[str]:
    return [order["type"] for order in robot.session.orders]


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


async def test_nobody_drives_a_stopped_robot(relay, guarded, sim1, http):
    """A drive connection is closed with 4003; an observer comes in."""
    relay.relay.control.stops.stop(sim1, "ben")
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert (await closing(socket))[0] == 4003
    async with http.ws_connect(relay.ros_url(sim1, "observe")):
        await guarded.connections(1)


async def test_a_release_needs_the_guard(relay, guarded, sim1, http, memory_database):
    """Once the guard confirmed it, people drive again."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ben")
    await stops.release(sim1, "ann")
    assert control(relay, sim1).stopped is None
    assert orders(guarded) == ["stop", "release"]
    async with http.ws_connect(relay.ros_url(sim1)):
        await until(lambda: relay.relay.control.driver(sim1.id) == "ann", "ann drives")
    entry = next(e for e in memory_database.written if isinstance(e, StopEntry))
    assert entry.stop is None


async def test_a_silent_guard_keeps_the_robot_stopped(relay, sim1, monkeypatch):
    """The stop is not confirmed, a release fails, and the stop is told again."""
    monkeypatch.setattr(stops_module, "RELEASED_WITHIN_S", 0.2)
    monkeypatch.setattr(stops_module, "CONFIRMED_WITHIN_S", 0.1)
    monkeypatch.setattr(stops_module, "REPEAT_EVERY_S", 0.1)
    robot, stops = await misbehaving(relay, sim1, "guard_silent"), relay.relay.control.stops
    await until(lambda: relay.relay.registry.presence(7).guard == "ready", "the guard is known")
    stops.stop(sim1, "ben")
    assert not await stops.confirmation(sim1.id)
    with pytest.raises(GuardSilentError):
        await stops.release(sim1, "ann")
    stopped = control(relay, sim1).stopped
    assert (stopped.by, stopped.confirmed) == ("ben", False)
    told = len(robot.session.orders)
    await until(lambda: len(robot.session.orders) > told, "it is told again")
    assert orders(robot)[-1] == "stop"
    robot.session.answers_orders = True
    await until(lambda: control(relay, sim1).stopped.confirmed, "at last it is confirmed")
    await robot.stop()


async def test_a_stop_during_a_release_wins(relay, sim1):
    """Who stops while the release is on its way has a stopped robot."""
    robot, stops = await misbehaving(relay, sim1, "guard_silent"), relay.relay.control.stops
    await until(lambda: relay.relay.registry.presence(7).guard == "ready", "the guard is known")
    stops.stop(sim1, "ben")
    release = asyncio.create_task(stops.release(sim1, "ann"))
    await until(lambda: "release" in orders(robot), "the release is on its way")
    stops.stop(sim1, "carl")
    with pytest.raises(NotPossibleError, match="carl has stopped it again"):
        await release
    await until(lambda: orders(robot)[-1] == "stop", "the guard hears of it after the release")
    assert stops.of(sim1.id).by == "carl"
    await robot.stop()


async def test_a_stop_behind_the_answer_to_a_release_wins(relay, sim1):
    """The guard has released the robot, who asked for it has not heard of it yet, and somebody stops it."""
    robot, stops = await misbehaving(relay, sim1, "guard_silent"), relay.relay.control.stops
    registry = relay.relay.registry
    await until(lambda: registry.presence(7).guard == "ready", "the guard is known")
    stops.stop(sim1, "ben")
    release = asyncio.create_task(stops.release(sim1, "ann"))
    await until(lambda: "release" in orders(robot), "the release is on its way")
    answers = next(each["id"] for each in robot.session.orders if each["type"] == "release")
    registry.on_guard_status(registry.session_of(7), GuardReport(state="ready"), answers)
    stops.stop(sim1, "carl")
    with pytest.raises(NotPossibleError, match="carl has stopped it again"):
        await release
    assert stops.of(sim1.id).by == "carl"
    await robot.stop()


async def test_two_may_release_a_robot_at_once(relay, guarded, sim1):
    """The second one finds it released, and nobody is told of another stop."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ben")
    await asyncio.gather(stops.release(sim1, "ann"), stops.release(sim1, "carl"))
    assert stops.of(sim1.id) is None


async def test_a_release_that_is_given_up_leaves_a_stop_that_is_repeated(relay, sim1, monkeypatch):
    """Who asked went away, and nobody knows what the guard did."""
    monkeypatch.setattr(stops_module, "REPEAT_EVERY_S", 0.1)
    robot, stops = await misbehaving(relay, sim1, "guard_silent"), relay.relay.control.stops
    await until(lambda: relay.relay.registry.presence(7).guard == "ready", "the guard is known")
    stops.stop(sim1, "ben")
    release = asyncio.create_task(stops.release(sim1, "ann"))
    await until(
        lambda: relay.relay.registry.robot(sim1.id).stops.repeat_timer is None,
        "the time to repeat it passes during the release",
    )
    release.cancel()
    await asyncio.gather(release, return_exceptions=True)
    await until(lambda: orders(robot)[-2:] == ["release", "stop"], "it is told again")
    await robot.stop()


async def test_who_stops_without_end_does_not_fill_the_session(relay, sim1, memory_database):
    """A session that is full would end, and the robot were offline; nor does it fill the log."""
    robot, stops = await misbehaving(relay, sim1, "guard_silent"), relay.relay.control.stops
    await until(lambda: relay.relay.registry.presence(7).guard == "ready", "the guard is known")
    for _ in range(1000):
        stops.stop(sim1, "eve")
    release = asyncio.create_task(stops.release(sim1, "ann"))
    await until(lambda: "release" in orders(robot), "the release is on its way")
    for _ in range(1000):
        stops.stop(sim1, "eve")
    with pytest.raises(NotPossibleError):
        await release
    await until(lambda: orders(robot)[-1] == "stop", "the last stop is told")
    assert len(orders(robot)) < 10
    await until(
        lambda: len([e for e in audit_lines(memory_database) if e.kind == "robot_stopped"]) == 2, ""
    )
    await robot.stop()


async def test_an_offline_robot_is_stopped_when_it_comes(relay, sim1):
    """It hears of it after its configuration and its lease, and is not released meanwhile."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ben")
    assert not await stops.confirmation(sim1.id)
    with pytest.raises(RobotOfflineError):
        await stops.release(sim1, "ann")
    robot = await misbehaving(relay, sim1, "guarded")
    await until(lambda: stops.confirmed(sim1.id), "its guard has it")
    assert orders(robot)[0] == "stop"
    await robot.stop()


async def test_a_robot_that_comes_back_stopped_is_stopped_here(relay, sim1, http, memory_database):
    """Its own latch makes the server's."""
    robot = await misbehaving(relay, sim1, "comes_back_stopped")
    await until(lambda: relay.relay.control.stops.of(sim1.id), "it is stopped")
    assert control(relay, sim1).stopped.by == "somebody at the robot"
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert (await closing(socket))[0] == 4003
    await robot.stop()


@pytest.mark.parametrize("name", ["ben", "b" * 63, "somebody at the robot (ben)"])
async def test_a_name_that_only_a_robot_tells_is_shown_as_such(relay, guarded, sim1, name):
    """Nobody's deed is made up by a robot; a name that went to it and came back stays as it was."""
    stops = relay.relay.control.stops
    guarded.session.stopped, guarded.session.stopped_by = True, name
    guarded.session.send_guard_status()
    await until(lambda: stops.of(sim1.id), "it is stopped")
    shown = control(relay, sim1).stopped.by
    assert shown.startswith("somebody at the robot (b")
    assert shown.count("(") == 1
    assert len(shown) <= 63


async def test_a_robot_without_a_guard_is_stopped_here_alone(relay, robot, sim1, http):
    """Its driver is cut off; nobody confirms; a release needs nobody either."""
    stops = relay.relay.control.stops
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: robot.clients, "ann has reached it")
        stops.stop(sim1, "ben")
        assert (await closing(socket))[0] == 4003
    assert not await stops.confirmation(sim1.id)
    await stops.release(sim1, "ann")
    assert control(relay, sim1).stopped is None


async def test_a_stop_without_a_database_is_written_when_it_comes_back(
    relay, guarded, sim1, memory_database
):
    """It holds at once, and its row follows."""
    memory_database.down = True
    relay.relay.control.stops.stop(sim1, "ben")
    assert await relay.relay.control.stops.confirmation(sim1.id)
    assert [e for e in memory_database.written if isinstance(e, StopEntry)] == []
    memory_database.down = False
    await until(
        lambda: [e for e in memory_database.written if isinstance(e, StopEntry)], "it is written"
    )


async def test_a_relay_knows_stops_before_it_serves(memory_database, sim1):
    """What the relay before it kept is in force from the first request on."""
    memory_database.stops = [Stop(sim1.id, NOON, "ben")]
    async with running_relay(memory_database) as server:
        assert server.relay.control.stops.of(sim1.id).by == "ben"
        robot = FakeRobot(sim1.id, SESSION_KEY, "guarded")
        await robot.start(server.relay.session_port)
        await until(lambda: robot.session.stopped, "the robot is told")
        await robot.stop()


async def test_another_persons_stop_takes_the_place_of_the_first(
    relay, guarded, sim1, memory_database
):
    """Its name stands in the control object, the row, the audit log and the guard."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ann")
    await stops.confirmation(sim1.id)
    stops.stop(sim1, "ben", reason="smoke", address="198.51.100.9")
    stopped = control(relay, sim1).stopped
    assert (stopped.by, stopped.confirmed) == ("ben", True)
    await until(lambda: guarded.session.stopped_by == "ben", "the guard has the newest name")
    await relay.relay.event_writer.flush(5)
    assert next(e for e in memory_database.written if isinstance(e, StopEntry)).stop.by == "ben"
    told = [(e.actor, e.kind, e.details) for e in audit_lines(memory_database)]
    assert told == [
        ("ann", "robot_stopped", {}),
        ("ben", "robot_stopped", {"reason": "smoke"}),
    ]


async def test_one_press_on_two_ways_does_not_hide_a_stop_between_them(
    relay, guarded, sim1, monkeypatch
):
    """Ann's page tells its stop twice, and Ben's came meanwhile; later she means another one."""
    stops = relay.relay.control.stops
    for name in ("ann", "ben", "ann", "ben", "ann"):
        stops.stop(sim1, name)
    assert stops.of(sim1.id).by == "ben"
    monkeypatch.setattr(stops_module, "SAME_PRESS_S", 0.0)
    stops.stop(sim1, "ann")
    assert stops.of(sim1.id).by == "ann"


async def test_two_who_stop_without_end_do_not_fill_the_session(
    relay, guarded, sim1, memory_database
):
    """Each counts once in a while, however often both stop; a release lets both begin anew."""
    stops = relay.relay.control.stops
    for _ in range(500):
        stops.stop(sim1, "eve")
        stops.stop(sim1, "mallory")
    await stops.confirmation(sim1.id)
    assert len(orders(guarded)) < 10
    await stops.release(sim1, "ann")
    stops.stop(sim1, "eve")
    stops.stop(sim1, "mallory")
    assert stops.of(sim1.id).by == "mallory"


async def test_a_release_ends_the_stop_that_was_seen_and_no_other(relay, guarded, sim1):
    """Neither another person's nor a later one; a robot that is free already is no error."""
    stops = relay.relay.control.stops
    stops.stop(sim1, "ann")
    seen = stops.shown(sim1.id)
    stops.stop(sim1, "ben")
    with pytest.raises(
        NotPossibleError, match=r"^ben stopped sim1 at \d\d:\d\d UTC too; check again"
    ):
        await stops.release(sim1, "ann", seen=seen)
    newer = stops.shown(sim1.id)
    with pytest.raises(NotPossibleError):
        await stops.release(sim1, "ann", seen=ShownStop(newer.by, "2026-01-01T12:00:00Z"))
    assert stops.of(sim1.id).by == "ben"
    for _ in range(2):
        await stops.release(sim1, "ann", seen=newer)
        assert stops.of(sim1.id) is None
    assert orders(guarded) == ["stop", "stop", "release"]
