"""Observers at cell a of a robot at cell b: their topics cross the line between the cells once."""

import asyncio
from itertools import product

import aiohttp
import pytest
from fake_robot import HOST, WAIT_S
from relay_clients import closing, refusal
from relay_server import BOB, until
from robotether_server.relay.cells.keys import PROOF_HEADER
from robotether_server.relay.channels.rosbridge import topic_link
from robotether_server.relay.channels.rosbridge.forwarded_topics import (
    KEY_HEADER,
    FailureNotice,
    ForwardedTopics,
    ShareNotice,
    read_notice,
    write_notice,
)
from robotether_server.relay.channels.rosbridge.shared_topics import TopicRequest
from robotether_server.relay.http.sockets import SEND_BUFFER_BYTES

ODOM = {"op": "subscribe", "topic": "/odom"}


@pytest.fixture
def observe(at_b, cell_a, sim1, http, opened):
    async def open_one(*messages):
        url = cell_a.server.ros_url(sim1, "observe", BOB)
        socket = await opened.enter_async_context(http.ws_connect(url, max_msg_size=0))
        for message in messages:
            await socket.send_json(message)
        return socket

    return open_one


def topics_of(cell):
    return list(cell.relay.shared_topics._tasks)


async def read_until(socket, text):
    async with asyncio.timeout(WAIT_S):
        while await socket.receive_str() != text:
            pass


async def test_all_observers_of_a_cell_share_one_copy_over_the_line(
    *, cell_a, cell_b, at_b, observe
):
    sockets = [await observe({**ODOM, "id": number}) for number in range(3)]
    await until(lambda: [len(topic.users) for topic in topics_of(cell_a)] == [3], "they share it")
    await until(lambda: [len(topic.users) for topic in topics_of(cell_b)] == [1], "b has one user")
    await until(lambda: len(at_b.topics) == 1, "the robot has one subscription")
    await at_b.send_to_topics(b"news")
    for socket in sockets:
        await read_until(socket, "news")
        await socket.close()
    await until(lambda: not at_b.topics, "the subscription ends")


async def test_a_copy_is_its_observers(*, cell_a, cell_b, at_b, observe, sim1, http):
    await observe(ODOM)
    ben = await observe(ODOM)
    async with http.ws_connect(cell_a.server.ros_url(sim1, "observe")) as ann:
        await ann.send_json({**ODOM, "throttle_rate": 100})
        await until(lambda: len(topics_of(cell_b)) == 2, "both copies are there")
        copies = {topic.key.throttle_rate: topic for topic in topics_of(cell_b)}
        assert [copies[rate].user_ids() for rate in (0, 100)] == [{2}, {1}]
        await ann.send_json({**ODOM, "id": "also"})
        await until(lambda: copies[0].user_ids() == {1, 2}, "ann's request is ben's now")
    await until(lambda: copies[0].user_ids() == {2}, "ann left")
    await ben.close()
    assert copies[0].user_ids() == {2}


async def test_all_else_is_the_robots_cells(*, cell_a, cell_b, sim1, http, at_b, opened):
    """It writes down the address that asked the other cell."""
    url, headers = cell_a.server.ros_url(sim1, "observe", BOB), {"X-Forwarded-For": "203.0.113.9"}
    socket = await opened.enter_async_context(http.ws_connect(url, headers=headers))
    await socket.send_json({"op": "call_service", "service": "/rosapi/topics"})
    assert (await socket.receive_json(timeout=WAIT_S))["op"] == "call_service"
    await socket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": {}})
    assert (await socket.receive_json(timeout=WAIT_S))["level"] == "error"
    assert cell_b.relay.connections.observers(sim1.id) == 1
    await socket.send_json({"op": "robotether.stop"})
    await until(lambda: at_b.session.stopped, "the robot is stopped")
    written = cell_b.database.written
    await until(lambda: any("203.0.113.9" in repr(entry) for entry in written), "it is recorded")


async def test_a_newcomer_gets_what_rosbridge_repeats(*, cell_a, at_b, observe):
    """Of a latched topic the last message, which does not cross the line again; of any other nothing old."""
    first = await observe(ODOM)
    await first.receive_str(timeout=WAIT_S)
    await at_b.send_to_topics(b"the map")
    await read_until(first, "the map")
    at_b.repeats = True
    await read_until(await observe(ODOM), "the map")
    at_b.repeats = False
    await at_b.send_to_topics(b"a scan")
    await read_until(first, "a scan")
    third = await observe(ODOM)
    [topic] = topics_of(cell_a)
    await until(lambda: len(topic.users) == 3, "the third shares it")
    await until(lambda: len(cell_a.relay.shared_topics._all) == 1, "b has answered")
    long = "news" + "x" * SEND_BUFFER_BYTES
    await at_b.send_to_topics(long.encode())
    assert await third.receive_str(timeout=WAIT_S) == long


