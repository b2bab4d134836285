"""The fleet as one client sees it, without a network."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from relay_server import MemoryDatabase, utc
from robotether_server.db.fleet import Snapshot
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.events import fleet_events as module
from robotether_server.relay.events.fleet_events import FleetEvents
from robotether_server.relay.robots.sessions import Change, Presence

NOW = utc(2026, 1, 1, 12, 3)


class Robots:
    """A registry that says what a test told it."""

    def __init__(self) -> None:
        self.presences: dict[int, Presence] = {}

    def presence(self, robot_id: int) -> Presence:
        return self.presences.get(robot_id, Presence())


class NoControl:
    """Nobody drives, and nothing is stopped."""

    def driver(self, _robot_id: int) -> None:
        return None

    def describe(self, _robot_id: int) -> dict[str, object]:
        return {}


@pytest.fixture
def robots() -> Robots:
    """What is known of the robots: nothing."""
    return Robots()


@pytest.fixture
def fleet_events(memory_database: MemoryDatabase, robots: Robots) -> FleetEvents:
    """Events over the newest rows and rights."""
    return FleetEvents(
        lambda: Snapshot(dict(memory_database.robots), dict(memory_database.grants)),
        robots,
        Connections(),
        NoControl(),
    )


async def test_a_client_that_does_not_read_is_told_the_newest_state_only(
    fleet_events, robots, sim1
):
    """However often a robot changes, one event waits for a slow client."""
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        for turn in range(1000):
            robots.presences[7] = Presence(ros="ok" if turn % 2 else "down", video="ok")
            fleet_events.changed(7)
        (event,) = subscriber.pop_events()
        assert (event[0], event[1]["ros"], event[1]["video"]) == ("robot", "ok", "ok")
        assert subscriber.pop_events() == []


async def test_a_change_back_is_no_event(fleet_events, robots, sim1):
    """What looks as the client saw it last is not told again."""
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        fleet_events.changed(7)
        assert subscriber.pop_events() == []


async def test_a_subscriber_remembers_only_robots_of_its_user(fleet_events, memory_database):
    """A change of a robot that the user may not see wakes nobody."""
    memory_database.add_robot(8, "sim2")
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        fleet_events.changed(8)
        await subscriber.wait(0.01)
        assert subscriber._pending == set()


async def test_round_trips_are_told_seldom(fleet_events, robots, sim1, monkeypatch):
    """Of many heartbeats one is told, the next when the time has come."""
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        for rtt_ms in (1.0, 2.0, 3.0):
            robots.presences[7] = Presence(rtt_ms=rtt_ms)
            fleet_events.on_robot_change(Change("heartbeat", 7, robots.presences[7]))
            assert len(subscriber.pop_events()) == (1 if rtt_ms == 1.0 else 0)
        monkeypatch.setattr(module, "RTT_NOTIFY_EVERY_S", 0.0)
        fleet_events.on_robot_change(Change("heartbeat", 7, robots.presences[7]))
        assert [event[1]["rtt_ms"] for event in subscriber.pop_events()] == [3.0]


async def test_other_changes_are_told_at_once(fleet_events, robots, sim1):
    """Health and presence do not wait for the round trip's turn."""
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        for ros in ("ok", "down", "ok"):
            robots.presences[7] = Presence(online=True, ros=ros)
            fleet_events.on_robot_change(Change("updated", 7, robots.presences[7]))
            assert [event[1]["ros"] for event in subscriber.pop_events()] == [ros]


async def test_a_change_wakes_who_waits(fleet_events, sim1):
    """Waiting ends with a change or the end of the subscriber, and begins anew."""
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        for happens in (lambda: fleet_events.changed(7), fleet_events.end_subscriptions):
            waiting = asyncio.create_task(subscriber.wait(30))
            await asyncio.sleep(0)
            assert not waiting.done()
            happens()
            await asyncio.wait_for(waiting, 1)
        assert subscriber.ended


def test_the_version_of_the_row_stands_for_one_not_yet_told(fleet_events, robots, sim1):
    """An offline robot shows what the records know; a session that told its own wins."""
    row = replace(sim1, agent_version="0.1.0")
    assert fleet_events.describe(row)["agent_version"] == "0.1.0"
    robots.presences[7] = Presence(online=True, agent_version="0.2.0")
    assert fleet_events.describe(row)["agent_version"] == "0.2.0"
