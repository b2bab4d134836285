"""What a robot's ROS offers over HTTP: who may read and call, when a request ends, and what it leaves at the robot."""

import asyncio
import json
from dataclasses import replace

import aiohttp
import pytest
import pytest_asyncio
from fake_robot import WAIT_S
from msgspec.structs import replace as replace_struct
from relay_clients import SlowFences, audit_lines
from relay_server import ANN, BEN, BOB, EVE, FAST, running_relay, until
from robotether_common.ros import Globs
from robotether_server.relay.auth.connections import Caps
from robotether_server.relay.channels.rosbridge import topic_api
from robotether_server.relay.channels.rosbridge.shared_topics import (
    MAX_OBSERVED_TOPICS,
    SharedTopic,
    TopicRequest,
)
from robotether_server.relay.robots.robot_dialer import RobotDialer
from robotether_server.settings.robot import LevelPolicy, Policy
from yarl import URL

TOPICS, SERVICES = "/api/v1/robots/sim1/topics", "/api/v1/robots/sim1/services"


@pytest_asyncio.fixture
async def people(relay, memory_database, sim1):
    memory_database.grants[ANN.id, sim1.id] = memory_database.grants[BEN.id, sim1.id] = "manage"
    await relay.relay.fleet.poll()
    return {user.name: memory_database.bearer(user) for user in (ANN, BOB, BEN)}


@pytest.fixture
def ask(relay, http, people):
    async def send(method, path, by="bob", args=None):
        url = URL(relay.url + path, encoded=True)
        async with http.request(method, url, json=args, headers=people[by]) as answer:
            return answer.status, await answer.json() if answer.status != 204 else None

    return send


def news(number):
    return b'{"op": "publish", "topic": "/odom", "msg": {"number": %d}}' % number


def of_operation(robot, operation):
    return [message for data in robot.received if (message := json.loads(data))["op"] == operation]


async def test_a_program_that_polls_gets_each_message_once(relay, robot, ask, monkeypatch):
    monkeypatch.setattr(topic_api, "POLLED_LINGER_S", 60.0)
    asking = asyncio.create_task(ask("GET", f"{TOPICS}/odom?wait_s=20"))
    await until(lambda: of_operation(robot, "subscribe"), "the robot has a subscription")
    await robot.send_to_topics(news(1))
    status, first = await asking
    assert (status, first["topic"], first["message"]) == (200, "/odom", {"number": 1})
    assert (await ask("GET", f"{TOPICS}/odom?wait_s=0&since={first['sequence']}")) == (204, None)
    status, again = await ask("GET", f"{TOPICS}/odom?wait_s=0")
    assert again["sequence"] == first["sequence"]
    assert again["received_age_s"] > first["received_age_s"]
    asking = asyncio.create_task(ask("GET", f"{TOPICS}/odom?wait_s=20&since={first['sequence']}"))
    [topic] = relay.relay.shared_topics._tasks
    await until(lambda: topic.users, "the program waits")
    monkeypatch.setattr(topic_api, "POLLED_LINGER_S", 0.1)
    topic.kept_until_s = 0.0
    await robot.send_to_topics(news(2))
    assert (await asking)[1]["message"] == {"number": 2}
    assert of_operation(robot, "subscribe") == [{"op": "subscribe", "topic": "/odom"}]
    await until(lambda: not robot.topics, "the subscription ends")


async def test_a_right_that_ends_ends_what_waits(robot, ask, memory_database):
    asking = asyncio.create_task(ask("GET", f"{TOPICS}/odom?wait_s=30"))
    await until(lambda: robot.topics, "it waits")
    del memory_database.grants[BOB.id, 7]
    async with asyncio.timeout(5):
        status, body = await asking
    assert (status, body["code"]) == (403, "rights_ended")


async def test_what_is_no_name_reaches_no_robot(robot, ask):
    names = "a%20b ..%2F..%2Fstop a//b %00 a%0aINFO %7Ba%7D a%252Fb a%22,%22"
    for name in names.split():
        for method, path in (("GET", TOPICS), ("POST", SERVICES)):
            status, body = await ask(method, f"{path}/{name}", "ann")
            assert (status, body["code"]) in {(422, "field_invalid"), (404, "not_found")}
    assert robot.received == []


