"""Routes between two robots of a running relay: what they carry, and what ends them."""

import asyncio
import json
import math
import time
from dataclasses import replace
from datetime import timedelta

import pytest
import pytest_asyncio
from relay_clients import PUBLISH, audit_lines
from relay_server import BEN, CARL, EVE, until
from robotether_server.db.fleet import RelayRequest
from robotether_server.relay.control.leasing import LeaseRequester, now
from robotether_server.relay.robots import lease
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.routes import routes as relay_routes
from robotether_server.settings import robot as robot_settings
from robotether_server.times import utc_now
from route_world import FOLLOW, SOURCE, TARGET, RouteWorld


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(relay_routes, "RETRY_AFTER_S", 0.05)
    monkeypatch.setattr(relay_routes, "CHECK_EVERY_S", 0.05)


@pytest.fixture
def memory_database(memory_database):
    memory_database.add_robot(SOURCE, "sim2", u5="manage")
    memory_database.grants |= {(5, TARGET): "manage", (3, TARGET): "drive"}
    return memory_database


@pytest_asyncio.fixture
async def world(relay, memory_database, guarded, start_robot):
    source = await start_robot(relay, "guarded", SOURCE)
    await until(lambda: relay.relay.registry.presence(SOURCE).guard == "ready", "it is ready")
    return RouteWorld(relay, memory_database, guarded, source)


async def start(world, *routes):
    world.database.routes = list(routes)
    await until(lambda: world.live().get(1, ("",))[0] == "runs", "the route runs")
    await until(lambda: len(world.source.topics) == len(routes), "the source is subscribed")


@pytest.mark.usefixtures("no_command_is_late")
async def test_a_command_goes_on_under_the_lease_with_the_age_of_its_source(world):
    """The target's guard gets a number, and a time by the robot's clock at which the command may have been sent."""
    await start(world, FOLLOW)
    assert world.driver() == "eve (route)"
    await world.send(0.5)
    await until(world.published, "the command has come")
    [message] = world.published()
    stamp = message.pop("robotether")
    name = {"id": "route 1", "topic": "/cmd_vel"}
    assert message == {"op": "publish", **name, "msg": {"linear": {"x": 0.5}}}
    assert stamp["fence"] == 1
    assert 0 <= world.target.session.clock_ms() - stamp["t_ms"] < 10_000
    advertised = {"op": "advertise", **name, "type": FOLLOW.type}
    assert advertised in map(json.loads, world.target.received)
    await until(lambda: world.relay.relay.routes.live(5).routes[0].rate_hz, "its rate is known")
    await until(lambda: audit_lines(world.database), "the drive is in the log")


async def test_an_old_command_is_dropped(world, monkeypatch):
    """The source's line delivers late: no ping shows that the command is younger than a minute."""
    await start(world, FOLLOW)
    [topic] = world.relay.relay.shared_topics._tasks
    monkeypatch.setattr(topic, "sent_since_s", lambda: time.monotonic() - 60)
    await world.send_until(lambda: "old" in world.why())
    assert world.published() == []


async def test_the_newest_message_wins_at_the_rate_of_the_route(world):
    await start(world, replace(FOLLOW, target_topic="/speed", rate_hz=5))
    begun_s = time.monotonic()
    for number in range(100):
        await world.send(number / 100)
    last = {"linear": {"x": 0.99}}
    await until(lambda: last in [each["msg"] for each in world.published()], "the last came")
    assert len(world.published()) <= 2 + 5 * (time.monotonic() - begun_s)


async def test_a_number_that_json_lacks_goes_to_no_robot(world):
    await start(world, FOLLOW)
    why = "a number in the message is NaN or infinite, which no robot reads"
    await world.send_until(lambda: world.why() == why, math.nan)
    assert world.published() == []


async def test_a_source_that_its_policy_hides_is_not_read(world):
    await start(world, FOLLOW)
    _set_policy(world, SOURCE, {"manage": {"subscribe": ["/odom"]}})
    await until(lambda: "policy" in world.why(), "the page says so")
    await until(lambda: not world.source.topics, "the subscription has ended")


def _set_policy(world, robot_id, policy):
    robots = world.database.robots
    settings = robot_settings.parse({"policy": policy})
    world.database.robots = {**robots, robot_id: replace(robots[robot_id], settings=settings)}


def _stop(world):
    world.relay.relay.control.stops.stop(world.database.robots[TARGET], "ben")


def _take(world):
    world.relay.relay.control.leasing.take(world.database.robots[TARGET], LeaseRequester(CARL))


def _end_right(world):
    del world.database.grants[5, SOURCE]


def _lower_right(world):
    world.database.grants[5, TARGET] = "drive"


def _disable(world):
    robots = world.database.robots
    world.database.robots = {**robots, SOURCE: replace(robots[SOURCE], state="disabled")}


def _expire(world):
    world.database.routes = [replace(FOLLOW, ends_at=utc_now() - timedelta(seconds=1))]


@pytest.mark.parametrize(
    ("act", "code"),
    [
        (_stop, "robot_stopped"),
        (_take, "lease_lost"),
        (_end_right, "rights_ended"),
        (_lower_right, "rights_ended"),
        (_disable, "robot_inactive"),
        (_expire, "expired"),
    ],
)
async def test_it_ends_for_good(world, act, code):
    """The lease is over, and nothing brings the route back, also while the database says that it lasts."""
    await start(world, FOLLOW)
    act(world)
    await until(world.ends, "it ended")
    assert world.ends() == [code]
    await until(lambda: world.driver() is None, "the lease is over")
    world.database.grants |= {(5, SOURCE): "manage", (5, TARGET): "manage"}
    world.database.routes = [FOLLOW]
    await asyncio.sleep(0.3)
    assert world.driver() is None
    assert world.live() == {}


