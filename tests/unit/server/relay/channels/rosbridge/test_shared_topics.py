"""Subscriptions of several people that share one on the robot."""

import asyncio
import json
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import aiohttp
import cbor2
import pytest
from fake_robot import WAIT_S
from relay_clients import closing
from relay_server import MESSAGE_LIMIT, until
from robotether_common.topics import MAX_TOPICS
from robotether_server.relay.channels.rosbridge import held_messages, topic_link
from robotether_server.relay.channels.rosbridge.held_messages import HeldMessages
from robotether_server.relay.channels.rosbridge.message_validator import Subscriptions
from robotether_server.relay.channels.rosbridge.shared_topics import (
    MAX_LARGE_BYTES,
    MAX_OBSERVED_TOPICS,
    UNKEPT,
    SharedTopic,
    SharedTopics,
    TopicRefusedError,
    TopicRequest,
    combined,
)
from robotether_server.relay.channels.rosbridge.subscriptions import (
    TopicCopies,
    change,
    renamed,
)
from robotether_server.relay.channels.rosbridge.topic_link import (
    MessageTooLargeError,
    TopicLinks,
)
from robotether_server.relay.routes.source import RouteSource
from route_world import FOLLOW

ODOM = {"op": "subscribe", "topic": "/odom"}


class SilentConnector:
    async def run(self, _topic):
        await asyncio.Event().wait()


@pytest.fixture
def observe(robot, ros, opened):
    async def open_one(*messages):
        socket = await opened.enter_async_context(ros("observe", max_msg_size=0))
        for message in messages:
            await socket.send_json(message)
        return socket

    return open_one


def subscribed(robot):
    messages = [json.loads(data) for data in robot.received]
    return [message for message in messages if message["op"] == "subscribe"]


async def test_all_who_request_the_same_share_one_copy(relay, robot, observe):
    sockets = [await observe({**ODOM, "id": number}) for number in range(3)]
    shared = relay.relay.shared_topics
    await until(lambda: len(robot.topics) == 1, "the robot has a subscription")
    [topic] = shared._tasks
    await until(lambda: len(topic.users) == 3, "all three share it")
    await robot.send_to_topics(b"news")
    for socket in sockets:
        while await socket.receive_str(timeout=WAIT_S) != "news":
            pass
    assert subscribed(robot) == [ODOM]
    await sockets[0].send_json({"op": "unsubscribe", "topic": "/odom"})
    await sockets[1].close()
    await until(lambda: len(topic.users) == 1, "one is left")
    assert len(robot.topics) == 1
    await sockets[2].close()
    await until(lambda: not robot.topics, "the subscription ends")


async def test_messages_have_the_name_that_each_client_gave(relay, robot, observe):
    """Clients hand a message on by it; the robot knows the whole name alone."""
    names = ["/odom", "odom"]
    sockets = [await observe({**ODOM, "topic": name}) for name in names]
    sockets.append(await observe({**ODOM, "topic": "odom", "fragment_size": 100}))
    await until(lambda: len(robot.topics) == 1, "the robot has a subscription")
    [topic] = relay.relay.shared_topics._tasks
    await until(lambda: len(topic.users) == 3, "all share it")
    msg = {"child_frame_id": "/odom", "text": '"é"' * 100}
    message = {"op": "publish", "topic": "/odom", "msg": msg}
    await robot.send_to_topics(json.dumps(message, ensure_ascii=False).encode())
    for name, socket in zip(names, sockets, strict=False):
        while (message := await socket.receive_json(timeout=WAIT_S))["op"] != "publish":
            pass  # the robot repeats what it gets
        assert message == {"op": "publish", "topic": name, "msg": msg}
    parts = []
    while not parts or len(parts) < parts[0]["total"]:
        part = await sockets[2].receive_json(timeout=WAIT_S)
        parts += [part] if part["op"] == "fragment" else []
    assert [(part["id"], part["num"]) for part in parts] == [("1", n) for n in range(len(parts))]
    assert max(len(part["data"]) for part in parts) == 100
    assert json.loads("".join(part["data"] for part in parts)) == message
    assert subscribed(robot) == [ODOM]


