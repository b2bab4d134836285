"""What fills a robot's uplink, as the API shows it."""

import asyncio
import struct

import pytest
from relay_server import ANN, BOB, until
from robotether_server.db.fleet import RECORDER
from robotether_server.relay.robots import uplink
from robotether_server.relay.robots.uplink import LINE_RATE_KEPT_S, Uplink

UPLINK = "/api/v1/robots/sim1/uplink"


@pytest.fixture
def show(relay, http, memory_database):
    async def ask(user):
        headers = memory_database.bearer(user)
        async with http.get(relay.url + UPLINK, headers=headers) as answer:
            return answer.status, await answer.json()

    return ask


def stream_of(body, kind):
    [stream] = [stream for stream in body["streams"] if stream["kind"] == kind]
    return stream


async def test_a_message_counts_while_it_is_on_the_way(relay, robot, sim1, show, ros):
    """A large map fills the uplink long before its last byte has come."""
    sockets = [await ros("observe", user) for user in (ANN, BOB)]
    for socket in (*sockets, sockets[1]):
        await socket.send_json({"op": "subscribe", "topic": "/map"})
    topics = relay.relay.registry.robot(sim1.id).topics
    await until(
        lambda: [topic.user_ids() for topic in topics.values()] == [{1, 2}], "both share it"
    )
    await until(lambda: robot.topics, "the robot sends it")
    header = struct.pack("!BBQ", 0x81, 127, 10_000_000)
    robot.topics[0]._req.transport.write(header + b"x" * 3_000_000)
    status, body = await show(BOB)
    assert status == 200
    stream = stream_of(body, "topic")
    assert stream["bytes_per_s"] > 100_000
    assert (stream["name"], stream["people"], stream["yours"]) == ("/map", 2, True)
    assert stream_of(body, "rosbridge")["people"] == 2
    assert "ann" not in str(body)
    for socket in sockets:
        await socket.close()


async def test_what_the_line_carries_is_what_the_robot_says(robot, show, monkeypatch):
    """A web_video_server answers with something else."""
    monkeypatch.setattr(uplink, "LINE_RATE_KEPT_S", 0.0)
    for answer, rate in (
        ('{"bytes_per_s": 120000}', 120000),
        ('{"bytes_per_s": null}', None),
        ("<h1>no such page</h1>", None),
        ("x" * 1000, None),
    ):
        robot.line_answer = answer
        assert (await show(ANN))[1] == {"streams": [], "line_bytes_per_s": rate}


async def test_a_rate_is_that_of_the_last_seconds():
    """What the kernel does not say is not measured; the recorder is no person, but said to read."""
    now_s, received = 100.0, 0
    uplink = Uplink(lambda: now_s)
    with uplink.counted("topic", "/scan", lambda: received, lambda: {1, RECORDER.id}):
        for _ in range(20):
            now_s, received = now_s + 1, received + 500
            [stream] = await uplink.measured(1)
        assert stream.bytes_per_s == 500
        now_s += 5
        [stream] = await uplink.measured(2)
        assert stream.bytes_per_s == 0
        assert (stream.people, stream.yours, stream.recorded) == (1, False, True)
    assert await uplink.measured(1) == []
    with uplink.counted("topic", "/scan", lambda: None, lambda: {1}):
        now_s += 2
        [stream] = await uplink.measured(1)
        assert stream.bytes_per_s is None


async def test_all_who_ask_lately_share_what_the_robot_says_of_its_line():
    """Each question crosses the line, and whoever sees the robot may ask as often as nginx lets through."""
    now_s, questions = 100.0, 0

    async def ask():
        nonlocal questions
        questions += 1
        await asyncio.sleep(0)
        return questions

    uplink = Uplink(lambda: now_s)
    assert await asyncio.gather(*(uplink.line_rate(ask) for _ in range(3))) == [1, 1, 1]
    now_s += LINE_RATE_KEPT_S
    assert await uplink.line_rate(ask) == 2