async def test_its_time_is_over_by_the_clock_of_the_database(world, monkeypatch):
    """It lists the route no more, perhaps before the time has come here."""
    monkeypatch.setattr(relay_routes, "CLOCKS_DIFFER", timedelta(hours=2))
    await start(world, replace(FOLLOW, ends_at=utc_now() + timedelta(hours=1)))
    world.database.routes = []
    await until(world.ends, "it ended")
    assert world.ends() == ["expired"]


@pytest.mark.usefixtures("no_command_is_late")
async def test_it_never_takes_the_lease_from_a_person(world, http):
    target = world.database.robots[TARGET]
    async with http.ws_connect(world.relay.ros_url(target, user=EVE)) as socket:
        await until(world.driver, "eve drives")
        world.database.routes = [FOLLOW]
        await until(world.ends, "the route ended")
        await socket.send_str(PUBLISH)
        await until(world.published, "eve drives on")
        assert world.driver() == "eve"
    assert world.ends() == ["lease_held"]


async def test_it_never_begins_beside_a_person_who_is_about_to_drive(world, monkeypatch):
    """The lease itself refuses it, whatever was seen before."""
    monkeypatch.setattr(world.relay.relay.routes, "_why_not_ours", lambda _route: None)
    target_lease = world.relay.relay.registry.ensure_robot(TARGET).lease
    target_lease._keep_for(EVE, now())
    world.database.routes = [FOLLOW]
    await until(world.ends, "the route ended")
    assert world.ends() == ["lease_held"]
    assert target_lease.fence == 0


@pytest.mark.parametrize("phase", ["claims", "holds"])
async def test_it_waits_for_a_call_over_http(world, phase):
    """A call has the lease for a moment, and nobody drives."""
    robot, leasing = world.database.robots[TARGET], world.relay.relay.control.leasing
    call = Connection(BEN.id, "ben", robot, "drive", lambda _reason: None, is_call=True)
    if phase == "claims":
        leasing._claim(leasing.of(TARGET), call)
    else:
        await leasing.begin(call)
    world.database.routes = [FOLLOW]
    await until(lambda: "ben calls a service" in world.why(), "it waits")
    leasing.end(call)
    await until(lambda: world.live()[1][0] == "runs", "the route runs")
    assert world.ends() == []


async def test_it_waits_while_an_operator_has_an_offer_to_help_the_robot(world):
    world.database.requests = [RelayRequest(TARGET, "offered", 1.0, 1.0, BEN, 20.0)]
    leasing = world.relay.relay.control.leasing
    await until(lambda: leasing.of(TARGET).reserved(now()), "the robot is reserved")
    world.database.routes = [FOLLOW]
    await until(lambda: "reserved for ben" in world.why(), "it waits")
    world.database.requests = []
    await until(lambda: world.live()[1][0] == "runs", "the route runs")
    assert world.ends() == []


async def test_who_asks_for_control_gets_it_although_commands_come(world, monkeypatch):
    monkeypatch.setattr(lease, "PASSES_AFTER_S", 0.3)
    await start(world, FOLLOW)
    world.relay.relay.control.leasing.ask(world.database.robots[TARGET], LeaseRequester(BEN))
    await world.send_until(world.ends)
    assert world.ends() == ["lease_lost"]


async def test_a_robot_that_is_away_is_waited_for(world, start_robot):
    await start(world, FOLLOW)
    await world.target.stop()
    await until(lambda: world.live()[1] == ("waits", "sim1 is offline"), "it waits")
    again = await start_robot(world.relay, "guarded")
    await until(lambda: world.live()[1][0] == "runs", "it runs again")
    assert again.handshakes[-1]["Robotether-Fence"] == "2"
    await world.source.stop()
    await until(lambda: world.live()[1] == ("waits", "sim2 is offline"), "it waits")
    await until(lambda: world.driver() is None, "the target is free")
    assert world.ends() == []


async def test_routes_of_one_user_into_a_robot_share_its_lease(world):
    other = replace(FOLLOW, id=2, source_topic="/map", target_topic="/map", type="a/msg/Map")
    await start(world, FOLLOW, other)
    await until(lambda: world.live() == {1: ("runs", ""), 2: ("runs", "")}, "both run")
    await world.send(0)
    await until(lambda: len(world.published()) == 2, "each has brought a message")
    world.database.routes = [FOLLOW]
    given_up = '{"op":"unadvertise","topic":"/map"}'
    await until(lambda: given_up in world.target.received, "it is given up")
    await until(lambda: len(world.source.topics) == 1, "one is left")
    assert world.relay.relay.control.describe(TARGET).driver.fence == 1


async def test_a_route_is_shown_to_those_who_see_both_robots(world, http):
    await start(world, FOLLOW)
    url, headers = f"{world.relay.url}/api/v1/routes/live", world.database.bearer(EVE)
    async with http.get(url, headers=headers) as answer:
        [route] = (await answer.json())["routes"]
    assert (route["id"], route["state"], route["why"]) == (1, "runs", "")
    assert world.relay.relay.routes.live(BEN.id).routes == []