@pytest.mark.parametrize("ids", [({}, {}), ({"id": "a"}, {"id": "b"})])
async def test_a_client_that_gave_both_names_gets_a_message_under_both(robot, observe, ids):
    names = ("odom", "/odom")
    requests = [{**ODOM, "topic": name, **each} for name, each in zip(names, ids, strict=True)]
    socket = await observe(*requests)
    await until(lambda: len(robot.topics) == 1, "the robot has a subscription")
    await robot.send_to_topics(b'{"op": "publish", "topic": "/odom", "msg": "both"}')
    missing = set(names)
    while missing:
        message = await socket.receive_json(timeout=WAIT_S)
        missing -= {message["topic"]} if message.get("msg") == "both" else set()


def as_ujson(message):
    return json.dumps(message).replace("/", r"\/").encode()


@pytest.mark.parametrize("write", [cbor2.dumps, as_ujson])
@pytest.mark.parametrize("name", ["a", "a" * 22, "a" * 23, "a" * 24, "a" * 254, "a/" * 120 + "a"])
def test_what_comes_in_cbor_or_by_ujson_is_renamed_too(name, write):
    before, after = (
        write({"op": "publish", "topic": topic, "msg": {"data": f"/{name}"}})
        for topic in (f"/{name}", name)
    )
    assert renamed(before, f"/{name}", name) == after


def test_several_of_one_client_are_merged_as_rosbridge_merges_them():
    both = combined(
        [
            TopicRequest("/a", None, 100, 5, 2000, "png", None),
            TopicRequest("/a", "a/B", 50, 7, None, "cbor", b'{"depth":1}'),
        ]
    )
    assert both == TopicRequest("/a", "a/B", 50, 5, None, "cbor", b'{"depth":1}')
    assert both.fragment_size == 2000
    png = replace(TopicRequest("/a", compression="png"), names=("a",))
    assert combined([png]).compression == "none", "a PNG would have the whole name"


class AskedConnector(SilentConnector):
    def __init__(self):
        self.questions = 0
        self.answers = asyncio.Semaphore(0)
        self.is_ended = asyncio.Event()
        self.is_ended.set()

    async def repeat(self, _topic, digests):
        self.questions += 1
        await self.answers.acquire()
        for each in digests:
            yield each
        await self.is_ended.wait()


async def test_newcomers_share_the_question_what_rosbridge_repeats(relay, sim1, monkeypatch):
    """Each question has rosbridge write its latched messages, and who comes and goes causes as many as it likes."""
    topics, connector = relay.relay.shared_topics, AskedConnector()
    monkeypatch.setattr(topics, "_connector", connector)
    topic = topics._open(SharedTopic(sim1, TopicRequest("/odom")))
    topic.on_message(b"map", aiohttp.WSMsgType.TEXT)
    got = []
    monkeypatch.setattr(Client, "on_message", lambda client, *_: got.append(client))
    clients = [Client() for _ in range(50)]
    for client in clients:
        topics.join(sim1, TopicRequest("/odom"), client, limit=9)
        await asyncio.sleep(0)
    topics.leave(topic, clients.pop())
    assert connector.questions == 1
    topic.on_message(b"newer", aiohttp.WSMsgType.TEXT)
    got.clear()
    connector.answers.release()
    await until(lambda: connector.questions == 2, "the others' question is asked")
    connector.answers.release()
    await until(lambda: len(got) == len(clients), "all have the message")
    await until(lambda: not topic.is_asked_for, "nothing is asked any more")
    assert connector.questions == 2
    assert set(got) == set(clients)
    got.clear()
    topics.join(sim1, TopicRequest("/odom"), clients[0], limit=9)
    assert got == [clients[0]] * 2, "what it repeats is known"
    topic.on_failed("gone")
    topic.on_ready()
    topics.join(sim1, TopicRequest("/odom"), clients[1], limit=9)
    await until(lambda: connector.questions == 3, "it may have ended with the connection")
    topic.on_message(b"newest", aiohttp.WSMsgType.TEXT)
    connector.answers.release()
    await until(lambda: not topic.is_asked_for, "it is asked")
    assert not topic.lasting(), "nobody has said that the newest lasts"
    topics.end_all_of(sim1.id)