async def test_what_rosbridge_reports_is_no_message(robot, ask):
    asking = asyncio.create_task(ask("GET", f"{TOPICS}/odom?wait_s=30"))
    await until(lambda: of_operation(robot, "subscribe"), "the robot has a subscription")
    await robot.send_to_topics(b'{"op": "status", "level": "error", "msg": "no such type"}')
    status, body = await asking
    assert (status, body["code"]) == (502, "topic_down")
    assert "rosbridge reports 'no such type'" in body["detail"]


@pytest.mark.parametrize(
    ("value", "content"),
    [
        (b"[" * 100_000 + b"]" * 100_000, None),
        (b'"\xff"', None),
        (b"{]", None),
        (
            b'{"x": [NaN, 1.5, -Infinity], "name": "a \\" NaN"}',
            {"x": [None, 1.5, None], "name": 'a " NaN'},
        ),
    ],
    ids=["nested", "no UTF-8", "no JSON", "numbers"],
)
async def test_an_answer_is_json_that_clients_read(*, guarded, ask, serving, value, content):
    """It has null for numbers that JSON lacks, as rosbridge writes them outside arrays; text stays."""
    asking = asyncio.create_task(ask("GET", f"{TOPICS}/odom?wait_s=30"))
    await until(lambda: of_operation(guarded, "subscribe"), "the robot has a subscription")
    await guarded.send_to_topics(b'{"op": "publish", "topic": "/odom", "msg": %b}' % value)
    status, body = await asking
    if content is None:
        assert (status, body["code"]) == (502, "topic_down")
        assert body["detail"] == "cannot read /odom: the robot sends what is not JSON"
    else:
        assert (status, body["message"]) == (200, content)
    calling = asyncio.create_task(ask("POST", f"{SERVICES}/rosapi/topics"))
    await until(lambda: of_operation(guarded, "call_service"), "the call has come")
    await guarded.send_to_clients(b'{"op": "service_response", "id": "call", "values": %b}' % value)
    if content is None:
        await serving(values={})
    assert await calling == (200, {"result": True, "values": content or {}})


async def test_the_policy_for_observers_counts(relay, robot, sim1, ask, memory_database):
    policy = Policy(observe=LevelPolicy(subscribe=Globs(["/odom"])))
    settings = replace_struct(sim1.settings, policy=policy)
    memory_database.robots = {7: replace(sim1, settings=settings)}
    await relay.relay.fleet.poll()
    status, body = await ask("GET", f"{TOPICS}/scan", "ann")
    assert (status, body["code"]) == (403, "grant_missing")
    assert (await ask("GET", f"{TOPICS}/odom?wait_s=0", "ann"))[0] == 204


async def test_too_many_topics_or_calls_are_problems(relay, robot, sim1, ask, ros):
    """Observers leave the driver half of a robot's topics."""
    topics = relay.relay.registry.robot(sim1.id).topics
    for number in range(MAX_OBSERVED_TOPICS):
        topic = topics[TopicRequest(f"/t{number}")] = SharedTopic(sim1, TopicRequest(f"/t{number}"))
        topic.users.add(topic_api.TopicPoll(EVE.id))
    status, body = await ask("GET", f"{TOPICS}/odom")
    assert (status, body["code"]) == (429, "too_many_connections")
    async with ros() as driver:
        await driver.send_json({"op": "subscribe", "topic": "/scan"})
        assert (await driver.receive_json(timeout=WAIT_S))["op"] == "subscribe"
    topic.users.clear()
    assert (await ask("GET", f"{TOPICS}/odom?wait_s=0"))[0] == 204
    relay.relay.connections.caps = Caps(per_user=0)
    status, body = await ask("POST", f"{SERVICES}/rosapi/topics")
    assert (status, body["code"]) == (429, "too_many_connections")


@pytest_asyncio.fixture
async def serving(guarded):
    async def answer(**members):
        await until(lambda: of_operation(guarded, "call_service"), "the call has come")
        response = {"op": "service_response", "id": "call", "result": True} | members
        await guarded.send_to_clients(json.dumps(response).encode())

    return answer