async def test_a_right_or_login_that_ends_ends_its_copy_whichever_cell_learns_of_it(
    cell_a, cell_b, at_b, observe
):
    """What the robot's cell says may wait behind all that a slow observer has not read."""
    for cell, what in product((cell_a, cell_b), ("grants", "credentials")):
        socket = await observe(ODOM)
        await until(lambda: at_b.topics, "the robot has a subscription")
        before = getattr(cell.database, what)
        setattr(cell.database, what, {})
        assert (await closing(socket))[0] == 4001
        await until(lambda: not at_b.topics, "the robot sends it no more", 2)
        setattr(cell.database, what, before)
        await until(
            lambda: all(each.relay.fleet.state().level(2, 7) for each in (cell_a, cell_b)), "back"
        )


async def test_what_an_observer_gave_up_waits_for_no_slow_line():
    """Else one that subscribes and unsubscribes fills the memory of the robot's cell, name by name."""
    topics, sent = ForwardedTopics(b"k", BOB.id, set()), asyncio.Queue[bytes]()

    async def deliver(data, _kind):
        sent.put_nowait(data)

    for number in range(100):
        topics.share(f"/{number}", TopicRequest(f"/{number}"))
        topics.share(f"/{number}", None)
    # Nor is one of several subscriptions less new because another ends.
    for is_new in (True, False):
        topics.share("/odom", TopicRequest("/odom"), "s", is_new=is_new)
    assert list(topics._notices) == ["/odom"]
    sending = asyncio.create_task(topics.send(deliver))
    notice = ShareNotice("/odom", TopicRequest("/odom"), "s", is_new=True)
    assert read_notice(b"k", await sent.get()) == notice
    topics.share("/odom", None)
    assert read_notice(b"k", await sent.get()) == ShareNotice("/odom", None)
    sending.cancel()


async def test_why_a_topic_fails_reaches_the_observers(observe, at_b, monkeypatch):
    monkeypatch.setattr(topic_link, "FIRST_PAUSE_S", 0.01)
    socket = await observe({**ODOM, "id": "s"})
    await socket.receive_str(timeout=WAIT_S)
    await at_b.topics[0].close()
    answer = await socket.receive_json(timeout=WAIT_S)
    assert (answer["op"], answer["level"], answer["id"]) == ("status", "error", "s")
    assert answer["msg"] == "cannot subscribe to /odom: rosbridge ended the subscription"
    assert await socket.receive_json(timeout=WAIT_S) == ODOM


async def test_an_observer_whom_the_cell_refuses_is_left_to_nginx(
    *, cell_a, at_b, sim1, http, caplog
):
    """The log has neither the ticket nor what cells show each other."""
    caplog.set_level("INFO")
    url = cell_a.server.ros_url(sim1, "observe", BOB)
    async with http.ws_connect(url):
        pass
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await http.ws_connect(url)
    assert refused.value.status == 204
    assert refused.value.headers["X-Accel-Redirect"] == "@cell"
    [line] = [text for text in caplog.messages if "does not take an observer" in text]
    assert line.endswith(": HTTP 401")


async def test_observers_of_a_cell_that_is_gone_are_closed(cell_a, cell_b, observe, at_b):
    socket = await observe(ODOM)
    await socket.receive_str(timeout=WAIT_S)
    with cell_b.listener.frozen():
        assert (await closing(socket))[0] == 4505
        await until(lambda: not topics_of(cell_a), "nothing is shared")


async def test_only_cells_get_copies_and_only_of_robots_that_are_there(
    *, cell_a, cell_b, at_b, http, peer_keys, sim1
):
    """Two cells that each take the other for the robot's must not wait in a circle."""
    path, key = f"/cell/v1/topics/{sim1.id}", {KEY_HEADER: "0" * 32}
    proof = {PROOF_HEADER: peer_keys.proof}
    for url, headers, status in [
        (cell_b.server.url, {**key, **proof}, 404),
        (f"http://{HOST}:{cell_b.relay.peer_port}", key, 403),
        (f"http://{HOST}:{cell_b.relay.peer_port}", proof, 426),
        (f"http://{HOST}:{cell_a.relay.peer_port}", {**key, **proof}, 404),
    ]:
        assert await refusal(http, url + path, headers) == status


def test_a_notice_keeps_what_is_subscribed_to():
    request = TopicRequest("/a", "a/B", 100, 5, 2000, "cbor", b'{"depth":1}')
    for notice in (ShareNotice("/a", request, "id"), ShareNotice("/a", None), FailureNotice("why")):
        assert read_notice(b"key", write_notice(b"key", notice)) == notice
    assert read_notice(b"key", b'key{"type":"later"}') is None