async def test_a_message_that_equals_one_of_before_comes_once(relay, sim1, monkeypatch):
    """The robot sees both as one that is repeated; what came since is none that a newcomer missed."""
    topics, connector, got = relay.relay.shared_topics, AskedConnector(), []
    monkeypatch.setattr(topics, "_connector", connector)
    monkeypatch.setattr(
        Client, "on_message", lambda _client, _topic, message, _kind: got.append(message)
    )
    topic = topics._open(SharedTopic(sim1, TopicRequest("/button")))
    for message in (b"pressed", b"armed"):
        topic.on_message(message, aiohttp.WSMsgType.TEXT)
    topics.join(sim1, TopicRequest("/button"), Client(), limit=9)
    await until(lambda: connector.questions == 1, "the robot is asked")
    connector.is_ended.clear()
    connector.answers.release()
    await until(connector.answers.locked, "it answers")
    topic.on_message(b"pressed", aiohttp.WSMsgType.TEXT)
    await until(lambda: len(got) == 2, "the newcomer has it before the robot ends its answer")
    connector.is_ended.set()
    await until(lambda: not topic.is_asked_for, "it has answered")
    assert got == [b"pressed", b"armed"]
    topics.end_all_of(sim1.id)


async def test_each_new_subscription_has_all_static_frames_at_once(relay, sim1, monkeypatch):
    """Rosbridge for ROS 2 repeats only the newest frame of several publishers; a new request may be delayed."""
    topics, name, got = relay.relay.shared_topics, "/arm/tf_static", []
    monkeypatch.setattr(topics, "_connector", AskedConnector())
    monkeypatch.setattr(TopicCopies, "on_message", lambda _client, *message: got.append(message))
    topic = topics._open(SharedTopic(sim1, TopicRequest(name)))
    for message in (b"camera", b"laser"):
        topic.on_message(message, aiohttp.WSMsgType.TEXT)
    client, subscriptions = TopicCopies(sim1, lambda: (1,), topics), Subscriptions(9)
    both = [(name, message, aiohttp.WSMsgType.TEXT) for message in (b"camera", b"laser")]
    # Two parts of one page have a subscription each, as they have with rosbridge.
    for op, number, received in (
        ("subscribe", 1, both),
        ("subscribe", 2, both),
        ("unsubscribe", 1, []),
    ):
        message = {"op": op, "topic": name, "id": number}
        subscriptions.change(message)
        change(client, message, subscriptions.of(name))
        assert got == received
        got.clear()
    assert not topic.is_asked_for
    route = RouteSource(replace(FOLLOW, source_topic=name), lambda: None, is_drive=False)
    topics._open(SharedTopic(sim1, route.request(sim1))).on_message(b"arm", aiohttp.WSMsgType.TEXT)
    route.open(sim1, topics)
    assert route.take(0).data == b"arm"
    topics.end_all_of(sim1.id)


class RepeatingSocket:
    def __init__(self):
        self.read = 0

    async def send_frame(self, data, kind): ...

    async def receive(self):
        self.read += 1
        assert self.read < 1000, "it is read without end"
        named = b'{"op": "robotether.known", "digest": "1"}'
        return aiohttp.WSMessage(aiohttp.WSMsgType.TEXT, named, None)

    def drop(self): ...


async def test_a_robot_that_repeats_without_end_is_read_no_longer(sim1):
    """Else the relay keeps a name for each, and gives the message to the newcomer as often."""

    async def open_topic(*_args):
        return RepeatingSocket()

    topic = SharedTopic(sim1, TopicRequest("/odom"))
    links = TopicLinks(open_topic, None, 1024, b"")
    assert [each async for each in links.repeat(topic, {"1", "2"})] == ["1"]


