"""The session's protocol, with a real pair of sockets in the place of SSH, and the clocks that it reports."""

import asyncio
import json
import socket
import time
from unittest.mock import Mock, call

import pytest
from fake_cloud import eventually
from robotether_agent import clock
from robotether_agent.clock import EpochClock, robot_time
from robotether_agent.fields import FieldError
from robotether_agent.problems import (
    ProtocolBrokenError,
    Retry,
    ServerSilentError,
    SessionEndedError,
)
from robotether_agent.tunnel.session import Session, SessionConfig, message_handlers

PORTS = {"ros": 20000, "video": 20001, "shell": None}
CONFIG = {
    "type": "config",
    "robot": "sim1",
    "ros_port": 20000,
    "video_port": 20001,
    "heartbeat_s": 0.1,
    "timeout_s": 0.4,
    "guard": {},
}


@pytest.mark.parametrize(
    ("line", "done"),
    [
        ({"type": "lease", "fence": 13, "held": True}, call.on_lease(13, held=True)),
        ({"type": "lease", "fence": 13}, call.on_lease(13, held=False)),
        ({"type": "stop", "id": "5f0c", "by": "ben"}, call.on_stop("5f0c", "ben")),
        ({"type": "stop"}, call.on_stop("", "somebody")),
        ({"type": "release", "id": "77aa", "by": "ann"}, call.on_release("77aa", "ann")),
    ],
)
def test_each_line_is_done_as_it_says(line, done):
    """What is missing is read in the way that stops the robot."""
    handler = Mock()
    message_handlers(handler)[line["type"]](line)
    assert handler.mock_calls == [done]


@pytest.mark.parametrize(
    "line",
    [
        {"type": "lease", "fence": -1, "held": True},
        {"type": "lease", "held": True},
        {"type": "lease", "fence": 2**63, "held": True},
        {"type": "lease", "fence": 1, "held": "yes"},
        {"type": "release"},
        {"type": "release", "id": "with blank"},
    ],
)
def test_broken_lines_do_nothing(line):
    """Nothing that would let somebody drive is guessed."""
    handler = Mock()
    with pytest.raises(FieldError):
        message_handlers(handler)[line["type"]](line)
    assert handler.mock_calls == []


class Peer:
    def __init__(self, reader, writer):
        self._reader = reader
        self._writer = writer

    def send(self, message):
        self.send_raw(json.dumps(message).encode() + b"\n")

    def send_raw(self, data):
        self._writer.write(data)

    async def receive(self, kind):
        while True:
            message = json.loads(await asyncio.wait_for(self._reader.readline(), 5))
            if message["type"] == kind:
                return message

    def close(self):
        self._writer.close()


@pytest.fixture
def drive_handler():
    return Mock()


@pytest.fixture
async def ends(drive_handler):
    ours, theirs = socket.socketpair()
    reader, writer = await asyncio.open_connection(sock=ours, limit=64 * 1024)
    peer_reader, peer_writer = await asyncio.open_connection(sock=theirs)
    session = Session(reader, writer, drive_handler=drive_handler)
    yield session, Peer(peer_reader, peer_writer)
    for each in (writer, peer_writer):
        each.close()
    await asyncio.gather(writer.wait_closed(), peer_writer.wait_closed(), return_exceptions=True)


@pytest.fixture
async def served(ends):
    session, peer = ends
    running = asyncio.ensure_future(session.run())
    yield session, peer
    peer.close()
    await asyncio.wait_for(running, 5)


async def test_pings_in_the_given_time_and_measures(served):
    session, peer = served
    peer.send(CONFIG)
    assert await session.new_config(None) == SessionConfig("sim1", PORTS, 0.1, 0.4, {})
    ping = await peer.receive("ping")
    peer.send({"type": "pong", "seq": ping["seq"], "t_ms": -1e9})
    assert (await peer.receive("ping"))["seq"] == ping["seq"] + 1
    assert 0 < session.rtt_ms < 5000
    assert abs(ping["t_ms"] / 1000 - time.clock_gettime(time.CLOCK_BOOTTIME)) < 5


async def test_heartbeats_are_slow_until_somebody_uses_the_robot(served):
    """A configuration without slow ones has the next go out at once."""
    session, peer = served
    idle = {**CONFIG, "timeout_s": 60, "idle_heartbeat_s": 50}
    peer.send(idle)
    first = await peer.receive("ping")
    config = await session.new_config(None)
    assert abs(session.idle_delay_s - 49.9) < 1e-6
    assert not session.is_used
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(peer.receive("ping"), 0.5)
    peer.send({**idle, "idle_heartbeat_s": None})
    assert [(await peer.receive("ping"))["seq"] - first["seq"] for _ in range(3)] == [1, 2, 3]
    assert (session.idle_delay_s, session.is_used) == (0, True)
    # Whoever follows the configuration for its forwards has nothing to do.
    assert session.config == config


async def test_what_was_sent_is_read_once_a_later_ping_is_answered(served):
    session, peer = served
    peer.send(CONFIG)
    first = await peer.receive("ping")
    session.send({"type": "help"})
    reading = asyncio.ensure_future(session.until_read())
    peer.send({"type": "pong", "seq": first["seq"], "t_ms": 0})
    later = await peer.receive("ping")
    assert not reading.done()
    peer.send({"type": "pong", "seq": later["seq"], "t_ms": 0})
    await asyncio.wait_for(reading, 5)


