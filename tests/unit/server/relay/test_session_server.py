"""Robots' sessions over real sockets: who is let in, who takes over, and how a session ends."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace

import pytest
import pytest_asyncio
from fake_robot import HOST, WAIT_S, FakeRobot, RobotSession
from relay_server import (
    FAST,
    SESSION_KEY,
    RelayServer,
    running_relay,
    until,
)
from robotether_server.relay.sessions import Presence
from robotether_server.store.fleet import Robot

Connect = Callable[..., "asyncio.Future[RobotSession]"]


@pytest_asyncio.fixture
async def connect(relay: RelayServer, sim1: Robot) -> AsyncIterator[Connect]:
    """Open sessions of sim1 that are closed at the end."""
    opened: list[RobotSession] = []

    async def open_session(kind: str = "session", **changes: object) -> RobotSession:
        fields = {"robot_id": sim1.id, "session_key": SESSION_KEY} | changes
        session = RobotSession(fields.pop("robot_id"), kind=kind, **fields)
        await session.connect(relay.relay.session_port)
        opened.append(session)
        return session

    yield open_session
    for session in opened:
        await session.close()


def presence(relay: RelayServer, robot: Robot) -> Presence:
    return relay.relay.registry.presence(robot.id)


async def ended(session: RobotSession) -> str | None:
    """Wait for the end; return the code of the bye, None without one."""
    await asyncio.wait_for(session.closed.wait(), WAIT_S)
    return session.bye["code"] if session.bye else None


async def test_a_session_gets_its_configuration(relay, sim1, connect):
    """The first line is the robot's configuration, and the robot is online."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    assert session.configs == [
        {
            "type": "config",
            "robot": "sim1",
            "ros_port": sim1.ros_port,
            "video_port": sim1.video_port,
            "heartbeat_s": FAST.heartbeat_s,
            "timeout_s": FAST.timeout_s,
        }
    ]
    assert presence(relay, sim1).online
    assert presence(relay, sim1).address == "198.51.100.7"


async def test_media_gets_a_configuration_but_makes_no_robot_online(relay, sim1, connect):
    """Only the session says that a robot is online."""
    media = await connect("media")
    await asyncio.wait_for(media.configured.wait(), WAIT_S)
    assert not presence(relay, sim1).online


async def test_heartbeats_measure_the_round_trip_and_are_answered(relay, sim1, connect):
    """The relay learns the round trip, and answers the agent's pings with the agent's clock."""
    session = await connect()
    session.send(type="ping", seq=17, t_ms=123456.7)
    await until(lambda: session.pongs == 1, "the ping is answered")
    await until(lambda: presence(relay, sim1).rtt_ms is not None, "the round trip is known")


async def test_health_and_version_are_told(relay, sim1, connect):
    """What the agent tells of itself stands in the robot's presence."""
    session = await connect()
    session.send(type="hello", hostname="turtle", agent_version="0.1.0")
    session.send(type="health", ros="ok", video="down", detail="nothing on 8080")
    session.send(type="something new", value=1)
    await until(lambda: presence(relay, sim1).ros == "ok", "health is known")
    assert presence(relay, sim1).video == "down"
    assert presence(relay, sim1).agent_version == "0.1.0"


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


async def test_a_disabled_robot_is_told(relay, sim1, records, connect):
    """A robot that was disabled before it connects hears robot_disabled."""
    records.robots = {sim1.id: replace(sim1, state="disabled")}
    await until(lambda: relay.relay.fleet.known.robots[7].state == "disabled", "it is known")
    assert await ended(await connect()) == "robot_disabled"


async def test_disabling_ends_a_live_session(relay, sim1, records, connect):
    """Disabling a robot ends session and media with robot_disabled."""
    session, media = await connect(), await connect("media")
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    records.robots = {sim1.id: replace(sim1, state="disabled")}
    assert await ended(session) == "robot_disabled"
    assert await ended(media) == "robot_disabled"
    assert not presence(relay, sim1).online


async def test_removing_ends_a_live_session(relay, records, connect):
    """A robot whose row is gone hears robot_unknown."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    records.robots = {}
    assert await ended(session) == "robot_unknown"


async def test_new_ports_end_a_live_session(relay, sim1, records, connect):
    """New ports need a new SSH login, so the session ends with ports_changed."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    records.robots = {sim1.id: replace(sim1, ros_port=sim1.ros_port + 1)}
    assert await ended(session) == "ports_changed"


