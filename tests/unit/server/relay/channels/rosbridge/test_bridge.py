"""Messages between operators, a fake robot and the real relay, and what ends their connections."""

import asyncio
import contextlib
import struct

import pytest
from aiohttp import WSMsgType
from fake_robot import WAIT_S
from relay_clients import PUBLISH, audit_lines, closing, counted_turns
from relay_server import BOB, IMPATIENT, MESSAGE_LIMIT, until
from robotether_server.relay.channels.rosbridge import bridge
from robotether_server.relay.channels.rosbridge.message_validator import STOP
from robotether_server.relay.http import close_reasons, event_loop


async def _flood(socket, data, kind=WSMsgType.TEXT):
    with contextlib.suppress(ConnectionError):
        while not socket.closed:
            for _ in range(100):
                await socket.send_frame(data, kind)
            await asyncio.sleep(0.01)


def large(size):
    begin, end = '{"op":"publish","topic":"/map","msg":{"data":"', '"}}'
    return begin + "x" * (size - len(begin) - len(end)) + end


@pytest.mark.usefixtures("no_command_is_late")
async def test_a_driver_does_not_wait_for_what_observers_take(robot, monkeypatch, ros):
    monkeypatch.setattr(event_loop, "LARGE_BYTES_PER_S", MESSAGE_LIMIT)
    async with ros("observe", BOB, max_msg_size=0) as observer:
        await robot.connections(1)
        observed = asyncio.create_task(observer.receive_str(timeout=20))
        await robot.send_to_clients(b"x" * MESSAGE_LIMIT)
        async with ros() as socket:
            await socket.send_str(PUBLISH)
            assert await socket.receive_str(timeout=WAIT_S) == PUBLISH
        assert not observed.done()
        assert len(await observed) == MESSAGE_LIMIT


async def test_a_tunnel_whose_port_dies_first_is_still_a_lost_link(robot, monkeypatch, ros):
    # The moment below may be longer on a machine that stands still in it.
    monkeypatch.setattr(bridge, "LINK_GRACE_S", 3.0)
    async with ros() as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        for client in list(robot.clients):
            client._req.transport.abort()
        # The moment between, in which the relay must not yet have judged.
        await asyncio.sleep(0.1)
        await robot.session.close()
        assert (await closing(socket))[0] == 4505


async def test_a_stop_overtakes_what_waits_for_the_robot(wide, relay, start_robot, ros):
    """What its sender sent before it can take seconds on a full line."""
    robot = await start_robot(relay, "slow_reader")
    async with ros(max_msg_size=0) as socket:
        await robot.connections(1)
        await socket.send_str(large(MESSAGE_LIMIT))
        await socket.send_str(PUBLISH)
        async with asyncio.timeout(5):
            await socket.send_str('{"op": "robotether.stop"}')
            assert (await closing(socket))[0] == 4003


async def test_a_stop_overtakes_what_its_sender_does_not_read(relay, robot, sim1, ros):
    """Neither refusals nor pongs hold it up; these have over 64 KB."""
    async with ros(max_msg_size=0) as socket:
        await robot.connections(1)
        transport = socket._response.connection.transport
        transport.pause_reading()
        await robot.send_to_clients(b"x" * MESSAGE_LIMIT)
        await until(lambda: relay.relay.traffic.bytes_to_client, "it waits for the client")
        for _ in range(10):
            await socket.send_json({"op": "nope", "id": "\N{DEGREE SIGN}" * 1024})
        for _ in range(80):
            await socket.ping(b"x" * 125)
        await socket.send_str('{"op": "robotether.stop"}')
        stopped = relay.relay.control.describe
        await until(lambda: stopped(sim1.id).stopped, "the robot is stopped", 5)
        transport.abort()


async def test_nothing_passes_behind_a_stop(relay, robot, sim1, ros):
    async with ros() as socket:
        await robot.connections(1)
        await socket.send_str('{"op": "robotether.stop"}')
        for _ in range(3):
            await socket.send_str('{"op": "call_service", "service": "/dock", "args": {}}')
            await socket.send_str(PUBLISH)
        assert (await closing(socket))[0] == 4003
    assert relay.relay.control.describe(sim1.id).stopped
    assert robot.received == []


