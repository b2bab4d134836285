"""The rules by which a robot asks for help, and their way from its topics to the session's lines."""

import asyncio
import base64
import json

import pytest
from fake_cloud import eventually
from fake_rosbridge import FakeRosbridge
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent import rosbridge
from robotether_agent.fields import FieldError
from robotether_agent.help import caller as caller_module
from robotether_agent.help.caller import HelpCaller
from robotether_agent.help.rules import (
    CLEAR_AFTER_S,
    COMPONENT_SILENT_S,
    MAX_COMPONENTS,
    HelpConfig,
    HelpRules,
    call_in,
    fence_margin_m,
    help_config,
    level_in,
    position_in,
)
from robotether_common.session import MAX_HELP_REASON, Battery, HelpCall

SQUARE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
CONFIG = HelpConfig(
    stopped=True,
    battery_below=20,
    diagnostics=True,
    geofence=SQUARE,
    navigation_topic="/plan",
    navigation_silent_s=30,
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["status", "name", "level", "message", "pose", "position", "x", "y"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


def battery(percent, *, charging=False):
    return Battery(percent, charging)


def diagnostics(**levels):
    return {"status": [{"name": n, "level": at, "message": "hot"} for n, at in levels.items()]}


def pose(x, y):
    return {"pose": {"pose": {"position": {"x": x, "y": y, "z": 0.0}}}}


# A rule, a reading where it is true, one between that and clear, one that is clear, and one that says nothing.
RULES = {
    "stop": (lambda r, v, s: r.on_stopped(v, "ben", s), True, None, False, None),
    "battery": (HelpRules.on_battery, battery(19), battery(24), battery(25), None),
    "diagnostics": (
        HelpRules.on_diagnostics,
        diagnostics(motor=2, lamp=0),
        {},
        diagnostics(motor=1),
        {"status": [{"name": 7, "level": 2}, {"name": "motor"}]},
    ),
    "geofence": (HelpRules.on_pose, pose(10.1, 5), pose(9.8, 5), pose(9, 5), pose(None, "5")),
}


@pytest.mark.parametrize("source", RULES)
def test_rule_asks_once_until_it_was_clear(source):
    """Neither what is unknown nor what lies between the two thresholds makes it ask again."""
    read, true, between, clear, unknown = RULES[source]
    rules = HelpRules(CONFIG)
    asked = [
        read(rules, reading, now_s)
        for now_s, reading in [
            (0, unknown),
            (1, true),
            (2, true),
            (100, between),
            (200, unknown),
            (300, true),
            (400, clear),
            (400 + CLEAR_AFTER_S / 2, true),
            (500, clear),
            (500 + CLEAR_AFTER_S, clear),
            (501 + CLEAR_AFTER_S, true),
        ]
    ]
    assert [call.source for call in asked if call] == [source, source]
    assert asked[-1] is not None
    assert asked[1].reason


def test_battery_that_is_charged_asks_for_nobody():
    rules = HelpRules(CONFIG)
    assert rules.on_battery(battery(5, charging=True), 0) is None
    assert rules.on_battery(battery(None), 1) is None
    assert rules.on_battery(battery(5), 2) == HelpCall("battery", "battery at 5 %")


def test_component_fails_however_many_there_were_before_it():
    rules = HelpRules(CONFIG)
    for number in range(MAX_COMPONENTS):
        rules.on_diagnostics(diagnostics(**{f"part_{number}": 0}), 0)
    assert rules.on_diagnostics(diagnostics(motor=2), 1) is not None


def test_component_that_is_gone_fails_no_more():
    rules = HelpRules(CONFIG)
    rules.on_diagnostics(diagnostics(motor=2, lamp=0), 0)
    for now_s in range(1, 2 * round(COMPONENT_SILENT_S + CLEAR_AFTER_S)):
        assert rules.on_diagnostics(diagnostics(lamp=0), now_s) is None
    assert rules.on_diagnostics(diagnostics(motor=2), now_s + 1) is not None


def test_navigation_asks_after_its_silence():
    rules = HelpRules(CONFIG)
    readings = [(0, True), (1, False), (30, False), (31, False), (90, False)]
    assert [rules.on_navigation(published, now_s) for now_s, published in readings] == [
        None,
        None,
        None,
        HelpCall("navigation", "/plan silent for 30 s"),
        None,
    ]
    rules = HelpRules(CONFIG)
    for now_s, published in [(0, False), (20, None), (25, False), (54, False)]:
        assert rules.on_navigation(published, now_s) is None
    assert rules.on_navigation(published=False, now_s=55) is not None


@pytest.mark.parametrize(
    ("text", "call"),
    [
        ("the door is closed", HelpCall("robot", "the door is closed")),
        ('{"reason": "fire", "priority": 1}', HelpCall("robot", "fire", 1)),
        ('{"reason": "fire", "priority": 0}', HelpCall("robot", "fire")),
        ('{"reason": "fire", "priority": true}', HelpCall("robot", "fire")),
        ('{"priority": 3}', HelpCall("robot", "no reason given", 3)),
        ("", HelpCall("robot", "no reason given")),
        ("a\n\x1b[31mb", HelpCall("robot", "a  [31mb")),
        ("x" * 10_000, HelpCall("robot", "x" * (MAX_HELP_REASON - 3) + "...")),
        (7, None),
    ],
)
def test_topic_carries_a_reason_and_a_priority(text, call):
    assert call_in({"data": text}) == call


@pytest.mark.parametrize(
    ("message", "point"),
    [
        (pose(1, 2), (1, 2)),
        ({"pose": {"position": {"x": 1, "y": 2}}}, (1, 2)),
        ({"x": 1.0, "y": 2.0, "theta": 0.0}, (1, 2)),
        ({"pose": {"pose": {"position": {"x": None, "y": 2}}}}, None),
        ({"position": [1, 2]}, None),
    ],
)
def test_position_of_the_usual_types(message, point):
    assert position_in(message) == point


@pytest.mark.parametrize("level", [2, "2", "\x02", base64.b64encode(b"\x02").decode()])
def test_level_is_a_byte_as_bridges_write_it(level):
    assert level_in(level) == 2


@pytest.mark.parametrize(
    ("point", "margin_m"), [((5, 5), 5), ((9, 5), 1), ((10.5, 5), -0.5), ((13, 14), -5)]
)
def test_margin_is_the_distance_to_the_fence(point, margin_m):
    assert fence_margin_m(SQUARE, point) == pytest.approx(margin_m)


def test_fence_may_be_concave():
    notched = (*SQUARE[:2], (10.0, 10.0), (5.0, 2.0), (0.0, 10.0))
    assert fence_margin_m(notched, (5, 5)) < 0 < fence_margin_m(notched, (1, 5))


def test_odometry_that_ran_away_is_outside():
    assert fence_margin_m(((0, 0), (10, 10), (0, 10)), (1e308, -1e308)) < 0


@given(JSON)
def test_no_message_breaks_a_rule(value):
    message = value if isinstance(value, dict) else {"data": value, "status": value, "pose": value}
    rules = HelpRules(CONFIG)
    rules.on_diagnostics(message, 0)
    rules.on_pose(message, 0)
    call_in(message)
    call_in({"data": json.dumps(value)})


@pytest.mark.parametrize(
    "members",
    [
        {"topic": "help"},
        {"stopped": 1},
        {"battery_below": 101},
        {"geofence": [[0, 0], [1, 1]]},
        {"geofence": [[0, 0], [1, 1], [1]]},
        {"geofence": [[0, 0], [1, 1], [1, float("nan")]]},
        {"navigation_silent_s": "30"},
    ],
)
def test_settings_that_cannot_be_meant_are_named(members):
    with pytest.raises(FieldError, match="|".join((*members, "x", "y"))):
        help_config(members)


ALL = {
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/odom": "nav_msgs/msg/Odometry",
    "/plan": "nav_msgs/msg/Path",
}
FENCE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0))


