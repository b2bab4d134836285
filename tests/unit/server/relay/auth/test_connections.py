"""Live connections and what ends them, without a network."""

from contextlib import ExitStack
from dataclasses import replace

import pytest
from robotether_server.db.fleet import Snapshot
from robotether_server.relay.auth.connections import Caps, Connections
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.settings import robot as robot_settings

USERS = {1: "ann", 2: "bob"}


class Live:
    """Connections as the handlers make them; remembers how each ended."""

    def __init__(self):
        self.connections = Connections(SessionRegistry())
        self.close_reasons = {}
        self._open = ExitStack()

    def add(self, user_id, robot, use, *, connected=True):
        ended = []

        def end(close_reason):
            ended.append(close_reason.name)

        connection = Connection(user_id, USERS[user_id], robot, use, end, connected)
        self.close_reasons[connection] = ended
        self._open.enter_context(self.connections.joined(connection))
        return connection

    def how(self, *connections):
        return [self.close_reasons[connection] for connection in connections]

    def leave(self):
        self._open.close()


@pytest.fixture
def live():
    return Live()


@pytest.fixture
def sim2(memory_database):
    return memory_database.add_robot(8, "sim2", u1="drive")


def snapshot(memory_database):
    return Snapshot(dict(memory_database.robots), dict(memory_database.grants))


def test_only_what_the_newest_rights_forbid_ends(live, memory_database, sim1):
    drive, watch = live.add(1, sim1, "drive"), live.add(1, sim1, "video")
    other = live.add(2, sim1, "observe")
    live.connections.on_snapshot(snapshot(memory_database))
    assert live.how(drive, watch, other) == [[], [], []]
    memory_database.grants[1, sim1.id] = "observe"
    live.connections.on_snapshot(snapshot(memory_database))
    assert live.how(drive, watch, other) == [["rights_ended"], [], []]
    memory_database.grants.clear()
    live.connections.on_snapshot(snapshot(memory_database))
    assert live.how(watch, other) == [["rights_ended"], ["rights_ended"]]


@pytest.mark.parametrize("change", [{"state": "disabled"}, {"name": "turtle"}, None])
def test_a_robot_that_is_gone_or_another_now_ends_its_connections(
    live, memory_database, sim1, change
):
    """Disabled, renamed or removed: who opened it by its name has to open it anew."""
    connection = live.add(1, sim1, "drive")
    memory_database.robots = {} if change is None else {sim1.id: replace(sim1, **change)}
    live.connections.on_snapshot(snapshot(memory_database))
    assert live.how(connection) == [["rights_ended"]]


def test_users_and_robots_have_room_for_so_many(live, sim1, sim2):
    live.connections.caps = Caps(per_user=2, per_robot=9)
    first, _ = live.add(1, sim1, "drive"), live.add(1, sim2, "observe", connected=False)
    assert "you already have 2 connections" in (live.connections.no_room(first) or "")
    assert live.connections.no_room(replace(first, use="video")) is None
    assert live.connections.no_room(replace(first, user_id=2)) is None
    route = replace(first, is_route=True)
    with live.connections.joined(route), live.connections.joined(replace(route, robot=sim2)):
        assert live.connections.no_room(route) is None
    live.leave()
    assert live.connections.no_room(first) is None
    live.connections.caps = Caps(per_user=9, per_robot=2)
    observer, _ = live.add(2, sim1, "observe"), live.add(1, sim1, "observe")
    assert "robot sim1 already has 2" in (live.connections.no_room(observer) or "")
    assert live.connections.no_room(replace(observer, use="drive")) is None
    assert live.connections.no_room(replace(observer, robot=sim2)) is None


def test_those_who_only_watch_leave_a_driver_room_for_its_picture(live, sim1, sim2):
    """A quarter of a robot's viewers, and half of the cameras that it shows, are for those who may drive it."""
    live.connections.caps = Caps(per_user=9, per_robot=8, cameras_of_observers=2)
    for camera in ("/a", "/b", "/c", "/a", "/a", "/a"):
        viewer = live.add(2, sim1, "video")
        viewer.camera, viewer.may_drive = camera, camera == "/c"
    observer = replace(viewer, may_drive=False)
    assert "robot sim1 already has 6" in (live.connections.no_room(observer) or "")
    live.connections.caps = Caps(per_user=9, per_robot=99, cameras_of_observers=2)
    more = replace(observer, camera="/d")
    assert "already shows 2 cameras" in (live.connections.no_room(more) or "")
    assert live.connections.no_room(observer) is None
    assert live.connections.no_room(replace(more, robot=sim2)) is None
    for camera in ("/a", "/d"):
        assert live.connections.no_room(replace(more, camera=camera, may_drive=True)) is None


def test_people_who_watch_are_counted_once_and_without_the_driver(live, sim1):
    """A page has a second connection for its list of topics, the driver's page, too."""
    for user_id, use in ((1, "drive"), (1, "observe"), (2, "observe"), (2, "observe")):
        live.add(user_id, sim1, use)
    assert live.connections.observers(sim1.id) == 1


POLICY = {"policy": {"drive": {"call": ["/dock"]}}}
BUTTON = {"name": "Dock", "kind": "call", "service": "/dock"}


@pytest.mark.parametrize(
    ("before", "after", "goes_on"),
    [
        ({}, {"policy": {"drive": {"publish": ["/lights"]}}}, False),
        ({}, {"policy": {"limits": {"subscriptions": 5}}}, False),
        ({}, {"guard": {"drive_topics": ["/steer"]}}, False),
        ({}, {"guard": {"max_speed_m_s": 1.0}}, True),
        ({}, {"page": {"kind": "holonomic", "hold_after_ms": None}}, True),
        # A button gives nobody a right.
        (POLICY, POLICY | {"buttons": [BUTTON]}, True),
    ],
)
def test_another_policy_ends_what_was_opened_under_the_former(
    *, live, memory_database, sim1, before, after, goes_on
):
    """What a connection may send was fixed when it was opened; the guard's limits are the guard's."""
    old, new = (replace(sim1, settings=robot_settings.parse(each)) for each in (before, after))
    driving, watching = live.add(1, old, "drive"), live.add(2, old, "video")
    memory_database.robots = {sim1.id: new}
    live.connections.on_snapshot(snapshot(memory_database))
    assert live.how(driving, watching) == [[] if goes_on else ["rights_ended"], []]


def test_a_manager_who_drives_and_is_one_no_more_is_ended(live, memory_database, sim1):
    """The connection could publish what a driver may not."""
    memory_database.grants[1, sim1.id] = "manage"
    connection = live.add(1, sim1, "drive")
    connection.level = "manage"
    memory_database.grants[1, sim1.id] = "drive"
    live.connections.on_snapshot(snapshot(memory_database))
    assert live.how(connection) == [["rights_ended"]]
