"""The way of an operator's WebSocket through the real relay to a fake robot."""

from __future__ import annotations

import asyncio
import json
import time

import aiohttp
import pytest
from aiohttp import WSMsgType
from fake_robot import FakeRobot, Mode
from relay_server import MESSAGE_LIMIT, SESSION_KEY, MemoryRecords, RelayServer, until, utc
from robotether_server.relay.rosbridge import LONGEST_PATIENCE_S, patience_s
from robotether_server.relay.sessions import Presence
from robotether_server.store.fleet import Robot, User

PUBLISH = '{"op": "publish",  "topic": "/cmd_vel", "msg": {"linear": {"x": 0.5}}}'
BOB = User(2, "bob")


async def closing(socket: aiohttp.ClientWebSocketResponse) -> tuple[int | None, str]:
    """Read on until the relay closes; return code and reason."""
    # Not receive(timeout=...), which begins anew with each ping that it answers.
    async with asyncio.timeout(8):
        while (message := await socket.receive()).type is not WSMsgType.CLOSE:
            assert message.type not in {WSMsgType.CLOSED, WSMsgType.ERROR}, "closed without a code"
    return message.data, message.extra or ""


async def refusal(http: aiohttp.ClientSession, url: str, **headers: str) -> tuple[int, str]:
    """Try to open a WebSocket; return status and code of the refusal."""
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    async with http.get(url, headers=upgrade | headers) as answer:
        assert answer.content_type == "application/problem+json"
        problem = await answer.json()
        assert problem["status"] == answer.status
        return answer.status, problem["code"]


async def misbehaving(relay: RelayServer, sim1: Robot, mode: Mode) -> FakeRobot:
    robot = FakeRobot(sim1.id, SESSION_KEY, mode)
    await robot.start(relay.relay.session_port)
    return robot


async def test_text_passes_unchanged_both_ways(relay, robot, sim1, http):
    """A text message reaches the robot with every byte as it was, and comes back so."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await socket.send_str(PUBLISH)
        assert await socket.receive_str(timeout=5) == PUBLISH
    assert robot.received == [PUBLISH]


async def test_binary_passes_unchanged_for_a_driver(relay, robot, sim1, http):
    """Binary rubbish from a driver reaches rosbridge, whose business it is."""
    rubbish = bytes(range(256)) * 3
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await socket.send_bytes(rubbish)
        assert await socket.receive_bytes(timeout=5) == rubbish


async def test_a_message_as_large_as_the_limit_passes(relay, robot, sim1, http):
    """10 MB to the byte is allowed, in both directions."""
    message = '{"op": "publish", "msg": "' + "x" * (MESSAGE_LIMIT - 28) + '"}'
    assert len(message) == MESSAGE_LIMIT
    async with http.ws_connect(relay.ros_url(sim1), max_msg_size=0) as socket:
        await socket.send_str(message)
        assert await socket.receive_str(timeout=8) == message


async def test_a_message_over_the_limit_ends_that_connection_only(relay, robot, sim1, http):
    """11 MB close the sender with 1009 and a reason; another operator does not notice."""
    async with (
        http.ws_connect(relay.ros_url(sim1)) as other,
        http.ws_connect(relay.ros_url(sim1)) as socket,
    ):
        await socket.send_str('{"op": "publish", "msg": "' + "x" * 11 * 1024 * 1024 + '"}')
        assert await closing(socket) == (1009, "you sent a message over 10 MB")
        await other.send_str(PUBLISH)
        assert await other.receive_str(timeout=5) == PUBLISH


async def test_a_robots_message_over_the_limit_ends_with_1009(relay, robot, sim1, http):
    """A robot that sends more than the limit ends the connection, and the reason names it."""
    async with http.ws_connect(relay.ros_url(sim1), max_msg_size=0) as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        await robot.send_to_clients(b"x" * (MESSAGE_LIMIT + 1))
        assert await closing(socket) == (1009, "robot sim1 sent a message over 10 MB")


@pytest.mark.parametrize("rubbish", ["{", "", "[1]", '"publish"', "[" * 100_000, "{'op': 1}"])
async def test_broken_json_is_answered_and_the_robot_not_bothered(
    relay, robot, sim1, http, rubbish
):
    """Text that is no JSON object gets rosbridge's status error, and the connection goes on."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await socket.send_str(rubbish)
        status = await socket.receive_json(timeout=5)
        assert (status["op"], status["level"]) == ("status", "error")
        assert status["msg"].startswith("cannot read message: not JSON")
        await socket.send_str(PUBLISH)
        assert await socket.receive_str(timeout=5) == PUBLISH
    assert robot.received == [PUBLISH]