async def test_a_call_has_the_lease_while_it_waits(
    *, relay, guarded, sim1, ask, serving, memory_database
):
    lease = relay.relay.control.leasing.of(sim1.id)
    calling = asyncio.create_task(
        ask("POST", f"{SERVICES}/arm/move?type=a/B&timeout_s=30", "ann", {"x": 1})
    )
    await until(lambda: of_operation(guarded, "call_service"), "the call has come")
    assert lease.driver.holder.user == "ann"
    [stream] = await relay.relay.registry.robot(sim1.id).uplink.measured(ANN.id)
    assert (stream.kind, stream.yours) == ("rosbridge", True)
    status, body = await ask("POST", f"{SERVICES}/arm/move", "ben")
    assert (status, body["code"]) == (409, "lease_held")
    await serving(values={"ok": True})
    assert await calling == (200, {"result": True, "values": {"ok": True}})
    assert lease.driver is None
    [call] = of_operation(guarded, "call_service")
    assert (call["service"], call["type"], call["args"]) == ("/arm/move", "a/B", {"x": 1})
    assert guarded.handshakes[-1]["Robotether-Fence"] == str(lease.fence)
    await relay.relay.event_writer.flush(5)
    held = {"fence": lease.fence}
    assert [(line.kind, line.details) for line in audit_lines(memory_database)] == [
        ("calls_started", held),
        ("service_called", {"service": "/arm/move"}),
        ("calls_ended", held),
    ]
    assert {line.actor for line in audit_lines(memory_database)} == {"ann"}


async def test_a_call_shares_its_users_drive(*, relay, guarded, sim1, ask, serving, ros):
    async with ros() as driver:
        await until(lambda: relay.relay.control.driver(sim1.id) == "ann", "ann drives")
        calling = asyncio.create_task(ask("POST", f"{SERVICES}/a", "ann"))
        await serving(result=False, values="it is broken")
        assert await calling == (200, {"result": False, "reason": "it is broken"})
        fences = {headers["Robotether-Fence"] for headers in guarded.handshakes}
        assert (len(guarded.handshakes), len(fences)) == (2, 1)
        calling = asyncio.create_task(ask("POST", f"{SERVICES}/b?timeout_s=30", "ann"))
        await until(lambda: len(guarded.handshakes) == 3, "the second call is there")
        await driver.close()
    status, body = await calling
    assert (status, body["code"]) == (409, "lease_lost")
    assert "the lease of robot sim1 for this call has ended" in body["detail"]


async def test_a_service_that_does_not_answer_in_time_is_a_problem(guarded, ask):
    status, body = await ask("POST", f"{SERVICES}/a?timeout_s=1", "ann")
    assert (status, body["code"]) == (504, "service_timeout")
    assert body["detail"] == "cannot call /a: no answer within 1 s; /a may still run"


@pytest.mark.parametrize(
    ("what", "code"), [("stop", "robot_stopped"), ("page", "superseded"), ("link", "link_lost")]
)
async def test_what_ends_a_drive_ends_a_call(*, guarded, sim1, ask, what, code, ros):
    calling = asyncio.create_task(ask("POST", f"{SERVICES}/a?timeout_s=30", "ann"))
    await until(lambda: of_operation(guarded, "call_service"), "the call has come")
    async with asyncio.timeout(5):
        if what == "stop":
            assert (await ask("POST", "/api/v1/robots/sim1/stop"))[0] == 200
        elif what == "page":
            async with ros():
                await until(calling.done, "the call is over")
        else:
            await guarded.session.close()
        _, body = await calling
    assert body["code"] == code
    assert "sim1" in body["detail"]
    assert body["detail"].endswith("; /a may still run")
    if what == "stop":
        status, body = await ask("POST", f"{SERVICES}/a", "ann")
        assert (status, body["code"]) == (409, "robot_stopped")
        assert body["detail"].endswith("; /a was not called")


async def test_a_stop_that_comes_as_the_robot_is_reached_keeps_the_call(
    *, relay, guarded, sim1, ask, monkeypatch
):
    opened = RobotDialer.open

    async def open_and_stop(dialer, *args):
        socket = await opened(dialer, *args)
        relay.relay.control.stops.stop(sim1, "ben")
        return socket

    monkeypatch.setattr(RobotDialer, "open", open_and_stop)
    status, body = await ask("POST", f"{SERVICES}/a", "ann")
    assert (status, body["code"]) == (409, "robot_stopped")
    assert of_operation(guarded, "call_service") == []