class AnsweringSocket(RepeatingSocket):
    """A robot's connection with one answer to the subscription."""

    received_bytes = staticmethod(lambda: 0)

    def __init__(self, answer):
        super().__init__()
        self.answers = [aiohttp.WSMessage(aiohttp.WSMsgType.TEXT, answer, None)]

    async def ping(self): ...

    async def next_message(self, on_control):
        # rosbridge answers a ping before what it has to think about.
        on_control(aiohttp.WSMsgType.PONG, b"")
        return self.answers.pop() if self.answers else await asyncio.Event().wait()


async def test_what_brings_nothing_is_requested_again_for_a_newcomer(relay, sim1, monkeypatch):
    """rosbridge_suite drops a subscription without a word, and a newcomer would share that for ever."""
    monkeypatch.setattr(topic_link, "FIRST_SILENCE_S", 0.01)
    opened, topics = asyncio.Semaphore(0), SharedTopics(relay.relay.registry, None)

    async def open_topic(*_args):
        opened.release()
        socket = AnsweringSocket(b"")
        socket.answers.clear()
        return socket

    topics._connector = TopicLinks(open_topic, relay.relay.registry, 1024, b"notice")
    topics.watch(sim1, TopicRequest("/odom"), Client(), 9)
    await asyncio.wait_for(opened.acquire(), WAIT_S)
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(opened.acquire(), 0.1)
    topics.watch(sim1, TopicRequest("/odom"), Client(), 9)
    await asyncio.wait_for(opened.acquire(), WAIT_S)
    await topics.close()


async def test_what_rosbridge_refuses_is_requested_again(relay, sim1):
    """Rosbridge refuses a topic without a type that nobody advertises yet, and newcomers share the copy."""
    refusal = b'{"op": "status", "level": "error", "msg": "no such topic"}'
    news = b'{"op": "publish", "topic": "/odom", "msg": {}}'
    sockets, got = [AnsweringSocket(answer) for answer in (refusal, refusal, news)], asyncio.Queue()

    async def open_topic(*_args):
        return sockets.pop(0)

    client, topic = Client(), SharedTopic(sim1, TopicRequest("/odom"))
    client.on_topic_failed = lambda _topic, why: got.put_nowait(why)
    client.on_message = lambda _topic, message, _kind: got.put_nowait(message)
    topic.users.add(client)
    links = TopicLinks(open_topic, relay.relay.registry, 1024, b"notice")
    bringing = asyncio.create_task(links.run(topic))
    assert await asyncio.wait_for(got.get(), WAIT_S) == "rosbridge reports 'no such topic'"
    assert await asyncio.wait_for(got.get(), WAIT_S) == news
    bringing.cancel()


