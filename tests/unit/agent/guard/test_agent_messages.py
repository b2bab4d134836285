"""The lines between agent and guard."""

import json
import math
from dataclasses import replace

import pytest
from fake_pipe import FakePipe
from robotether_agent.fields import FieldError
from robotether_agent.guard.agent_messages import (
    MAX_QUEUE_BYTES,
    MOTION_EVERY_S,
    SEEN_EVERY_S,
    Exit,
    FrameSent,
    GuardConfig,
    GuardReporter,
    LeaseUpdate,
    ReleaseRequest,
    SessionIs,
    State,
    StopRequest,
    Tick,
    parse,
)
from robotether_agent.guard.drive_messages import DriveLimits, DriveTopics
from robotether_agent.guard.seen_age import BlindLimits, SeenAges
from robotether_common.guard import REFUSED_KINDS, STOP_CAUSES
from robotether_server.db.control import MAX_NAME

URL = "ws://127.0.0.1:9090"
STANDS = State(stopped=False, by="", moving=False, fence=0)
COUNTS = dict.fromkeys(REFUSED_KINDS, 0)
STOPS = dict.fromkeys(STOP_CAUSES, 0)


def read(**line):
    return parse(json.dumps(line).encode())


@pytest.mark.parametrize(
    ("line", "order"),
    [
        ({"type": "tick"}, Tick()),
        ({"type": "exit"}, Exit()),
        ({"type": "session", "up": True}, SessionIs(up=True)),
        ({"type": "lease", "fence": 13, "held": True}, LeaseUpdate(13, held=True)),
        ({"type": "stop", "id": "5f", "by": "ben"}, StopRequest("5f", "ben")),
        ({"type": "stop"}, StopRequest("", "")),
        # The server must read what the guard reports of it.
        ({"type": "stop", "by": "x" * 99}, StopRequest("", "x" * (MAX_NAME - 3) + "...")),
        ({"type": "release", "id": "77", "by": "ann"}, ReleaseRequest("77", "ann")),
        (
            {"type": "frame", "camera": "/a", "frame": 2**32 - 1, "taken_ms": 12.5},
            FrameSent("/a", 2**32 - 1, 12.5),
        ),
        ({"type": "of tomorrow"}, None),
    ],
)
def test_each_line_is_one_order(line, order):
    """A stop counts without its members, a release does not."""
    assert read(**line) == order


def config_of(guard, **line):
    config = read(type="config", rosbridge_url=URL, guard=guard, **line)
    assert isinstance(config, GuardConfig)
    return config


@pytest.mark.parametrize(
    ("guard", "config"),
    [
        # As docs/reference/protocols.md gives them; without a key nobody gets in.
        ({}, GuardConfig(URL, "", DriveTopics(["/cmd_vel", "*/cmd_vel"]), 0.5, 0.5)),
        ({"drive_topics": []}, GuardConfig(URL, topics=DriveTopics([]))),
        ({"key": "k", "deadman_ms": 200}, GuardConfig(URL, "k", deadman_s=0.2)),
        ({"max_age_ms": 2000}, GuardConfig(URL, max_age_s=2.0)),
        (
            {"drive_topics": ["/vel"], "max_speed_m_s": 1, "max_turn_rad_s": 2.5},
            GuardConfig(URL, topics=DriveTopics(["/vel"]), limits=DriveLimits(1.0, 2.5)),
        ),
        (
            {"max_acceleration_m_s2": 3, "max_turn_acceleration_rad_s2": 4, "max_steering_rad": 1},
            GuardConfig(URL, limits=DriveLimits(None, None, 3.0, 4.0, 1.0)),
        ),
        # An older server says nothing of it, and a null of the settings is no limit.
        (
            {"blind_m": None, "blind_deg": None, "without_frames": "unlimited"},
            GuardConfig(URL, blind=BlindLimits()),
        ),
        (
            {"blind_m": 0.25, "blind_deg": 90, "camera_ms": 40, "without_frames": "slowest"},
            GuardConfig(URL, blind=BlindLimits(0.25, math.pi / 2, 0.04, needs_frames=True)),
        ),
        # A newer server's word for a limit is one, too.
        ({"without_frames": "half"}, GuardConfig(URL, blind=BlindLimits(needs_frames=True))),
    ],
)
def test_a_configuration_is_read(guard, config):
    found = config_of(guard)
    assert found.topics.patterns == config.topics.patterns
    assert replace(found, topics=config.topics) == config