async def test_a_call_takes_no_lease_from_a_page_that_opens(relay, guarded, sim1, ask, monkeypatch):
    slow = SlowFences(relay.relay.database)
    monkeypatch.setattr(relay.relay.database, "next_fence", slow.next_fence)
    async with aiohttp.ClientSession() as http, http.ws_connect(relay.ros_url(sim1)) as driver:
        await slow.asked.wait()
        status, body = await ask("POST", f"{SERVICES}/a", "ann")
        assert (status, body["code"]) == (409, "superseded")
        slow.go_on.set()
        await until(lambda: relay.relay.control.driver(sim1.id) == "ann", "ann drives")
        assert not driver.closed


async def test_a_call_begins_only_with_a_credential_that_holds_now(
    memory_database, start_robot, sim1, http
):
    """The relay has not yet read that the token is gone, and asks before the lease begins."""
    memory_database.grants[ANN.id, sim1.id] = "manage"
    async with running_relay(memory_database, replace(FAST, poll_every_s=60)) as relay:
        robot = await start_robot(relay, "guarded")
        await until(lambda: relay.relay.registry.presence(sim1.id).guard == "ready", "it is well")
        headers = memory_database.bearer(ANN)
        async with http.get(f"{relay.url}/api/v1/robots/sim1/control", headers=headers) as answer:
            assert answer.status == 200
        memory_database.credentials.clear()
        async with http.post(f"{relay.url}{SERVICES}/a", headers=headers) as answer:
            assert (answer.status, (await answer.json())["code"]) == (403, "rights_ended")
        assert (memory_database.fences, robot.received) == ({}, [])


async def test_observers_call_what_they_may_over_the_websocket(
    *, relay, guarded, sim1, ask, serving, ros
):
    for service in ("arm/move", "rosapi/get_param"):
        status, body = await ask("POST", f"{SERVICES}/{service}")
        assert (status, body["code"]) == (403, "grant_missing")
    status, body = await ask("POST", f"{SERVICES}/rosapi/topics", args={"a": {"op": "publish"}})
    assert (status, body["code"]) == (422, "field_invalid")
    assert guarded.received == []
    async with ros():
        await until(lambda: relay.relay.control.driver(sim1.id) == "ann", "ann drives")
        calling = asyncio.create_task(ask("POST", f"{SERVICES}/rosapi/topics"))
        await serving(values={"topics": []})
        assert (await calling)[0] == 200
        assert relay.relay.control.driver(sim1.id) == "ann"


async def test_what_is_no_request_of_a_service_reaches_no_robot(
    *, relay, guarded, http, people, login
):
    """A page of another site reaches none by a login, either."""
    url, as_json = f"{relay.url}{SERVICES}/a", {"Content-Type": "application/json"}
    for headers, data, status, why in (
        (as_json, b"{", 400, "truncated"),
        (as_json, b'{"a": 1}, "op": "publish"', 400, "trailing"),
        (as_json, b"[1]", 400, "it is not an object"),
        ({"Content-Type": "text/plain"}, b"{}", 415, "application/json"),
        (as_json, b'{"a": "%s"}' % (b"x" * 70_000), 413, "body size 65536 exceeded"),
    ):
        async with http.post(url, data=data, headers=headers | people["ann"]) as answer:
            assert answer.status == status
            assert why in (await answer.json(content_type="application/problem+json"))["detail"]
    for method, query, status, why in (
        ("GET", "", 405, "send POST, not GET"),
        ("POST", "?timeout_s=1&timeout_s=2", 422, "more than once"),
    ):
        async with http.request(method, url + query, headers=people["ann"]) as answer:
            assert (answer.status, why in (await answer.json())["detail"]) == (status, True)
    for headers in ({}, {"Origin": "https://evil.example"}, {"Origin": "https://lab.example"}):
        async with http.post(url, headers=login | headers) as answer:
            assert answer.status in {401, 403}
    assert guarded.received == []