async def test_a_new_name_is_told_on_the_same_session(relay, sim1, records, connect):
    """Renaming reaches the agent as a new configuration line."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    records.robots = {sim1.id: replace(sim1, name="turtle")}
    await until(lambda: len(session.configs) == 2, "the new name is told")
    assert session.configs[1]["robot"] == "turtle"
    assert session.bye is None


async def test_a_newer_session_ends_the_older_first(relay, sim1, connect):
    """The older session hears superseded before the newer is configured."""
    older = await connect()
    await asyncio.wait_for(older.configured.wait(), WAIT_S)
    newer = await connect()
    assert await ended(older) == "superseded"
    await asyncio.wait_for(newer.configured.wait(), WAIT_S)
    assert presence(relay, sim1).online
    assert [link.kind for link in relay.relay.registry.links()] == ["session"]


async def test_media_and_session_do_not_end_each_other(relay, connect):
    """Only a connection of the same kind takes over."""
    session, media = await connect(), await connect("media")
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    await asyncio.wait_for(media.configured.wait(), WAIT_S)
    assert len(relay.relay.registry.links()) == 2


async def test_a_takeover_waits_until_the_port_is_free(relay, robot, sim1, connect):
    """While the older tunnel's port is accepted, the newer gets no configuration."""
    newer = await connect()
    assert await ended(robot.session) == "superseded"
    await asyncio.wait_for(newer.configured.wait(), WAIT_S)
    with pytest.raises(OSError, match=r"refused|111"):
        await asyncio.open_connection(HOST, sim1.ros_port)


async def test_a_port_that_stays_taken_is_waited_for_one_second(relay, robot, connect):
    """A port that is never released does not keep the robot out for ever."""
    robot.mode = "port_taken"
    begun = time.monotonic()
    newer = await connect()
    await asyncio.wait_for(newer.configured.wait(), WAIT_S)
    assert 0.9 < time.monotonic() - begun < 2


async def test_of_many_sessions_at_once_one_stays(relay, connect):
    """When several sessions of a robot come together, all but the last hear superseded."""
    sessions = [await connect() for _ in range(5)]
    await asyncio.wait_for(sessions[-1].configured.wait(), WAIT_S)
    assert [await ended(session) for session in sessions[:-1]] == ["superseded"] * 4
    assert sessions[-1].bye is None


async def test_a_silent_robot_times_out(relay, sim1, connect):
    """A robot that answers no heartbeat hears timeout after the time-out, and is offline."""
    session = await connect(silent=True)
    begun = time.monotonic()
    assert await ended(session) == "timeout"
    assert FAST.timeout_s < time.monotonic() - begun < FAST.timeout_s + 1
    assert not presence(relay, sim1).online


async def test_a_robot_that_answers_stays(relay, sim1, connect):
    """Pongs alone keep a session beyond the time-out."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    await asyncio.sleep(2 * FAST.timeout_s)
    assert session.bye is None
    assert presence(relay, sim1).online


@pytest.mark.parametrize(
    "line",
    [
        b"no json\n",
        b'{"type": "health", "ros": "fine", "video": "ok"}\n',
        b'{"type": "pong", "seq": "one"}\n',
        b'{"type": "hello", "hostname": "h"}\n',
        b"x" * 70_000,
        b"[" * 60_000 + b"\n",
    ],
)
async def test_a_broken_line_ends_the_session(relay, sim1, connect, line):
    """A line that breaks the contract ends the session with protocol_error."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    session.send_raw(line)
    assert await ended(session) == "protocol_error"
    assert not presence(relay, sim1).online


async def test_a_cut_session_is_offline_at_once(relay, sim1, records, connect):
    """A session that just ends makes the robot offline, and its row gets an end."""
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    await session.close()
    await until(lambda: not presence(relay, sim1).online, "it is offline", within_s=0.5)
    await until(lambda: records.sessions()[0].ended_at is not None, "the row has an end")
    assert records.sessions()[0].end_code == "link_lost"
    assert records.sessions()[0].address == "198.51.100.7"


async def test_sessions_are_written_when_the_database_is_back(relay, sim1, records, connect):
    """A session that came and went while the database was away is written afterwards."""
    records.down = True
    session = await connect()
    await asyncio.wait_for(session.configured.wait(), WAIT_S)
    await session.close()
    await until(lambda: not presence(relay, sim1).online, "it is offline")
    assert records.sessions() == []
    records.down = False
    await until(records.sessions, "it is written")
    assert records.sessions()[0].ended_at is not None


async def test_a_relay_that_has_never_read_the_records_says_so(records):
    """Without a first snapshot a robot hears not_ready, and comes again."""
    records.down = True
    async with running_relay(records) as relay:
        session = RobotSession(7, kind="session", session_key=SESSION_KEY)
        await session.connect(relay.relay.session_port)
        assert await ended(session) == "not_ready"
        await session.close()


async def test_a_stopping_relay_says_bye(records, sim1):
    """Stopping tells robots relay_stopping, within 3 s, also one that does not read."""
    async with running_relay(records) as relay:
        robot = FakeRobot(sim1.id, SESSION_KEY)
        await robot.start(relay.relay.session_port)
        begun = time.monotonic()
    assert time.monotonic() - begun < 3
    assert await ended(robot.session) == "relay_stopping"
    await robot.stop()
    assert records.sessions()[-1].end_code == "relay_stopping"


async def test_former_sessions_are_closed_at_the_start(records):
    """The first entry of a relay ends what a former one left open."""
    async with running_relay(records):
        await until(lambda: records.written, "something is written")
    assert type(records.written[0]).__name__ == "FormerSessions"
