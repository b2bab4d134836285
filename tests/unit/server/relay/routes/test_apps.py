"""Web apps as ends of routes of a running relay: what routes carry from them and to them, and who may not connect."""

import asyncio
import json
import math
import time
from contextlib import suppress
from dataclasses import replace
from itertools import cycle

import pytest
from aiohttp import WSMsgType
from fake_robot import WAIT_S
from relay_clients import audit_lines, refusal
from relay_server import BEN, EVE, until
from robotether_server.db.control import DriveEntry
from robotether_server.db.routes import RelayRoute
from robotether_server.relay.routes import apps, driver
from robotether_server.relay.routes import routes as relay_routes
from robotether_server.settings import robot as robot_settings
from route_world import TARGET, RouteWorld

TWIST, ODOMETRY = "geometry_msgs/msg/Twist", "nav_msgs/msg/Odometry"
STEER = RelayRoute(
    None, "/stick", TARGET, "/cmd_vel", TWIST, 50, 5, source_app="joy", id=1, user_name="eve"
)
SHOW = RelayRoute(
    TARGET, "/odom", None, "/pose", ODOMETRY, 50, 5, target_app="joy", id=1, user_name="eve"
)
OFFER = {"op": "advertise", "topic": "/stick", "type": TWIST}
# As roslibjs and roslibpy may name topic and type.
TAKE = {"op": "subscribe", "topic": "pose", "type": "nav_msgs/Odometry"}
MOVE = {"op": "publish", "topic": "/stick", "msg": {"linear": {"x": 0.5}}}
HALT = {"op": "publish", "topic": "/stick", "msg": {"linear": {"x": 0.0}}}


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(relay_routes, "RETRY_AFTER_S", 0.05)
    monkeypatch.setattr(relay_routes, "CHECK_EVERY_S", 0.05)


@pytest.fixture
def memory_database(memory_database):
    memory_database.grants |= {(5, TARGET): "manage"}
    memory_database.routes = [STEER]
    return memory_database


@pytest.fixture
def world(relay, memory_database, guarded):
    return RouteWorld(relay, memory_database, guarded)


@pytest.fixture
def connect(world, http, opened):
    async def connect_app(*messages, user=EVE, name="joy", **options):
        url = world.relay.app_url(name, user)
        socket = await opened.enter_async_context(http.ws_connect(url, **options))
        for message in messages:
            await socket.send_json(message)
        return socket

    return connect_app


async def publish_until(socket, condition, *commands):
    turns = cycle(commands or (HALT, MOVE))
    async with asyncio.timeout(WAIT_S):
        while not condition():
            await socket.send_json(next(turns))
            with suppress(TimeoutError):
                await socket.receive(timeout=0.02)


async def closed_with(socket):
    """Return the code with which the relay closes an app, and what it sent before."""
    answers = []
    async with asyncio.timeout(WAIT_S):
        while (message := await socket.receive()).type is not WSMsgType.CLOSE:
            answers.append(message.data)
    return int(message.data), answers


async def test_an_app_drives_as_long_as_it_is_connected(world, connect):
    """When no app is connected, the robot is free and the route waits."""
    await until(lambda: world.live() == {1: ("waits", "app joy is not connected")}, "it waits")
    assert world.driver() is None
    for fence in (1, 2):
        world.target.received.clear()
        socket = await connect(OFFER)
        await publish_until(socket, world.published)
        message = world.published()[0]
        assert message["topic"] == "/cmd_vel"
        assert message["robotether"]["fence"] == fence
        assert 0 <= world.target.session.clock_ms() - message["robotether"]["t_ms"] < 10_000
        assert world.driver() == "eve (route)"
        await socket.close()
        await until(lambda: world.driver() is None, "the robot is free")
    assert world.ends() == []