async def test_a_stop_counts_as_its_connection_ends(relay, robot, sim1, ros):
    async with ros() as socket:
        await robot.connections(1)
        await socket.send_str('{"op": "robotether.stop"}')
        relay.relay.control.leasing.revoke(sim1.id, close_reasons.lease_lost("sim1", "ben"))
        assert (await closing(socket))[0] == 4010
    assert relay.relay.control.describe(sim1.id).stopped


async def test_what_overtakes_is_a_stop_alone(wide, relay, start_robot, ros):
    robot = await start_robot(relay, "slow_reader")
    named = [f'{{"op":"advertise","topic":"/{n}","type":"{STOP}"}}' for n in range(1500)]
    async with ros() as socket:
        await robot.connections(1)
        sending = asyncio.create_task(_send_all(socket, [large(MESSAGE_LIMIT), *named]))
        await until(lambda: relay.relay.traffic.bytes_to_robot, "the line is full")
        (client,) = robot.clients
        client._req.transport.resume_reading()
        received = [await client.receive_str(timeout=20) for _ in range(1 + len(named))]
        await sending
    assert received[1:] == named


async def _send_all(socket, messages):
    with contextlib.suppress(ConnectionError):
        for message in messages:
            await socket.send_str(message)


@pytest.mark.parametrize("kind", [WSMsgType.PING, WSMsgType.PONG])
async def test_a_flood_of_pings_or_pongs_ends_it(robot, monkeypatch, kind, ros):
    """They reach no check of messages, and answering them costs the others time, too."""
    monkeypatch.setattr(bridge, "FLOOD_AFTER_S", 0.3)
    async with ros("observe", BOB) as bob:
        flood = asyncio.create_task(_flood(bob, b"", kind))
        assert (await closing(bob))[0] == 1008
        await flood


@pytest.mark.parametrize("sender", ["client", "robot"])
async def test_others_have_a_turn_between_what_comes_at_once(robot, monkeypatch, sender, ros):
    """Else who sends thousands of small messages holds up the commands of every driver."""
    seen = []
    async with ros() as socket, counted_turns() as turns:
        await until(lambda: robot.clients, "the operator has reached rosbridge")
        (client,) = robot.clients
        if sender == "client":
            monkeypatch.setattr(bridge.Bridge, "_on_pong", lambda *_: seen.append(turns()))
            # Masked with zeros.
            socket._writer.transport.write(b"\x8a\x80\0\0\0\0" * 2000)
        else:
            send = bridge.Bridge._send_to_client
            monkeypatch.setattr(
                bridge.Bridge, "_send_to_client", lambda *args: seen.append(turns()) or send(*args)
            )
            client._req.transport.write(b"\x81\x02{}" * 2000)
        await until(lambda: len(seen) >= 2000, "all have come")
    assert len(set(seen)) > 10


@pytest.mark.parametrize("timing", [IMPATIENT])
async def test_a_client_that_never_reads_is_bounded_and_ends(relay, robot, ros):
    async def flood():
        while robot.clients:
            await robot.send_to_clients(b"x" * 65536)

    async with ros("observe", BOB) as socket:
        await until(lambda: robot.clients, "the observer has reached rosbridge")
        socket._response.connection.transport.pause_reading()
        flooding = asyncio.create_task(flood())
        await until(
            lambda: b'client_slow"} 1.0' in relay.relay.metrics.render(), "the client is let go"
        )
        passed_on = relay.relay.traffic.bytes_to_client
        socket._response.connection.transport.abort()
        await flooding
    # All that the kernel's buffers on the way take, and no more.
    assert passed_on < 40 * 1024 * 1024


async def test_the_slowest_observer_goes_when_all_have_too_much_to_read(
    relay, robot, sim1, monkeypatch, ros
):
    """Else large messages to slow observers of many robots take all the memory; a driver's do not count."""
    monkeypatch.setattr(bridge, "MAX_OBSERVERS_BYTES", int(1.5 * MESSAGE_LIMIT))
    async with (
        ros() as ann,
        ros("observe", BOB) as first,
        ros("observe", BOB) as second,
    ):
        await robot.connections(3)
        transports = [socket._response.connection.transport for socket in (ann, first, second)]
        for transport in transports:
            transport.pause_reading()
        sending = asyncio.create_task(robot.send_to_clients(b"x" * MESSAGE_LIMIT))
        await until(lambda: b'client_slow"} 1.0' in relay.relay.metrics.render(), "one is let go")
        assert len(relay.relay.traffic.taking) == 1
        assert relay.relay.control.driver(sim1.id) == "ann"
        for transport in transports:
            transport.abort()
        await sending
    await until(lambda: not relay.relay.traffic.taking, "nobody takes anything")