async def test_bytes_that_are_no_websocket_end_the_connection(relay, robot, sim1, http):
    """A frame with reserved bits closes with 1002."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        transport = socket.get_extra_info("socket")
        assert transport is not None
        socket._writer.transport.write(b"\xff\xff\xff\xff")
        code, reason = await closing(socket)
        assert (code, reason) == (1002, "you broke the WebSocket protocol")


async def test_an_observer_subscribes_and_looks_up_but_publishes_nothing(relay, robot, sim1, http):
    """What an observer may not send is answered with its id, and goes no further."""
    allowed = [
        {"op": "subscribe", "topic": "/pose"},
        {"op": "call_service", "service": "/rosapi/topics", "id": "s1"},
    ]
    refused = [
        {"op": "publish", "topic": "/cmd_vel", "id": "p1"},
        {"op": "call_service", "service": "/stop_motor", "id": "p2"},
        {"op": "advertise", "topic": "/cmd_vel", "id": "p3"},
    ]
    async with http.ws_connect(relay.ros_url(sim1, "observe", BOB)) as socket:
        for message in refused:
            await socket.send_json(message)
            status = await socket.receive_json(timeout=5)
            assert (status["op"], status["level"]) == ("status", "error")
            assert status["id"] == message["id"]
        await socket.send_bytes(b"\x16\x00\x00\x00bson")
        assert "JSON text only" in (await socket.receive_json(timeout=5))["msg"]
        for message in allowed:
            await socket.send_json(message)
            assert await socket.receive_json(timeout=5) == message
    assert [json.loads(text) for text in robot.received] == allowed


async def test_tickets_that_open_nothing(*, relay, robot, sim1, http, records, monkeypatch):
    """Each kind of bad ticket is refused over HTTP with its own code."""
    other = records.add_robot(8, "sim2", u1="observe")
    hidden = records.add_robot(9, "sim3")
    await until(lambda: 9 in relay.relay.fleet.known.robots, "the relay knows all robots")
    good = relay.ticket(sim1)
    base = f"{relay.url}/robots/sim1/ros"
    assert await refusal(http, base) == (401, "ticket_missing")
    assert await refusal(http, f"{base}?ticket=rubbish") == (401, "ticket_malformed")
    forged = good[:-3] + ("AAA" if not good.endswith("AAA") else "BBB")
    assert await refusal(http, f"{base}?ticket={forged}") == (401, "ticket_forged")
    foreign = relay.ticket(other, "observe")
    assert await refusal(http, f"{base}?ticket={foreign}") == (401, "ticket_foreign")
    assert await refusal(http, f"{relay.url}/robots/nosuch/ros?ticket={good}") == (
        404,
        "robot_unknown",
    )
    assert await refusal(http, f"{relay.url}/robots/sim3/ros?ticket={relay.ticket(hidden)}") == (
        404,
        "robot_unknown",
    )
    drive = relay.ticket(other, "drive")
    assert await refusal(http, f"{relay.url}/robots/sim2/ros?ticket={drive}") == (
        403,
        "grant_missing",
    )
    assert robot.clients_ever == 0


async def test_an_old_ticket_is_expired(relay, robot, sim1, http, monkeypatch):
    """A ticket older than its 30 s is refused with ticket_expired."""
    url = relay.ros_url(sim1)
    later = time.time() + 31
    monkeypatch.setattr("itsdangerous.timed.time.time", lambda: later)
    assert await refusal(http, url) == (401, "ticket_expired")
    assert robot.clients_ever == 0


async def test_a_ticket_opens_one_connection(relay, robot, sim1, http):
    """A replayed ticket is refused, while what it opened goes on."""
    url = relay.ros_url(sim1)
    async with http.ws_connect(url) as socket:
        assert await refusal(http, url) == (401, "ticket_used")
        await socket.send_str(PUBLISH)
        assert await socket.receive_str(timeout=5) == PUBLISH


async def test_pages_of_other_sites_are_refused(relay, robot, sim1, http):
    """Only this site's own pages and listed origins may connect; the ticket is not used up."""
    url = relay.ros_url(sim1)
    for origin in ("https://evil.example", "null", "http://127.0.0.1:1", "https://["):
        assert await refusal(http, url, Origin=origin) == (403, "origin_refused")
    async with http.ws_connect(url, origin="https://lab.example"):
        pass
    async with http.ws_connect(relay.ros_url(sim1), origin=relay.url):
        pass


async def test_a_request_without_upgrade_does_not_use_the_ticket(relay, robot, sim1, http):
    """A plain GET is told to use a WebSocket, and the ticket still opens one."""
    url = relay.ros_url(sim1)
    async with http.get(url) as answer:
        assert answer.status == 426
    async with http.ws_connect(url):
        pass


async def test_an_offline_robot_is_told_within_a_second(relay, sim1, http):
    """The connection of a robot that was never there closes with 4503 and says so."""
    begun = time.monotonic()
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        code, reason = await closing(socket)
    assert (code, reason) == (4503, "robot sim1 is offline: it has not connected yet")
    assert time.monotonic() - begun < 1