async def test_an_app_moves_nothing_before_it_stood_still(world, connect, monkeypatch):
    """When it has connected anew, and after a time without a command."""
    monkeypatch.setattr(driver, "HELD_AFTER_S", 0.3)

    def moves():
        return [each for each in world.published() if each["msg"]["linear"]["x"]]

    for _ in range(2):
        world.target.received.clear()
        socket = await connect(OFFER)
        await publish_until(socket, lambda: "send a zero" in world.why(), MOVE)
        assert world.published() == []
        assert world.driver() is None
        await publish_until(socket, moves, HALT, MOVE)
        await asyncio.sleep(0.4)
        before = len(moves())
        await publish_until(socket, lambda: "send a zero" in world.why(), MOVE)
        assert len(moves()) == before
        await socket.close()
        await until(lambda: world.driver() is None, "the robot is free")


async def test_an_app_that_sends_nothing_keeps_nobody_from_driving(
    world, connect, http, monkeypatch
):
    """Neither before its first command nor after its last; who drives then ends the route."""
    monkeypatch.setattr(driver, "SILENT_AFTER_S", 0.5)
    monkeypatch.setattr(driver, "LOOK_AT_SILENCE_EVERY_S", 0.05)
    socket = await connect(OFFER)
    idle = ("waits", "app joy sends nothing, and the robot is free")
    for _ in range(2):
        await until(
            lambda: world.live() == {1: idle} and world.driver() is None, "the robot is free"
        )
        world.target.received.clear()
        await publish_until(socket, world.published)
        assert world.driver() == "eve (route)"
    await until(lambda: world.driver() is None, "the robot is free")
    assert world.ends() == []
    async with http.ws_connect(world.relay.ros_url(world.database.robots[TARGET])):
        await until(lambda: world.driver() == "ann", "ann drives")
        await until(world.ends, "the route ended")
        assert world.ends() == ["lease_held"]
        await publish_until(
            socket, lambda: world.relay.relay.routes.live(5).routes == [], HALT, MOVE
        )
        assert world.driver() == "ann"


async def test_other_settings_of_a_robot_count_for_an_app_that_waits(world, connect):
    """It began to wait before they did."""
    socket = await connect(OFFER)
    await until(lambda: "nothing" in world.why(), "it waits")
    other = {"policy": {"manage": {"publish": []}}, "guard": {"drive_topics": ["/elsewhere"]}}
    sim1 = replace(world.database.robots[TARGET], settings=robot_settings.parse(other))
    world.database.robots = {TARGET: sim1}
    state = world.relay.relay.fleet.state
    await until(lambda: state().robots[TARGET] == sim1, "the relay knows them")
    await publish_until(socket, lambda: "policy" in world.why(), HALT)
    assert world.published() == []
    assert world.driver() is None


async def test_an_app_and_what_it_drives_are_in_the_audit_log(world, connect):
    address = "192.0.2.7"
    socket = await connect(OFFER, headers={"X-Forwarded-For": address})
    await publish_until(socket, world.published)
    await socket.close()

    def lines():
        return {line.kind: line for line in audit_lines(world.database)}

    await until(lambda: {"drive_ended", "app_disconnected"} <= set(lines()), "they are written")
    assert {kind: (line.actor, line.address) for kind, line in lines().items()} == {
        "app_connected": ("eve", address),
        "app_disconnected": ("eve", address),
        "drive_started": ("eve (route)", address),
        "drive_ended": ("eve (route)", address),
    }
    assert lines()["app_connected"].details == {"app": "joy"}
    assert lines()["app_disconnected"].details["end_code"] == "client_left"
    [drive] = {each.address for each in world.database.written if isinstance(each, DriveEntry)}
    assert drive == address


async def test_a_command_whose_age_no_pong_bounds_is_dropped(world, connect):
    socket = await connect(OFFER, autoping=False)
    await publish_until(socket, world.published, HALT)
    await asyncio.sleep(1)
    before = len(world.published())
    await publish_until(socket, lambda: "old" in world.why(), MOVE)
    assert len(world.published()) == before