async def test_a_message_over_the_limit_is_refused_with_its_size(robot, observe):
    socket = await observe({**ODOM, "id": "s"})
    await until(lambda: subscribed(robot), "the robot has a subscription")
    await robot.send_to_topics(b"x" * (MESSAGE_LIMIT * 5 // 4))
    while (answer := json.loads(await socket.receive_str(timeout=WAIT_S)))["op"] != "status":
        pass
    why = "a message has 12.5 MB, over 10 MB (MESSAGE_LIMIT_MB)"
    assert answer["msg"] == f"cannot subscribe to /odom: {why}"


@pytest.mark.parametrize(
    ("end", "pauses"),
    [
        ("brings", [0.2] * 4),
        ("breaks", [0.2, 0.4, 0.8, 1.6]),
        ("is too large", [30, 60, 120, 240]),
    ],
)
async def test_what_breaks_before_a_message_is_through_is_requested_ever_later(
    sim1, monkeypatch, end, pauses
):
    """A message that takes longer than a connection lasts would fill the line for ever."""
    now, paused = [0.0], []

    async def pause(pause_s):
        paused.append(pause_s)
        if len(paused) == len(pauses):
            raise asyncio.CancelledError

    class BreakingLinks(TopicLinks):
        async def _bring(self, topic, _silence_s):
            now[0] += 60
            if end == "is too large":
                raise MessageTooLargeError(end)
            if end == "brings":
                topic.on_message(b"news", aiohttp.WSMsgType.TEXT)
            return "it broke"

    monkeypatch.setattr(topic_link, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(topic_link, "asyncio", SimpleNamespace(sleep=pause))
    with pytest.raises(asyncio.CancelledError):
        await BreakingLinks(None, None, 1024, b"").run(SharedTopic(sim1, TopicRequest("/odom")))
    assert paused == pauses


async def test_a_slow_client_skips_and_delays_nobody(relay, robot, observe):
    slow, quick = await observe(ODOM), await observe(ODOM)
    await until(lambda: subscribed(robot), "the robot has a subscription")
    [topic] = relay.relay.shared_topics._tasks
    await until(lambda: len(topic.users) == 2, "both share it")
    # Either may have come too late for the echo of the subscription.
    await robot.send_to_topics(b"begin")
    for socket in (slow, quick):
        while await socket.receive_str(timeout=WAIT_S) != "begin":
            pass
    slow._response.connection.transport.pause_reading()
    count = 200
    for number in range(count):
        await robot.send_to_topics(b"%d " % number + b"x" * 200_000)
        assert (await quick.receive_str(timeout=WAIT_S)).startswith(f"{number} ")
    slow._response.connection.transport.resume_reading()
    numbers = []
    while not numbers or numbers[-1] != count - 1:
        numbers.append(int((await slow.receive_str(timeout=WAIT_S)).split()[0]))
    assert numbers == sorted(numbers)
    assert len(numbers) < count


async def test_one_observer_leaves_the_others_some_topics(relay, sim1):
    topics = SharedTopics(relay.relay.registry, SilentConnector())

    def watch(name, user_id):
        topics.watch(sim1, TopicRequest(name), Client(user_id), MAX_OBSERVED_TOPICS)

    def fill(user_id):
        count = 0
        with suppress(TopicRefusedError):
            while True:
                watch(f"/of{user_id}/{count}", user_id)
                count += 1
        return count

    for user_id in (1, 2):
        watch("/both", user_id)
    assert [fill(user_id) for user_id in (1, 2, 3)] == [21, 7, 2]
    watch("/of1/0", 4)
    await topics.close()


async def test_who_subscribes_anew_without_end_opens_few_topics(relay, sim1):
    class Connector:
        opened = 0

        async def run(self, _topic):
            self.opened += 1
            await asyncio.Event().wait()

    connector, client = Connector(), Client()
    topics = SharedTopics(relay.relay.registry, connector)
    for number in range(3 * MAX_TOPICS):
        topic = topics.watch(sim1, TopicRequest(f"/t{number}"), client, MAX_OBSERVED_TOPICS)
        await asyncio.sleep(0)
        topics.leave(topic, client)
    assert MAX_OBSERVED_TOPICS < connector.opened < 2 * MAX_TOPICS
    await topics.close()


class Client:
    def __init__(self, user_id=1):
        self._user_id = user_id

    def user_ids(self):
        return (self._user_id,)

    def on_topic_ready(self, topic): ...

    def on_message(self, topic, message, kind): ...

    def on_topic_failed(self, topic, why): ...


async def test_what_a_client_publishes_waits_for_its_subscriptions(wide, robot, ros):
    echo = {"op": "publish", "topic": "/echo"}
    drive = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.5}}}
    async with ros() as driver:
        for topic in ("/echo", "/cmd_vel"):
            await driver.send_json({"op": "subscribe", "topic": topic})
        goal = {"op": "publish", "topic": "/goal", "msg": {}}
        for message in (
            goal,
            {**echo, "msg": {"data": "1"}},
            {**echo, "msg": {"data": "2"}},
            drive,
        ):
            await driver.send_json(message)
        await driver.send_json({"op": "call_service", "service": "/rosapi/topics"})
        await driver.send_json({"op": "publish", "topic": "/other", "msg": {}})
        await until(lambda: len(robot.received) == 8, "all reach the robot")
    sent = [json.loads(data) for data in robot.received]
    assert (sent[0]["op"], sent[0]["topic"]) == ("publish", "/cmd_vel")
    assert {message["op"] for message in sent[1:3]} == {"subscribe"}
    said = [message.get("topic", message["op"]) for message in sent[3:]]
    assert said == ["/goal", "/echo", "/echo", "call_service", "/other"]
    of_echo = [message for message in sent if message.get("topic") == "/echo"]
    assert [each.get("msg", {}).get("data") for each in of_echo] == [None, "1", "2"]


