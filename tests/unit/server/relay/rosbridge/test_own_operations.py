"""Clock syncs, the control object and the stop on the rosbridge WebSocket."""

from __future__ import annotations

import time

from fake_operator import FakeOperator
from relay_clients import closing
from relay_server import until
from robotether_server.db.fleet import RelayUser
from stopwatch import Stopwatch

BOB = RelayUser(2, "bob")


async def test_a_clock_sync_is_answered_with_the_relays_clock(relay, guarded, sim1, http):
    """The page's own time comes back beside it; the robot sees nothing of it."""
    async with FakeOperator(http, relay.ros_url(sim1)) as ann:
        before_ms = time.monotonic() * 1000
        await ann.send(op="robotether.beat", t_ms=81.25)
        answer = await ann.until("robotether.beat")
        assert answer["t_ms"] == 81.25
        # Rounded to microseconds.
        assert before_ms - 0.001 <= answer["relay_ms"] <= time.monotonic() * 1000 + 0.001
        # Who sends no key gets none.
        assert "key" not in answer
        assert "key" not in await ann.until("robotether.control")
    assert guarded.received == []


async def test_relay_shows_the_key_of_the_clock_syncs(relay, guarded, sim1, http):
    """In all that it says itself, so that a client tells it from a robot that says the same."""
    async with FakeOperator(http, relay.ros_url(sim1, "observe", BOB)) as bob:
        for key in ("of the first", "of the second"):
            await bob.send(op="robotether.beat", t_ms=1, key=key)
            answer = await bob.until("robotether.beat")
            assert answer["key"] == key
        relay.relay.control.stops.stop(sim1, "carl")
        while (told := await bob.until("robotether.control"))["control"]["stopped"] is None:
            pass
        assert told["key"] == "of the second"
    assert guarded.received == []


async def test_who_clock_syncs_sees_the_control_at_once_and_at_each_change(
    relay, guarded, sim1, http
):
    """An observer sees who drives, and that the robot is stopped."""
    async with FakeOperator(http, relay.ros_url(sim1, "observe", BOB)) as bob:
        await bob.clock_sync()
        await until(lambda: bob.controls, "the first comes at once")
        assert bob.controls[0]["driver"] is None
        async with http.ws_connect(relay.ros_url(sim1)):
            await until(lambda: bob.controls[-1]["driver"], "a driver came")
            relay.relay.control.stops.stop(sim1, "carl")
            await until(
                lambda: (bob.controls[-1]["stopped"] or {}).get("confirmed"), "it is stopped"
            )
            assert bob.controls[-1]["stopped"]["by"] == "carl"


async def test_who_sends_no_clock_sync_sees_none_of_it(relay, guarded, sim1, http):
    """An ordinary rosbridge client gets nothing that rosbridge would not send."""
    async with FakeOperator(http, relay.ros_url(sim1, "observe", BOB)) as bob:
        async with http.ws_connect(relay.ros_url(sim1)):
            await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        await bob.send(op="subscribe", topic="/a")
        assert (await bob.until("subscribe"))["topic"] == "/a"
        assert bob.messages == []


async def test_an_observer_stops_the_robot_without_a_database(
    relay, guarded, sim1, http, memory_database
):
    """The driver is closed with 4003, with the observer's name, while the database is away."""
    async with (
        FakeOperator(http, relay.ros_url(sim1, "observe", BOB)) as bob,
        http.ws_connect(relay.ros_url(sim1)) as ann,
    ):
        await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        memory_database.down = True
        with Stopwatch() as stopwatch:
            await bob.send(op="robotether.stop")
            code, reason = await closing(ann)
        assert stopwatch.s < 0.3
        assert code == 4003
        assert reason.startswith("bob stopped sim1")
        await until(lambda: guarded.session.stopped, "its guard has it")