class World:
    """A robot's caller with what it sends; `reads` is set while the server reads."""

    def __init__(self, graph, spawn):
        self.sent = []
        self.stopped = None
        self.battery = None
        self.reads = asyncio.Event()
        self.reads.set()
        self.caller = HelpCaller(graph, lambda: (self.stopped, "ben"), lambda: self.battery)
        self._spawn = spawn
        self._session = None

    def new_session(self):
        if self._session is not None:
            self._session.cancel()
        self._session = self._spawn(self.caller.report(self.send, self.reads.wait))

    def send(self, message):
        assert message["type"] == "help"
        self.sent.append((message["source"], message["reason"], message["priority"]))

    async def has_sent(self, *sources):
        await eventually(
            lambda: sorted(source for source, *_ in self.sent) == sorted(sources),
            lambda: str(self.sent),
        )


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    for name in ("RETRY_S", "CHECK_EVERY_S", "SEND_EVERY_S"):
        monkeypatch.setattr(caller_module, name, 0.05)


@pytest.fixture
def start(make_graph, spawn):
    def begin(url, config):
        world = World(make_graph(url), spawn)
        world.caller.use(config)
        spawn(world.caller.watch())
        world.new_session()
        return world

    return begin


async def test_every_source_asks(start):
    config = HelpConfig(
        topic="/robotether/help",
        stopped=True,
        battery_below=20,
        diagnostics=True,
        geofence=FENCE,
        navigation_topic="/plan",
        navigation_silent_s=0.3,
    )
    async with FakeRosbridge(ALL) as robot:
        world = start(robot.url, config)
        for topic in ("/robotether/help", "/diagnostics", "/odom", "/plan"):
            await robot.subscription(topic)
        await world.has_sent("navigation")
        world.stopped, world.battery = True, Battery(5, charging=False)
        await robot.publish("/robotether/help", {"data": "lost"})
        await world.has_sent("navigation", "stop", "battery", "robot")
        await robot.publish("/odom", {"pose": {"pose": {"position": {"x": -5.0, "y": 0.0}}}})
        error = {"name": "motor", "level": 2, "message": "hot"}
        await robot.publish("/diagnostics", {"status": [error]})
        await world.has_sent("navigation", "stop", "battery", "robot", "geofence", "diagnostics")
        assert ("robot", "lost", 2) in world.sent


