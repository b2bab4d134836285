"""Viewers of cameras over the frames protocol, through the real relay from a robot's frames service."""

import asyncio
import contextlib

import aiohttp
import pytest
from relay_clients import closing, refusal
from relay_server import ANN, BOB, IMPATIENT, until
from robotether_server.db.fleet import RelayUser
from robotether_server.relay.robots.delivered_frames import NamedFrame

JPEG = b"\xff\xd8" + b"picture" * 100 + b"\xff\xd9"


def frames_url(relay, robot, query):
    return f"{relay.url}/robots/{robot.name}/video/frames?{query}"


async def test_who_is_slow_skips_and_slows_no_one(camera, watch, relay):
    quick, slow = await watch(), await watch(BOB)
    await camera.wait_for("credit")
    await slow.credit()
    sent = []
    for turn in range(10):
        await quick.credit()
        sent.append(await camera.show(JPEG + bytes([turn])))
        assert (await quick.frame()).sequence == sent[-1]
        if turn == 0:
            assert (await slow.frame()).sequence == sent[0]
    await slow.credit()
    assert (await slow.frame()).sequence == sent[-1]
    assert relay.relay.feeds.traffic.skipped == 8
    ann, bob = map(relay.relay.registry.robot(7).viewer_stats.of, (ANN.id, BOB.id))
    assert (ann.frames, bob.frames, bob.bytes) == (10, 2, 2 * (len(JPEG) + 1))
    assert bob.viewed_s > 0


async def test_only_frames_that_a_driver_was_sent_can_be_named(camera, watch, relay):
    """They have the number that the viewer got; skipped frames do not count, nor do those of observers."""
    driver, observer = await watch(), await watch(BOB)
    await camera.wait_for("credit")
    await driver.credit()
    await observer.credit()
    camera.sequence = 70
    await camera.show(JPEG)
    first = (await driver.frame()).sequence
    await camera.show(JPEG + b"2")
    frames = relay.relay.feeds.traffic.by_codec["jpeg"]
    await until(lambda: frames.frames_in == 2, "the relay has another one")
    delivered = relay.relay.registry.robot(7).delivered_frames
    assert delivered.robots(ANN.id, NamedFrame("/a", first)) == NamedFrame("/a", 71)
    assert delivered.robots(ANN.id, NamedFrame("/a", first + 1)).frame is None
    await observer.frame()
    assert delivered.robots(BOB.id, NamedFrame("/a", first)).frame is None


async def test_an_observer_takes_nothing_from_who_drives(camera, watch, ros):
    observer = {"quality_min": 1, "quality_max": 100, "fps": 60, "latency_ms": 50, "width": None}
    await watch(BOB, **observer)
    await camera.wait_for("stream_request", **observer)
    driver = {"quality_min": 60, "fps": 15, "latency_ms": 400, "width": 640, "height": 480}
    await watch(**driver)
    async with ros():
        await camera.wait_for("stream_request", quality_max=80, **driver)
    await until(lambda: camera.of("stream_request")[-1]["fps"] == 60, "both count again")


async def test_a_viewer_that_cannot_decode_requests_a_key_frame(camera, watch):
    """Nothing that it cannot decode comes before; the agent limits how many it makes."""
    viewer = await watch(codecs=["h264"])
    await camera.wait_for("credit")
    await viewer.credit(2)
    await camera.show(b"key", codec=2, is_key=True)
    await viewer.frame()
    await viewer.socket.send_json({"op": "key_frame"})
    await camera.wait_for("key_frame")
    await camera.show(b"depends", codec=2)
    await camera.show(b"key", codec=2, is_key=True)
    assert (await viewer.frame()).jpeg == b"key"


async def test_a_credit_that_does_not_say_which_context_the_oldest(camera, viewer):
    """A simple program counts, and reads no numbers."""
    await viewer.credit(2)
    for _ in range(5):
        sequence = await camera.show(JPEG)
        await viewer.frame()
        await viewer.credit(taken=None)
        await camera.wait_for("credit", taken=sequence)