async def test_an_offline_robot_says_since_when(relay, robot, sim1, http):
    """After a robot's session ended, the reason names the time."""
    await robot.stop()
    await until(lambda: not relay.relay.registry.presence(sim1.id).online, "sim1 is offline")
    since = relay.relay.registry.presence(sim1.id).since
    assert since is not None
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert await closing(socket) == (
            4503,
            f"robot sim1 is offline since {since.strftime('%H:%M')} UTC",
        )


async def test_a_rosbridge_that_does_not_answer_is_told_within_a_second(relay, sim1, http):
    """A tunnel to nothing closes with 4504."""
    robot = await misbehaving(relay, sim1, "no_rosbridge")
    begun = time.monotonic()
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        code, reason = await closing(socket)
    assert code == 4504
    assert reason.startswith("rosbridge on robot sim1 does not answer")
    assert time.monotonic() - begun < 1
    await robot.stop()


async def test_a_tunnel_without_its_port_is_told_within_a_second(relay, robot, sim1, http):
    """A session whose forward never opened closes with 4504, after a short patience."""
    await robot._close_ports()
    begun = time.monotonic()
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert (await closing(socket))[0] == 4504
    assert 0.5 < time.monotonic() - begun < 1


async def test_a_lost_tunnel_ends_its_connections_at_once(relay, robot, sim1, http):
    """When the robot's session ends, operators hear 4505, though their TCP to the robot lives."""
    robot.mode = "port_taken"
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        await robot.session.close()
        begun = time.monotonic()
        assert await closing(socket) == (4505, "the link to robot sim1 is lost")
        assert time.monotonic() - begun < 0.25


async def test_a_tunnel_whose_port_dies_first_is_still_a_lost_link(relay, robot, sim1, http):
    """Rosbridge's connection breaks a moment before the session: that is 4505, not 4504."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        for client in list(robot.clients):
            client._req.transport.abort()
        await robot.session.close()
        assert (await closing(socket))[0] == 4505


async def test_a_rosbridge_that_goes_away_is_down(relay, robot, sim1, http):
    """Rosbridge closes while the tunnel lives: 4504."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        for client in list(robot.clients):
            await client.close()
        assert await closing(socket) == (
            4504,
            "rosbridge on robot sim1 does not answer: it closed the connection",
        )


async def test_a_robot_that_breaks_off_mid_message(relay, sim1, http):
    """Half a frame and a reset end with 4504; nothing of the half message arrives."""
    robot = await misbehaving(relay, sim1, "drops_mid_message")
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert (await closing(socket))[0] == 4504
    await robot.stop()


async def test_a_robot_that_reads_nothing_is_down(relay, sim1, http):
    """A rosbridge that takes nothing any more ends with 4504, and memory stays bounded."""
    robot = await misbehaving(relay, sim1, "slow_reader")
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        message = '{"op": "publish", "msg": "' + "x" * 1_000_000 + '"}'
        sending = asyncio.create_task(_send_until_closed(socket, message))
        code, reason = await closing(socket)
        assert (code, reason) == (
            4504,
            "rosbridge on robot sim1 does not answer: it took nothing for 1 s",
        )
        await sending
    await robot.stop()


async def _send_until_closed(socket: aiohttp.ClientWebSocketResponse, message: str) -> None:
    try:
        for _ in range(100):
            await socket.send_str(message)
    except ConnectionError:
        return


async def test_a_silent_client_is_let_go(relay, robot, sim1, http):
    """No pong and no message for the limit closes with 4408."""
    async with http.ws_connect(relay.ros_url(sim1), autoping=False) as socket:
        assert await closing_without_pong(socket) == 4408
    await until(lambda: not robot.clients, "the robot's side is closed too")


async def closing_without_pong(socket: aiohttp.ClientWebSocketResponse) -> int | None:
    async with asyncio.timeout(8):
        while (message := await socket.receive()).type is WSMsgType.PING:
            pass
    assert message.type is WSMsgType.CLOSE
    return message.data