def test_direct_connections_are_let_in_where_the_agent_says_so_and_no_key_is_shown():
    assert config_of({}, direct=True).direct
    assert not config_of({}).direct
    assert "secret" not in repr(config_of({"key": "secret"}))


@pytest.mark.parametrize(
    "guard",
    [
        {"deadman_ms": 199}, {"deadman_ms": 2001}, {"max_age_ms": "500"}, {"drive_topics": "x"},
        {"drive_topics": ["/a[b]"]}, {"max_speed_m_s": -1}, {"max_speed_m_s": "fast"}, {"key": 3},
        {"blind_m": 0}, {"blind_deg": -1}, {"camera_ms": -1}, {"without_frames": True},
    ],
)  # fmt: skip
def test_a_wrong_setting_names_itself(guard):
    with pytest.raises(FieldError, match=next(iter(guard))):
        read(type="config", rosbridge_url=URL, guard=guard)


@pytest.mark.parametrize("line", [b"", b"[]", b"{}", b'{"type":"lease","fence":-1}', b"\xff"])
def test_a_broken_line_is_no_order(line):
    with pytest.raises(FieldError):
        parse(line)


def test_a_robot_that_starts_and_stops_all_the_time_is_told_seldom():
    """As a driver may have it do; and in the end it is told how it is. A stop never waits."""
    now = 5.0
    reports = GuardReporter(pipe := FakePipe(), lambda: now)
    for number in range(1000):
        reports.state(replace(STANDS, moving=number % 2 == 0), COUNTS, STOPS)
        now += 0.001
    assert 10 < len(pipe.lines) <= 2 / MOTION_EVERY_S + 1
    now += MOTION_EVERY_S
    reports.state(STANDS, COUNTS, STOPS)
    assert pipe.lines[-1]["moving"] is False
    reports.state(State(stopped=True, by="ben", moving=True, fence=13), COUNTS, STOPS)
    assert pipe.lines[-1]["stopped"] is True


def test_a_newer_lease_is_told_at_once():
    """The robot's next relay must number above it, however soon it comes."""
    reports = GuardReporter(pipe := FakePipe(), lambda: 5.0)
    for fence in (13, 14):
        reports.state(replace(STANDS, fence=fence), COUNTS, STOPS)
    assert [line["fence"] for line in pipe.lines] == [13, 14]


def test_an_agent_that_does_not_read_holds_nothing_up():
    reports = GuardReporter(pipe := FakePipe())
    pipe.waiting = MAX_QUEUE_BYTES + 1
    reports.tick()
    reports.state(STANDS, COUNTS, STOPS)
    assert pipe.lines == []
    pipe.waiting = 0
    reports.state(STANDS, COUNTS, STOPS)
    assert len(pipe.lines) == 1


def test_what_is_seen_is_reported_now_and_then():
    """A report has all ages since the last one, each once; an agent that does not read gets them later."""
    now, ages = 5.0, SeenAges()
    reports = GuardReporter(pipe := FakePipe(), lambda: now)
    reports.seen(ages)
    ages.begin(13)
    ages.add(0.14)
    ages.slowed_s, ages.limits = 0.05, (math.inf, 0.5)
    reports.seen(ages)
    ages.add(None)
    ages.limits = 0.25, math.inf
    now += SEEN_EVERY_S / 2
    reports.seen(ages)
    unlimited = {"max_speed_m_s": None, "max_turn_rad_s": None}
    first = {"type": "seen", "fence": 13, "ages_ms": [140.0], "slowed_s": 0.05}
    assert pipe.lines == [{**first, **unlimited, "max_turn_rad_s": 0.5}]
    now += SEEN_EVERY_S / 2
    pipe.waiting = MAX_QUEUE_BYTES + 1
    reports.seen(ages)
    pipe.waiting = 0
    reports.seen(ages)
    reports.seen(ages)
    second = {"type": "seen", "fence": 13, "ages_ms": [None], "slowed_s": 0.0}
    assert pipe.lines[1:] == [{**second, **unlimited, "max_speed_m_s": 0.25}]