async def test_no_more_than_eight_credits_are_open(camera, watch):
    viewer, other = await watch(), await watch(BOB)
    await camera.wait_for("credit")
    await viewer.credit(100)
    for _ in range(10):
        await other.credit()
        sequence = await camera.show(JPEG)
        assert (await other.frame()).sequence == sequence
    assert [(await viewer.frame()).sequence for _ in range(8)] == [*range(1, 9)]
    await viewer.credit()
    assert (await viewer.frame()).sequence == sequence


@pytest.mark.parametrize("timing", [IMPATIENT])
async def test_a_silent_viewer_is_let_go(camera, watch):
    viewer = await watch(autoping=False)
    async with asyncio.timeout(5):
        while (message := await viewer.socket.receive()).type is not aiohttp.WSMsgType.CLOSE:
            assert message.type is aiohttp.WSMsgType.PING
    assert message.data == 4408


@pytest.mark.parametrize("timing", [IMPATIENT])
async def test_a_viewer_that_takes_nothing_is_bounded_and_let_go(camera, watch, relay):
    stuck, quick = await watch(), await watch(BOB)
    await camera.wait_for("credit")
    frame = b"x" * 2_000_000
    stuck.socket._response.connection.transport.pause_reading()
    for _ in range(20):
        if not stuck.socket.closed:
            await stuck.socket.send_json({"op": "credit", "frames": 2})
        await quick.credit()
        sequence = await camera.show(frame)
        assert (await quick.frame()).sequence == sequence
    sent = relay.relay.registry.robot(7).viewer_stats.of(ANN.id)
    assert sent.frames <= 4
    # The other one is there and answers pings.
    answering = asyncio.create_task(quick.socket.receive())
    await until(lambda: relay.relay.connections.count("video") == 1, "it is let go")
    answering.cancel()
    stuck.socket._response.connection.transport.resume_reading()


@pytest.mark.parametrize("message", ["text", "ping", "binary"])
async def test_a_flood_of_messages_ends_it(camera, watch, message):
    """A viewer cannot keep the relay busy: with pings, which are answered, or with what nobody reads."""
    socket = (await watch()).socket
    send, data = {
        "text": (socket.send_str, '{"op":"clock_sync","t_ms":1}'),
        "ping": (socket.ping, b"x"),
        "binary": (socket.send_bytes, b"x"),
    }[message]
    with contextlib.suppress(ConnectionError):
        for _ in range(1000):
            await send(data)
    code, reason = await closing(socket)
    assert (code, "messages a second" in reason) == (1002, True)


async def test_what_nobody_knows_is_skipped(camera, watch):
    """Either side may be newer."""
    viewer = await watch(codecs=["h264"])
    await camera.wait_for("credit")
    await viewer.socket.send_json({"op": "dance"})
    await viewer.socket.send_bytes(b"binary")
    await camera.send_text({"op": "dance"})
    await camera.show(JPEG, codec=9)
    await camera.wait_for("credit", taken=1)
    await viewer.credit()
    sequence = await camera.show(JPEG)
    assert (await viewer.frame()).sequence == sequence


async def test_who_may_not_see_gets_a_status(*, camera, relay, sim1, http, memory_database, login):
    """A page of this site needs no ticket but its login."""
    async with http.ws_connect(frames_url(relay, sim1, "topic=/a"), headers=login) as socket:
        await socket.send_json({"op": "clock_sync", "t_ms": 5})
        assert (await socket.receive_json())["t_ms"] == 5
    stranger = memory_database.add_credential("login", RelayUser(9, "eve"))
    used = f"topic=/a&ticket={relay.ticket(sim1)}"
    await (await http.ws_connect(frames_url(relay, sim1, used))).close()
    for headers, query, expected in [
        ({}, "topic=/a", 401),
        ({}, used, 401),
        (login | {"Origin": "https://evil.example"}, "topic=/a", 403),
        ({"Cookie": f"__Host-robotether_login={stranger}"}, "topic=/a", 404),
        ({}, f"ticket={relay.ticket(sim1)}", 422),
        ({}, f"topic=&ticket={relay.ticket(sim1)}", 422),
        ({}, f"topic=%0a&ticket={relay.ticket(sim1)}", 422),
    ]:
        assert await refusal(http, frames_url(relay, sim1, query), headers) == expected
    assert camera.topics == []
