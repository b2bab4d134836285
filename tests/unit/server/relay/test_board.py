"""The fleet as one client sees it, without a network."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from relay_server import MemoryRecords, utc
from robotether_server.relay import board as module
from robotether_server.relay.board import Board, Feed
from robotether_server.relay.connections import Connections
from robotether_server.relay.sessions import Change, Presence
from robotether_server.store.fleet import Snapshot

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
def board(records: MemoryRecords, robots: Robots) -> Board:
    """A board over the newest rows and rights."""
    return Board(
        lambda: Snapshot(dict(records.robots), dict(records.grants)),
        robots,
        Connections(),
        NoControl(),
    )


def told(feed: Feed) -> list[tuple[str, str]]:
    """Take what waits; return kinds and names."""
    return [(kind, robot["name"]) for kind, robot in feed.take()]


async def test_a_client_that_does_not_read_is_told_the_newest_state_only(board, robots, sim1):
    """However often a robot changes, one event waits for a slow client."""
    with board.followed_by(1) as feed:
        feed.first()
        for turn in range(1000):
            robots.presences[7] = Presence(ros="ok" if turn % 2 else "down", video="ok")
            board.changed(7)
        (event,) = feed.take()
        assert (event[0], event[1]["ros"], event[1]["video"]) == ("robot", "ok", "ok")
        assert feed.take() == []


async def test_a_change_back_is_no_event(board, robots, sim1):
    """What looks as the client saw it last is not told again."""
    with board.followed_by(1) as feed:
        feed.first()
        board.changed(7)
        assert feed.take() == []


async def test_a_feed_remembers_only_robots_of_its_user(board, records):
    """A change of a robot that the user may not see wakes nobody."""
    records.add_robot(8, "sim2")
    with board.followed_by(1) as feed:
        feed.first()
        board.changed(8)
        await feed.wait(0.01)
        assert feed._pending == set()


async def test_rights_that_change_show_and_remove(board, records, sim1):
    """All robots that were or are now visible are looked at again."""
    with board.followed_by(9) as feed:
        assert feed.first() == ("fleet", [])
        records.grants[9, 7] = "observe"
        board.all_changed()
        assert told(feed) == [("robot", "sim1")]
        del records.grants[9, 7]
        board.all_changed()
        assert told(feed) == [("removed", "sim1")]


async def test_a_new_name_is_another_robot(board, records, sim1):
    """Clients go by names: the old one is removed before the new one is told."""
    with board.followed_by(1) as feed:
        feed.first()
        records.robots = {7: replace(sim1, name="turtle")}
        board.all_changed()
        assert told(feed) == [("removed", "sim1"), ("robot", "turtle")]


async def test_round_trips_are_told_seldom(board, robots, sim1, monkeypatch):
    """Of many heartbeats one is told, the next when the time has come."""
    with board.followed_by(1) as feed:
        feed.first()
        for rtt_ms in (1.0, 2.0, 3.0):
            robots.presences[7] = Presence(rtt_ms=rtt_ms)
            board.robot(Change("rtt", 7, robots.presences[7]))
            assert len(feed.take()) == (1 if rtt_ms == 1.0 else 0)
        monkeypatch.setattr(module, "RTT_TOLD_EVERY_S", 0.0)
        board.robot(Change("rtt", 7, robots.presences[7]))
        assert [event[1]["rtt_ms"] for event in feed.take()] == [3.0]


async def test_other_changes_are_told_at_once(board, robots, sim1):
    """Health and presence do not wait for the round trip's turn."""
    with board.followed_by(1) as feed:
        feed.first()
        for ros in ("ok", "down", "ok"):
            robots.presences[7] = Presence(online=True, ros=ros)
            board.robot(Change("told", 7, robots.presences[7]))
            assert [event[1]["ros"] for event in feed.take()] == [ros]


async def test_a_change_wakes_who_waits(board, sim1):
    """Waiting ends with a change or the end of the feed, and begins anew."""
    with board.followed_by(1) as feed:
        feed.first()
        for happens in (lambda: board.changed(7), board.end_feeds):
            waiting = asyncio.create_task(feed.wait(30))
            await asyncio.sleep(0)
            assert not waiting.done()
            happens()
            await asyncio.wait_for(waiting, 1)
        assert feed.ended


async def test_a_feed_that_is_left_is_forgotten(board, sim1):
    """After the block the board marks nothing any more."""
    with board.followed_by(1) as feed:
        feed.first()
        assert board.feed_count() == 1
    board.changed(7)
    assert (board.feed_count(), feed._pending) == (0, set())


def test_the_version_of_the_row_stands_for_one_not_yet_told(board, robots, sim1):
    """An offline robot shows what the records know; a session that told its own wins."""
    row = replace(sim1, agent_version="0.1.0")
    assert board.describe(row)["agent_version"] == "0.1.0"
    robots.presences[7] = Presence(online=True, agent_version="0.2.0")
    assert board.describe(row)["agent_version"] == "0.2.0"