@pytest.mark.parametrize(
    ("frames", "name"),
    [
        ([struct.pack("!H", 1000)], "client_left"),
        # As a browser's page closes without a code.
        ([b""], "client_left"),
        ([struct.pack("!H", 4000)], "control_given_up"),
        ([], "client_vanished"),
    ],
)
async def test_a_client_that_closes_and_cuts_has_left(
    *, relay, robot, memory_database, frames, name, ros
):
    """Who says goodbye and does not wait for the answer has not vanished; the robot learns of both."""
    socket = await ros()
    await until(lambda: robot.clients, "the operator has reached rosbridge")
    for frame in frames:
        await socket.send_frame(frame, WSMsgType.CLOSE)
    socket._response.connection.transport.abort()
    await until(lambda: len(audit_lines(memory_database)) == 2, "the end is written")
    assert audit_lines(memory_database)[1].details["end_code"] == name
    await until(lambda: not robot.clients, "rosbridge's connection is closed")
    assert relay.relay.connections.count("drive") == 0


async def test_who_sends_no_clock_sync_sees_none_of_it(relay, guarded, sim1, ros, program):
    async with program("observe", BOB) as bob:
        async with ros():
            await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        await bob.send(op="subscribe", topic="/a")
        assert (await bob.until("subscribe"))["topic"] == "/a"
        assert bob.messages == []


async def test_the_driver_reads_how_old_is_what_they_see(relay, guarded, sim1, program):
    async with (
        program() as ann,
        program("observe", BOB) as bob,
    ):
        for operator in (ann, bob):
            await operator.send(op="robotether.clock_sync", t_ms=1, key="k")
            await operator.until("robotether.clock_sync")
        await until(lambda: relay.relay.registry.robot(sim1.id).newest_drive, "the drive began")
        guarded.session.send(type="seen", fence=2, ages_ms=[999.0])
        guarded.session.send(type="seen", fence=1, ages_ms=[])
        guarded.session.send(type="seen", fence=1, ages_ms=[120.5, 140.2, 130.0])
        seen = await ann.until("robotether.seen")
        unlimited = {"max_speed_m_s": None, "max_turn_rad_s": None}
        assert seen == {"op": "robotether.seen", "age_ms": 140.2, **unlimited, "key": "k"}
        slowed = {"slowed_s": 0.4, "max_speed_m_s": 0.52, "max_turn_rad_s": 1.1}
        guarded.session.send(type="seen", fence=1, ages_ms=[None, 120.5], **slowed)
        seen = await ann.until("robotether.seen")
        assert (seen["age_ms"], seen["max_speed_m_s"], seen["max_turn_rad_s"]) == (None, 0.52, 1.1)
        relay.relay.control.stops.stop(sim1, "carl")
        await bob.until("robotether.control")
        assert all(message["op"] != "robotether.seen" for message in bob.messages)


async def test_a_report_of_the_guard_that_changes_no_control_brings_none(
    guarded, relay, sim1, program
):
    async with program("observe", BOB) as bob:
        await bob.send(op="robotether.clock_sync", t_ms=1)
        await bob.until("robotether.control")
        reported = asyncio.Event()
        with relay.relay.control.watched(sim1.id, reported.set):
            guarded.session.send_guard_status(old=1)
            await reported.wait()
        bob.messages.clear()
        for t_ms in (2, 3):
            await bob.send(op="robotether.clock_sync", t_ms=t_ms)
            await bob.until("robotether.clock_sync")
        assert all(message["op"] != "robotether.control" for message in bob.messages)


async def test_who_repeats_a_stop_is_answered_too(guarded, program):
    """A program that has no other word of it would stop the robot again and again."""
    async with program("observe", BOB) as bob:
        for key in ("first", "second"):
            await bob.send(op="robotether.clock_sync", t_ms=1, key=key)
        await bob.send(op="robotether.stop")
        stopped = None
        while not stopped or not stopped["confirmed"]:
            stopped = (await bob.until("robotether.control"))["control"]["stopped"]
        await bob.send(op="robotether.stop")
        answer = await bob.until("robotether.control")
        assert (answer["control"]["stopped"]["by"], answer["key"]) == ("bob", "second")