async def test_position_is_sent_while_somebody_uses_the_robot(start, monkeypatch):
    """One that was read long ago is unknown."""
    monkeypatch.setattr(caller_module, "POSITION_EVERY_S", 0.05)
    sent, used = [], []
    async with FakeRosbridge(ALL) as robot:
        world = start(robot.url, HelpConfig(geofence=FENCE))
        task = asyncio.ensure_future(world.caller.report_position(sent.append, lambda: bool(used)))
        await eventually(lambda: robot.subscribed("/odom"), lambda: str(robot.got))
        place = {"pose": {"pose": {"position": {"x": 5.0, "y": 1.0}}}}
        await robot.publish("/odom", place)
        await asyncio.sleep(0.3)
        assert sent == []
        used.append(True)
        await robot.publish("/odom", place)
        await eventually(
            lambda: sent == [{"type": "position", "x": 5.0, "y": 1.0}], lambda: str(sent)
        )
        monkeypatch.setattr(caller_module, "POSITION_HOLDS_S", 0.0)
        await robot.publish("/odom", place)
        await asyncio.sleep(0.3)
        assert len(sent) == 1
        task.cancel()


async def test_pose_follows_the_drive_topic(make_graph, spawn, monkeypatch):
    monkeypatch.setattr(rosbridge, "CHOSEN_AGAIN_EVERY_S", 0.05)
    kinds = {"odom": "nav_msgs/msg/Odometry", "cmd_vel": "geometry_msgs/msg/Twist"}
    topics = {f"/{name}/{last}": kind for name in "ab" for last, kind in kinds.items()}
    async with FakeRosbridge(topics) as robot:
        graph = make_graph(robot.url)
        graph.drive_topic = "/a/cmd_vel"
        world = World(graph, spawn)
        world.caller.use(HelpConfig(geofence=FENCE))
        spawn(world.caller.watch())
        await robot.subscription("/a/odom")
        graph.drive_topic = "/b/cmd_vel"
        await robot.subscription("/b/odom")
        assert len(robot.subscribed("/a/odom")) == 1


async def test_call_waits_for_a_server_that_reads_it(start):
    async with FakeRosbridge(ALL) as robot:
        world = start(robot.url, HelpConfig(stopped=True))
        world.reads.clear()
        world.stopped = True
        await world.has_sent("stop")
        world.new_session()
        await world.has_sent("stop", "stop")
        world.reads.set()
        await asyncio.sleep(0.2)
        world.new_session()
        await asyncio.sleep(0.2)
        await world.has_sent("stop", "stop")