async def test_an_app_ends_with_its_login(world, connect, http):
    """Its tickets open nothing, not even for the second until the relay ends what the login opened."""
    url = world.relay.app_url("other", EVE)
    socket = await connect(OFFER)
    await publish_until(socket, world.published)
    world.database.credentials = {}
    assert await refusal(http, url) == 401
    assert (await closed_with(socket))[0] == 4001
    await until(lambda: world.driver() is None, "the robot is free", 2)


async def test_a_route_reads_no_app_of_another_user(world, connect):
    """Whose app has the same name, and who might manage the robot, too."""
    world.database.grants |= {(BEN.id, TARGET): "manage"}
    socket = await connect(OFFER, user=BEN)
    for _ in range(10):
        await socket.send_json(MOVE)
        await asyncio.sleep(0.02)
    assert world.live() == {1: ("waits", "app joy is not connected")}
    assert world.published() == []


async def test_what_an_app_does_not_offer_is_said(world, connect):
    missing = "the app does not offer /stick"
    for messages, why in (
        ([], missing),
        ([{**OFFER, "type": "a/B"}], "the app has /stick with another type"),
        ([OFFER, {"op": "unadvertise", "topic": "/stick"}], missing),
    ):
        socket = await connect(*messages)
        await until(lambda why=why: world.live() == {1: ("waits", why)}, "the page says so")
        assert world.driver() is None
        await socket.close()


async def test_what_is_none_of_its_operations_is_refused(world, connect, monkeypatch):
    """A clock sync is answered: a page sees no pings, and knows by it that the connection still is."""
    monkeypatch.setattr(apps, "ANSWERS_PER_S", 99)
    many = [{**OFFER, "topic": f"/t{number}"} for number in range(apps.MAX_TOPICS)]
    socket = await connect(*many)
    for text in (
        "no json",
        "[]",
        "{}",
        '{"op":"advertise","topic":"/<b>x</b>","type":"a/B"}',
        '{"op":"advertise","topic":"/a","type":"<b> x"}',
        '{"op":"advertise","topic":"/a","type":7}',
        '{"op":"advertise","topic":"/thirty-three","type":"a/B"}',
        '{"op":"publish","topic":"/a","msg":{}}',
        '{"op":"robotether.stop","topic":"/a"}',
    ):
        await socket.send_str(text)
        answer = await socket.receive_json(timeout=WAIT_S)
        assert (answer["op"], answer["level"]) == ("status", "error")
    # Whoever calls waits for this alone.
    await socket.send_json({"op": "call_service", "service": "/rosapi/topics", "id": "call"})
    answer = await socket.receive_json(timeout=WAIT_S)
    assert (answer["op"], answer["id"], answer["result"]) == ("service_response", "call", False)
    [app] = world.relay.relay.apps.of_user(EVE.id)
    assert len(app.describe().advertises) == apps.MAX_TOPICS
    sync = {"op": "robotether.clock_sync", "t_ms": 1.5, "key": "k"}
    await socket.send_json(sync)
    answer = await socket.receive_json(timeout=WAIT_S)
    assert answer.pop("relay_ms") > 0
    assert answer == sync


@pytest.mark.parametrize(("per_s", "size", "every_s"), [(20, 0, 0.001), (800, 50_000, 0.01)])
async def test_an_app_that_floods_is_closed(connect, monkeypatch, per_s, size, every_s):
    monkeypatch.setattr(apps, "MAX_MESSAGES_PER_S", per_s)
    monkeypatch.setattr(apps, "FLOOD_AFTER_S", 0.2)
    socket = await connect(OFFER)
    message = {**MOVE, "msg": {"data": "x" * size}}

    async def flood():
        while not socket.closed:
            await socket.send_json(message)
            await asyncio.sleep(every_s)

    flooding = asyncio.create_task(flood())
    began_s = time.monotonic()
    code, answers = await closed_with(socket)
    lasted_s = time.monotonic() - began_s
    flooding.cancel()
    await asyncio.gather(flooding, return_exceptions=True)
    assert code == 1008
    assert all("too many" in answer for answer in answers)
    # A busy machine takes longer to be flooded.
    assert len(answers) <= apps.ANSWERS_PER_S * (1 + lasted_s)