async def test_nothing_waits_for_a_subscription_longer_than_it_may(monkeypatch):
    """A robot that never answers the ping delays what its driver publishes, and no older message follows much later."""
    monkeypatch.setattr(held_messages, "HELD_FOR_S", 0.05)
    held = HeldMessages()
    held.begin("/echo")
    assert held.add(b"1", is_published=True)
    assert await asyncio.wait_for(held.next(), 5) == b"1"
    assert not held.add(b"2", is_published=True)


async def test_what_the_robot_does_not_take_is_not_read(wide, robot, monkeypatch, ros):
    """That holds behind what waited for a subscription, too; a stop is read all the same."""
    opened = []

    async def next_never(held):
        opened.append(held)
        await asyncio.Event().wait()
        raise AssertionError

    monkeypatch.setattr(held_messages, "MAX_HELD_BYTES", 1000)
    monkeypatch.setattr(HeldMessages, "next", next_never)
    async with ros() as driver:
        await driver.send_json(ODOM)
        for _ in range(20):
            message = {"op": "publish", "topic": "/odom", "msg": {"data": "x" * 500}}
            await driver.send_json(message)
        await driver.send_json({"op": "robotether.stop"})
        await closing(driver)
    [held] = opened
    assert sum(len(held._released.get_nowait()) for _ in range(held._released.qsize())) < 2500


async def test_large_messages_of_one_robot_have_a_common_bound(relay, sim1):
    """What was kept stays, as it may never come again; what is not kept leaves no older one in its place."""
    shared, said = relay.relay.shared_topics, []
    topics = [shared.watch(sim1, TopicRequest(f"/{name}"), Client(), 9) for name in "abcdef"]
    for topic in topics[:5]:
        topic.on_message(b"small", aiohttp.WSMsgType.BINARY)
        topic.on_message(b"x" * 8 * 2**20, aiohttp.WSMsgType.BINARY)
    topics[5].on_message(b"small", aiohttp.WSMsgType.BINARY)
    sizes = [topic.newest and len(topic.newest.data) for topic in topics]
    assert sizes == [8 * 2**20] * 4 + [None, 5]
    newcomer = Client()
    newcomer.on_topic_failed = lambda topic, why: said.append((topic, why))
    shared.join(sim1, TopicRequest("/e"), newcomer, 9)
    assert said == [("/e", UNKEPT)]
    topics[0].on_message(b"small", aiohttp.WSMsgType.BINARY)
    topics[4].on_message(b"x" * 8 * 2**20, aiohttp.WSMsgType.BINARY)
    assert (topics[4].is_unkept, len(topics[4].newest.data)) == (False, 8 * 2**20)
    # `MESSAGE_LIMIT_MB` may be larger.
    alone = SharedTopic(sim1, TopicRequest("/odom"))
    alone.on_message(b"x" * (MAX_LARGE_BYTES + 1), aiohttp.WSMsgType.BINARY)
    assert alone.newest is not None


async def test_a_topic_of_a_robot_that_was_dropped_is_no_others(relay, sim1):
    """An operator may subscribe while the robot's removal ends the connection."""
    dropped = replace(sim1, id=99)
    relay.relay.shared_topics.join(dropped, TopicRequest("/odom"), Client(), limit=1)
    assert relay.relay.registry.robot(100).topics == {}