async def test_answers_pings_and_ignores_what_is_new(served):
    session, peer = served
    peer.send({"type": "dance", "why": "of a later version"})
    peer.send({"type": "pong", "seq": 12345})
    peer.send({"type": "ping", "seq": 41})
    assert await peer.receive("pong") == {"type": "pong", "seq": 41}
    assert session.rtt_ms is None


async def test_silence_ends_it(ends):
    session, peer = ends
    peer.send(CONFIG)
    with pytest.raises(ServerSilentError, match=r"silent for 0\.4 s") as silence:
        await asyncio.wait_for(session.run(), 5)
    assert silence.value.retry is Retry.SOON


async def test_a_robot_that_slept_does_not_blame_its_server(ends):
    """It is told apart from a relay that hangs, which the robot would leave."""
    session, peer = ends
    running = asyncio.ensure_future(session.run())
    peer.send(CONFIG)
    await session.new_config(None)
    time.sleep(1.0)  # noqa: ASYNC251 (nothing of this process is to run)
    with pytest.raises(ServerSilentError) as silence:
        await asyncio.wait_for(running, 5)
    assert silence.value.retry is Retry.AT_ONCE


async def test_messages_are_done_in_the_order_in_which_they_come(served, drive_handler):
    """Configuration, lease and stop reach the guard's supervisor at once, before anybody else learns of them."""
    session, peer = served
    peer.send({**CONFIG, "guard": {"key": "s3cret"}, "direct": True})
    peer.send({"type": "lease", "fence": 13, "held": False})
    peer.send({"type": "stop", "id": "5f0c", "by": "ben"})
    config = await session.new_config(None)
    assert (config.guard, config.direct) == ({"key": "s3cret"}, True)
    assert "s3cret" not in repr(config)
    calls = drive_handler.mock_calls
    await eventually(lambda: len(calls) == 3, lambda: f"{calls}")
    assert calls == [
        call.on_config({"key": "s3cret"}, direct=True),
        call.on_lease(13, held=False),
        call.on_stop("5f0c", "ben"),
    ]
    await peer.receive("ping")


async def test_a_server_that_takes_nothing_ends_it(ends):
    session, _ = ends

    def flood():
        for _ in range(1000):
            session.send({"type": "health", "detail": "x" * 10_000})

    with pytest.raises(ServerSilentError, match="no longer reads"):
        flood()


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"rubbish\n", "not JSON"),
        (b"{}\n", "field type is missing"),
        (b'{"type": "ping"}\n', "field seq is missing"),
        (json.dumps({**CONFIG, "ros_port": 0}).encode() + b"\n", "field ros_port"),
        (json.dumps({**CONFIG, "robot": "../x"}).encode() + b"\n", "field robot"),
        (json.dumps({**CONFIG, "timeout_s": 0}).encode() + b"\n", "field timeout_s"),
        (json.dumps({**CONFIG, "idle_heartbeat_s": 0}).encode() + b"\n", "field idle_heartbeat_s"),
        (json.dumps({**CONFIG, "guard": []}).encode() + b"\n", "guard must be a JSON object"),
        (json.dumps({**CONFIG, "direct": 1}).encode() + b"\n", "field direct"),
        (b'{"type": "checked", "ros": "splendid"}\n', "ros must be ok, down or unknown"),
        (b'{"type": "lease"}\n', "field fence is missing"),
        (b"x" * 200_000, "over 64 KiB"),
    ],
)
async def test_broken_lines_end_it(ends, line, why):
    session, peer = ends
    peer.send_raw(line)
    with pytest.raises(ProtocolBrokenError, match=why):
        await asyncio.wait_for(session.run(), 5)


@pytest.mark.parametrize(
    ("code", "retry", "advice"),
    [
        ("superseded", Retry.SLOWLY, "two robots use one key"),
        ("robot_disabled", Retry.SLOWLY, "enable the robot"),
        ("cell_draining", Retry.AT_ONCE, ""),
        ("rebalanced", Retry.AT_ONCE, ""),
        ("of_a_later_version", Retry.SOON, ""),
    ],
)
async def test_bye_keeps_code_and_detail(ends, code, retry, advice):
    session, peer = ends
    peer.send({"type": "bye", "code": code, "detail": "the\nreason"})
    with pytest.raises(SessionEndedError, match="the reason") as error:
        await asyncio.wait_for(session.run(), 5)
    assert error.value.code == code
    assert error.value.retry is retry
    assert advice in error.value.advice


def test_it_goes_on_while_the_robot_sleeps(monkeypatch):
    shown = {time.CLOCK_MONOTONIC: 5.0, time.CLOCK_BOOTTIME: 65.0}
    monkeypatch.setattr(clock.time, "clock_gettime", shown.get)
    assert robot_time() == 65.0


def test_a_later_session_has_a_greater_number(monkeypatch):
    now = [time.time_ns()]
    monkeypatch.setattr(clock.time, "time_ns", lambda: now[0])
    epochs = EpochClock()
    first = epochs.next()
    assert first == now[0] // 1_000_000
    now[0] -= 10**12
    assert [epochs.next(), epochs.next()] == [first + 1, first + 2]
    now[0] += 2 * 10**12
    assert epochs.next() == now[0] // 1_000_000 < 2**53