async def test_apps_of_a_user_connect_only_so_often(world, connect, http, monkeypatch):
    monkeypatch.setattr(apps, "MAX_CONNECTS_AT_ONCE", 2)
    for _ in range(2):
        await (await connect()).close()
    assert await refusal(http, world.relay.app_url("other", EVE)) == 429
    await connect(user=BEN)


async def test_a_message_over_the_limit_closes_an_app(connect):
    socket = await connect(OFFER)
    await socket.send_str("x" * (apps.MAX_MESSAGE_BYTES + 1))
    assert (await closed_with(socket))[0] == 1009


async def test_an_app_gets_what_its_user_routes_to_it(world, connect):
    """The route needs no lease, and begins once the app has subscribed."""
    world.database.routes = [SHOW]
    other = await connect(TAKE, user=BEN)
    socket = await connect()
    await until(lambda: world.target.topics, "the robot is subscribed")
    content = {"child_frame_id": "<b>", "covariance": [math.nan]}
    message = {"op": "publish", "topic": "/odom", "msg": content}
    await world.target.send_to_topics(json.dumps(message).encode())
    await until(
        lambda: world.live() == {1: ("runs", "the app does not subscribe to /pose")}, "so it is"
    )
    # Two parts of a page subscribe, and one of them ends.
    for op, number in (("subscribe", 1), ("subscribe", 2), ("unsubscribe", 1)):
        await socket.send_json({**TAKE, "op": op, "id": number})

    async def send():
        while True:
            await world.target.send_to_topics(json.dumps(message).encode())
            await asyncio.sleep(0.02)

    sending = asyncio.create_task(send())
    answer = await socket.receive_json(timeout=WAIT_S)
    content = {"child_frame_id": "<b>", "covariance": [None]}
    assert answer == {"op": "publish", "topic": "pose", "msg": content}
    sending.cancel()
    assert world.driver() is None
    message["msg"]["child_frame_id"] = "x" * apps.MAX_MESSAGE_BYTES
    await world.target.send_to_topics(json.dumps(message).encode())
    too_large = ("runs", "the message has over 256 KB, the limit of apps")
    await until(lambda: world.live() == {1: too_large}, "the page says so")
    with pytest.raises(TimeoutError):
        await other.receive(timeout=0.1)
    del world.database.grants[5, TARGET]
    await until(lambda: not world.target.topics, "the subscription has ended", 2)
    assert world.ends() == ["rights_ended"]


async def test_only_a_ticket_for_the_app_connects_it_and_once(world, connect, http):
    used = world.relay.app_url("used", EVE)
    await (await http.ws_connect(used)).close()
    await connect()
    robot = world.database.robots[TARGET]
    for number in range(apps.MAX_APPS - 1):
        await connect(user=BEN, name=f"app{number}")
    await connect(user=BEN, name="last")
    with_robots = world.relay.ros_url(robot, user=EVE).partition("?")[2]
    for_app = world.relay.app_url("sim1", EVE).partition("?")[2]
    for path, status in [
        (used.removeprefix(world.relay.url), 401),
        ("/apps/joy/ros", 401),
        (world.relay.app_url("other", EVE, "mine").removeprefix(world.relay.url), 401),
        (f"/apps/sim1/ros?{with_robots}", 401),
        (f"/robots/sim1/ros?{for_app}", 401),
        (f"/robots/sim1/video/frames?topic=/a&{for_app}", 401),
        (world.relay.app_url("joy", EVE).removeprefix(world.relay.url), 409),
        (world.relay.app_url("ninth", BEN).removeprefix(world.relay.url), 429),
        ("/apps/<b>/ros", 404),
    ]:
        assert await refusal(http, world.relay.url + path) == status, path
    headers = {"Origin": "https://evil.example"}
    assert await refusal(http, world.relay.app_url("evil", EVE), headers) == 403
