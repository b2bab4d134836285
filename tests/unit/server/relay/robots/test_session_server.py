"""Who is accepted on the port for robots' sessions, over real sockets, and who may stay."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace

import pytest
from fake_robot import HOST, WAIT_S, RobotSession
from relay_clients import configured, ended
from relay_server import SESSION_KEY, RelayServer, running_relay, until
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.robots.robot import Presence
from robotether_server.relay.wiring import Timing

KINDS = ("session", "media")


def presence(relay: RelayServer, robot: RelayRobot) -> Presence:
    return relay.relay.registry.presence(robot.id)


async def test_a_wrong_key_gets_no_answer(relay, sim1, connect):
    """Who does not prove to be this stack's sshd is closed without a word."""
    session = await connect(session_key="another key")
    assert await ended(session) is None
    assert not session.configs
    assert b'session_refusals_total{code="preface"} 1.0' in relay.relay.metrics.render()


@pytest.mark.parametrize(
    "line", [b"\x00\xff\n", b"{}\n", b'{"type": "preface"}\n', b"x" * 70_000, b'{"type": ']
)
async def test_rubbish_instead_of_a_preface_gets_no_answer(relay, line):
    """Bytes that are no preface close the connection and disturb nobody."""
    reader, writer = await asyncio.open_connection(HOST, relay.relay.session_port)
    writer.write(line)
    writer.write_eof()
    with contextlib.suppress(ConnectionError):
        assert await asyncio.wait_for(reader.read(), WAIT_S) == b""
    writer.close()


async def test_an_unknown_robot_is_told(relay, connect):
    """A robot that is not in the records hears robot_unknown."""
    assert await ended(await connect(robot_id=999)) == "robot_unknown"


async def test_a_robot_newer_than_the_last_poll_is_admitted(memory_database):
    """A robot that was approved a moment ago is looked up again instead of being rejected."""
    async with running_relay(memory_database, Timing(poll_every_s=3600)) as relay:
        memory_database.add_robot(8, "sim8")
        session = RobotSession(8, kind="session", session_key=SESSION_KEY)
        await session.connect(relay.relay.session_port)
        await configured(session)
        await session.close()


async def test_a_disabled_robot_is_told(relay, sim1, memory_database, connect):
    """A robot that was disabled before it connects hears robot_disabled."""
    memory_database.robots = {sim1.id: replace(sim1, state="disabled")}
    await until(lambda: relay.relay.fleet.known().robots[7].state == "disabled", "it is known")
    assert await ended(await connect()) == "robot_disabled"


async def test_disabling_ends_a_live_session(relay, sim1, memory_database, connect):
    """Disabling a robot ends session and media with robot_disabled."""
    session, media = await configured(await connect()), await connect("media")
    memory_database.robots = {sim1.id: replace(sim1, state="disabled")}
    assert await ended(session) == "robot_disabled"
    assert await ended(media) == "robot_disabled"
    assert not presence(relay, sim1).online


async def test_another_key_is_told(relay, sim1, memory_database, connect):
    """Only the robot's key and the one that it rotated from may come in."""
    memory_database.robots = {
        sim1.id: replace(sim1, fingerprint="SHA256:b", previous_fingerprint="SHA256:a")
    }
    await until(
        lambda: relay.relay.fleet.known().robots[7].fingerprint == "SHA256:b", "it is known"
    )
    for fingerprint in ("SHA256:a", "SHA256:b"):
        await configured(await connect(fingerprint=fingerprint))
    assert await ended(await connect(fingerprint="SHA256:c")) == "key_changed"


async def test_a_rotated_key_keeps_its_links_and_a_replaced_one_does_not(
    relay, sim1, memory_database, connect
):
    """A link lives on through one rotation; another key in the row ends it."""
    memory_database.robots = {sim1.id: replace(sim1, fingerprint="SHA256:a")}
    await until(
        lambda: relay.relay.fleet.known().robots[7].fingerprint == "SHA256:a", "it is known"
    )
    links = [await configured(await connect(kind, fingerprint="SHA256:a")) for kind in KINDS]
    memory_database.robots = {
        sim1.id: replace(sim1, fingerprint="SHA256:b", previous_fingerprint="SHA256:a")
    }
    await until(
        lambda: relay.relay.fleet.known().robots[7].fingerprint == "SHA256:b", "it is known"
    )
    assert [link.bye for link in links] == [None, None]
    memory_database.robots = {
        sim1.id: replace(sim1, fingerprint="SHA256:c", previous_fingerprint="SHA256:b")
    }
    assert [await ended(link) for link in links] == ["key_changed"] * 2


async def test_a_login_from_before_a_move_of_ports_is_told(sim1, connect):
    """Who logged in while it had other ports may listen on them still, and must log in again."""
    theirs = (sim1.ros_port, sim1.video_port)
    await configured(await connect(ports=theirs))
    assert await ended(await connect(ports=(*theirs, 24000))) == "ports_changed"


async def test_removing_ends_a_live_session(relay, memory_database, connect):
    """A robot whose row is gone hears robot_unknown."""
    session = await configured(await connect())
    memory_database.robots = {}
    assert await ended(session) == "robot_unknown"


async def test_a_relay_that_has_never_read_the_database_says_so(memory_database):
    """Without a first snapshot a robot hears not_ready, and comes again."""
    memory_database.down = True
    async with running_relay(memory_database) as relay:
        session = RobotSession(7, kind="session", session_key=SESSION_KEY)
        await session.connect(relay.relay.session_port)
        assert await ended(session) == "not_ready"
        await session.close()
