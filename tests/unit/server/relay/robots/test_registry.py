"""The registry of robots' links, without a network."""

from dataclasses import dataclass

import pytest
from relay_server import utc
from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import NEVER_SEEN, Presence

NOW = utc(2026, 1, 1, 12, 3)


@dataclass(eq=False)
class FakeLink:
    robot_id: int = 7
    kind: str = "session"
    address: str = "198.51.100.7"


@pytest.fixture
def changes():
    return []


@pytest.fixture
def registry(changes):
    registry = SessionRegistry(clock=lambda: NOW, monotonic=lambda: 5.0)
    registry.listen(changes.append)
    return registry


def online(registry):
    link = FakeLink()
    registry.make_current(link)
    registry.established(link)
    return link


def test_a_newer_link_makes_the_older_leave_first(registry, changes):
    older, newer = online(registry), FakeLink()
    assert registry.make_current(newer) is older
    registry.established(newer)
    registry.disconnected(older, "link_lost")
    assert [(change.what, change.code) for change in changes] == [
        ("connected", None),
        ("disconnected", "superseded"),
        ("connected", None),
    ]
    # A late establishment of an older one changes nothing.
    registry.established(older)
    assert len(changes) == 3
    assert registry.session_of(7) is newer


def test_what_an_offline_media_or_shell_link_tells_is_ignored(registry, changes):
    """Only the established session speaks for the robot."""
    waiting, media, shell = FakeLink(), FakeLink(kind="media"), FakeLink(kind="shell")
    for link in (waiting, media, shell):
        registry.make_current(link)
    for link in (media, shell):
        registry.established(link)
    for link in (waiting, media, shell):
        registry.on_hello(link, "0.1.0", "on")
        registry.on_health(link, "ok", "ok", ros_exposed=False)
        registry.on_heartbeat(link, 1.0)
    assert changes == []


def test_leaving_forgets_what_holds_only_while_online(registry):
    link = online(registry)
    registry.on_hello(link, "0.1.0", "on", epoch=8)
    registry.on_heartbeat(link, 12.345)
    assert registry.presence(7).rtt_ms == 12.3
    registry.disconnected(link, "timeout")
    assert registry.presence(7) == Presence(
        since=NOW, end_code="timeout", agent_version="0.1.0", epoch=8
    )
    assert registry.count("session") == 0
    assert (registry.online(), registry.session_of(7)) == ([], None)


def test_the_database_tell_since_when_but_never_overrule(registry):
    online(registry)
    before = utc(2025, 12, 31)
    registry.remember([(7, before, None), (8, before, "timeout")])
    assert registry.presence(7).online
    assert registry.presence(8) == Presence(since=before, end_code="timeout")
    registry.seen_elsewhere(8)
    assert registry.presence(8).end_code is None


def test_robots_that_are_gone_are_forgotten_unless_connected(registry):
    online(registry)
    registry.remember([(8, NOW, None), (9, NOW, None)])
    registry.on_snapshot(Snapshot({9: RelayRobot(9, "sim3", "active", 1, 2)}, {}))
    assert registry.presence(7).online
    assert registry.presence(8) is NEVER_SEEN
    assert registry.presence(9).since == NOW