async def test_a_client_that_answers_pings_stays(relay, robot, sim1, http):
    """Pongs alone keep a quiet connection open beyond the limit."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(socket.receive(), 1.5)
        await socket.send_str(PUBLISH)
        assert await socket.receive_str(timeout=5) == PUBLISH


async def test_a_clients_own_ping_is_answered(relay, robot, sim1, http):
    """The relay answers pings of the client with the same payload."""
    async with http.ws_connect(relay.ros_url(sim1), autoping=False) as socket:
        await socket.ping(b"hello")
        while (message := await socket.receive(timeout=5)).type is WSMsgType.PING:
            pass
        assert (message.type, message.data) == (WSMsgType.PONG, b"hello")


async def test_a_client_that_never_reads_is_bounded_and_ends(relay, sim1, http):
    """A flood to a client that does not read stops at the robot, and ends with client_slow."""
    robot = await misbehaving(relay, sim1, "floods")
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        socket._response.connection.transport.pause_reading()
        await until(
            lambda: b'client_slow"} 1.0' in relay.relay.metrics.render(), "the client is let go"
        )
        passed_on = relay.relay.traffic.bytes_to_client
        socket._response.connection.transport.abort()
    # All that the kernel's buffers on the way take, and no more.
    assert passed_on < 40 * 1024 * 1024
    await robot.stop()


async def test_ended_rights_end_the_connection(relay, robot, sim1, http, records):
    """Taking a grant away closes with 4001; another user's connection goes on."""
    async with (
        http.ws_connect(relay.ros_url(sim1)) as socket,
        http.ws_connect(relay.ros_url(sim1, "observe", BOB)) as other,
    ):
        await until(lambda: len(robot.clients) == 2, "both have reached rosbridge")
        del records.grants[1, sim1.id]
        assert await closing(socket) == (4001, "your rights on robot sim1 have ended or changed")
        await other.send_json({"op": "subscribe"})
        assert await other.receive_json(timeout=5) == {"op": "subscribe"}


async def test_a_driver_who_may_only_observe_now_is_ended(relay, robot, sim1, http, records):
    """A grant lowered from drive to observe ends the drive connection."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        records.grants[1, sim1.id] = "observe"
        assert (await closing(socket))[0] == 4001


async def test_open_connections_go_on_without_a_database(relay, robot, sim1, http, records):
    """With the database away an open connection goes on, and a ticket still opens a new one."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        records.down = True
        await until(lambda: not relay.relay.fleet.store_up, "the relay has noticed")
        await socket.send_str(PUBLISH)
        assert await socket.receive_str(timeout=5) == PUBLISH
        async with http.ws_connect(relay.ros_url(sim1)) as second:
            await second.send_str(PUBLISH)
            assert await second.receive_str(timeout=5) == PUBLISH


async def test_drive_connections_are_in_the_audit_log(relay, robot, sim1, http, records):
    """Beginning and end of a drive connection are written with user, robot and address."""
    async with http.ws_connect(relay.ros_url(sim1), headers={"X-Forwarded-For": "203.0.113.9"}):
        await until(lambda: robot.clients, "the operator has reached rosbridge")
    await until(lambda: len(_audit(records)) == 2, "both lines are written")
    began, ended = _audit(records)
    assert (began.kind, began.actor, began.robot) == ("drive_began", "ann", "sim1")
    assert began.address == "203.0.113.9"
    assert (ended.kind, ended.details["end_code"]) == ("drive_ended", "client_left")


async def test_waiting_for_an_offline_robot_is_no_driving(relay, sim1, http, records):
    """A page that tries again and again leaves no audit lines, and is shown to nobody."""
    with relay.relay.board.followed_by(1) as feed:
        feed.first()
        for _ in range(3):
            async with http.ws_connect(relay.ros_url(sim1)) as socket:
                assert (await closing(socket))[0] == 4503
        assert feed.take() == []
    await relay.relay.journal.flush(5)
    assert _audit(records) == []


def _audit(records: MemoryRecords) -> list:
    return [entry for entry in records.written if hasattr(entry, "actor")]


async def test_the_robot_learns_that_the_operator_left(relay, robot, sim1, http):
    """Closing the operator's side closes rosbridge's connection at once."""
    async with http.ws_connect(relay.ros_url(sim1)):
        await until(lambda: robot.clients, "the operator has reached rosbridge")
    await until(lambda: not robot.clients, "rosbridge's connection is closed", within_s=0.5)


async def test_an_operator_who_vanishes_frees_the_robot(relay, robot, sim1, http):
    """A reset of the operator's TCP closes rosbridge's connection at once."""
    socket = await http.ws_connect(relay.ros_url(sim1))
    await until(lambda: robot.clients, "the operator has reached rosbridge")
    socket._response.connection.transport.abort()
    await until(lambda: not robot.clients, "rosbridge's connection is closed", within_s=0.5)
    assert relay.relay.connections.count("drive") == 0


def test_patience_grows_with_the_distance_and_is_bounded():
    """A robot 100 ms away gets longer to answer; nobody waits for ever."""
    near, far = Presence(rtt_ms=1.0), Presence(rtt_ms=100.0)
    assert patience_s(near) < 0.85 < patience_s(far) < 2
    assert patience_s(Presence(rtt_ms=60_000.0)) == LONGEST_PATIENCE_S
    assert patience_s(Presence(since=utc(2026, 1, 1))) < 0.85
